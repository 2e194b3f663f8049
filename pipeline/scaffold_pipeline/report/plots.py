"""Charts of distributions and curves: positions of bars, lines and marks, drawn by `charts.html.j2`.

Not by matplotlib: its imports take 2 s, and its SVG has fixed colours and addresses (docs/decisions/charts.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from scaffold_pipeline.report.wording import to_text

_MOST_TICKS = 6

Pair = tuple[float, float]


@dataclass(frozen=True)
class Chart:
    """A drawing in its own units, 480 by 300: bars x, y, width, height, or a line, over the axes of `frame`.

    `about` describes it in words, `rows` are its numbers under the titles `head`.
    """

    frame: Frame
    title: str
    about: str
    x_title: str
    y_title: str
    head: tuple[str, str]
    rows: list[tuple[str, str]]
    bars: list[tuple[float, float, float, float]] = field(default_factory=list)
    line: list[Pair] = field(default_factory=list)
    is_share: bool = False

    @property
    def rules(self) -> list[tuple[float, str]]:
        """The y of each grid line, and its number."""
        marks = ticks(self.frame.low, self.frame.high)
        return [(self.frame.y(mark), f"{100.0 * mark:.3g}\u202f%" if self.is_share else f"{mark:g}") for mark in marks]

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """The x of each tick, and its number."""
        return [(self.frame.x(mark), f"{mark:g}") for mark in ticks(self.frame.left, self.frame.right)]


def draw_histogram(payload: Mapping[str, Any]) -> Chart | None:
    """Return a histogram of `measures.json` as a chart; None if its numbers are invalid."""
    edges, shares = _numbers(payload.get("edges")), _numbers(payload.get("shares"))
    if not shares or len(edges) != len(shares) + 1 or edges[-1] <= edges[0]:
        return None
    unit = f", {payload['unit']}" if payload.get("unit") else ""
    frame = Frame(edges[0], edges[-1], 0.0, 1.08 * max(*shares, 1e-9))
    spans = list(zip(edges, edges[1:], shares, strict=False))
    mean = sum(share * (low + high) / 2.0 for low, high, share in spans) / (sum(shares) or 1.0)
    title = to_text(payload.get("title"))
    ends = f"from {to_text(edges[0])} to {to_text(edges[-1])}{unit}"
    return Chart(
        frame=frame,
        title=title,
        about=f"Shares of the whole {ends}; mean about {to_text(mean)}.",
        x_title=f"{title}{unit}",
        y_title="share",
        head=("From, to", "Share"),
        rows=[(f"{to_text(low)} to {to_text(high)}", to_text(share)) for low, high, share in spans],
        bars=[frame.bar(low, high, share) for low, high, share in spans],
        is_share=True,
    )


def draw_curve(payload: Mapping[str, Any]) -> Chart | None:
    """Return a curve of `measures.json` as a chart; None if its numbers are invalid."""
    xs, ys = _numbers(payload.get("x")), _numbers(payload.get("y"))
    if len(xs) < 2 or len(xs) != len(ys) or xs[-1] <= xs[0]:  # a line has two ends
        return None
    low, high = min(0.0, *ys), max(*ys, 1e-9)
    frame = Frame(xs[0], xs[-1], low, high + 0.08 * (high - low))
    titles = (to_text(payload.get("x_title")), to_text(payload.get("y_title")))
    spans = [f"from {to_text(values[0])} to {to_text(values[-1])}" for values in (ys, xs)]
    return Chart(
        frame=frame,
        title=to_text(payload.get("title")),
        about=f"{titles[1]} {spans[0]} over {titles[0]} {spans[1]}.",
        x_title=titles[0],
        y_title=titles[1],
        head=titles,
        rows=[(to_text(x), to_text(y)) for x, y in zip(xs, ys, strict=True)],
        line=[(frame.x(x), frame.y(y)) for x, y in zip(xs, ys, strict=True)],
    )


@dataclass(frozen=True)
class Frame:
    """Converts x and y to positions in a drawing, in its own units."""

    left: float
    right: float
    low: float
    high: float

    INNER: ClassVar[tuple[float, float, float, float]] = (58.0, 470.0, 244.0, 12.0)
    """Left, right, bottom and top of the area within the axes."""

    def x(self, value: float) -> float:
        """Return the horizontal position of a number."""
        left, right, _, _ = self.INNER
        return left + (value - self.left) / (self.right - self.left) * (right - left)

    def y(self, value: float) -> float:
        """Return the vertical position of a number."""
        _, _, bottom, top = self.INNER
        return bottom + (value - self.low) / (self.high - self.low) * (top - bottom)

    def bar(self, low: float, high: float, share: float) -> tuple[float, float, float, float]:
        """Return x, y, width and height of a bar, with a gap of a unit to the next."""
        width = max(self.x(high) - self.x(low) - 1.0, 0.5)
        return self.x(low) + 0.5, self.y(share), width, self.y(0.0) - self.y(share)


def ticks(low: float, high: float) -> list[float]:
    """Return round numbers from `low` to `high`, six at most.

    >>> ticks(0.0, 1.0), ticks(-3.0, 41.0)
    ([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], [0.0, 10.0, 20.0, 30.0, 40.0])
    """
    rough = (high - low) / (_MOST_TICKS - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough * (1.0 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{number * step:.10g}") for number in range(first, last + 1)]


def _numbers(values: object) -> Sequence[float]:
    """Return finite numbers unchanged; an empty sequence if one is not a finite number."""
    listed = list(values) if isinstance(values, Iterable) and not isinstance(values, str | bytes | Mapping) else []
    is_number = [isinstance(value, int | float) and math.isfinite(value) for value in listed]
    return [float(value) for value in listed] if all(is_number) else []
