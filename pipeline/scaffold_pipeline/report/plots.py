"""Distributions and curves as drawings that a page holds: SVG without script, each with its numbers in a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from scaffold_pipeline.report.markup import folded, table, text_of
from scaffold_pipeline.report.wording import to_text

_MOST_TICKS = 6


def draw_histogram(told: Mapping[str, Any]) -> str:
    """Return a histogram of `measures.json` as a figure; nothing where its numbers are none."""
    edges, shares = _numbers(told.get("edges")), _numbers(told.get("shares"))
    if not shares or len(edges) != len(shares) + 1 or edges[-1] <= edges[0]:
        return ""
    unit = f", {text_of(told['unit'])}" if told.get("unit") else ""
    frame = _Frame(edges[0], edges[-1], 0.0, 1.08 * max(*shares, 1e-9))
    bars = "".join(
        f'<rect class="bar" x="{frame.x(low) + 0.5:.1f}" y="{frame.y(share):.1f}" '
        f'width="{max(frame.x(high) - frame.x(low) - 1.0, 0.5):.1f}" height="{frame.y(0.0) - frame.y(share):.1f}"/>'
        for low, high, share in zip(edges, edges[1:], shares, strict=False)
    )
    mean = sum(share * (low + high) / 2.0 for low, high, share in zip(edges, edges[1:], shares, strict=False))
    mean /= sum(shares) or 1.0
    rows = (
        (f"{to_text(low)} to {to_text(high)}", to_text(share))
        for low, high, share in zip(edges, edges[1:], shares, strict=False)
    )
    about = f"Shares of the whole from {to_text(edges[0])} to {to_text(edges[-1])}{unit}; mean about {to_text(mean)}."
    axes = frame.axes(f"{text_of(told.get('title'))}{unit}", "share", is_share=True)
    return _figure(told, axes + bars, about, table(("From, to", "Share"), rows, "facts"))


def draw_curve(told: Mapping[str, Any]) -> str:
    """Return a curve of `measures.json` as a figure; nothing where its numbers are none."""
    xs, ys = _numbers(told.get("x")), _numbers(told.get("y"))
    if len(xs) < 2 or len(xs) != len(ys) or xs[-1] <= xs[0]:  # a line has two ends
        return ""
    low, high = min(0.0, *ys), max(*ys, 1e-9)
    frame = _Frame(xs[0], xs[-1], low, high + 0.08 * (high - low))
    line = " ".join(f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in zip(xs, ys, strict=True))
    rows = ((to_text(x), to_text(y)) for x, y in zip(xs, ys, strict=True))
    titles = (text_of(told.get("x_title")), text_of(told.get("y_title")))
    spans = [f"from {to_text(values[0])} to {to_text(values[-1])}" for values in (ys, xs)]
    about = f"{titles[1]} {spans[0]} over {titles[0]} {spans[1]}."
    return _figure(
        told, frame.axes(*titles) + f'<polyline class="curve" points="{line}"/>', about, table(titles, rows, "facts")
    )


def _figure(told: Mapping[str, Any], drawing: str, about: str, numbers: str) -> str:
    """Return a drawing with its title, what it shows in words, and its numbers; `about` is escaped already."""
    title = text_of(told.get("title"))
    return (
        f'<figure class="plot"><svg viewBox="0 0 {_Frame.WIDTH:g} {_Frame.HEIGHT:g}" role="img">'
        f"<title>{title}</title><desc>{about}</desc>{drawing}</svg>\n"
        f"<figcaption>{title}</figcaption>{folded('Numbers', numbers)}</figure>"
    )


@dataclass(frozen=True)
class _Frame:
    """Where numbers of x and y lie in a drawing, in its own units."""

    left: float
    right: float
    low: float
    high: float

    WIDTH: ClassVar[float] = 480.0
    HEIGHT: ClassVar[float] = 300.0
    INNER: ClassVar[tuple[float, float, float, float]] = (58.0, 470.0, 244.0, 12.0)
    """Left, right, bottom and top of what lies within the axes."""

    def x(self, value: float) -> float:
        left, right, _, _ = self.INNER
        return left + (value - self.left) / (self.right - self.left) * (right - left)

    def y(self, value: float) -> float:
        _, _, bottom, top = self.INNER
        return bottom + (value - self.low) / (self.high - self.low) * (top - bottom)

    def axes(self, x_title: str, y_title: str, *, is_share: bool = False) -> str:
        """Return lines and numbers along both axes, and their titles, escaped already."""
        left, right, bottom, top = self.INNER
        parts = []
        for mark in ticks(self.low, self.high):
            text = f"{100.0 * mark:.3g}\u202f%" if is_share else f"{mark:g}"
            y = self.y(mark)
            parts.append(f'<line class="grid" x1="{left:g}" x2="{right:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text x="{left - 7:g}" y="{y + 4.5:.1f}" text-anchor="end">{text}</text>')
        for mark in ticks(self.left, self.right):
            x = self.x(mark)
            parts.append(f'<line class="tick" x1="{x:.1f}" x2="{x:.1f}" y1="{bottom:g}" y2="{bottom + 5:g}"/>')
            parts.append(f'<text x="{x:.1f}" y="{bottom + 20:g}" text-anchor="middle">{mark:g}</text>')
        middle = (bottom + top) / 2.0
        parts.append(f'<text x="{(left + right) / 2:g}" y="{bottom + 44:g}" text-anchor="middle">{x_title}</text>')
        parts.append(
            f'<text x="14" y="{middle:g}" text-anchor="middle" transform="rotate(-90 14 {middle:g})">{y_title}</text>'
        )
        return "".join(parts)


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
    """Return finite numbers as they are; none where one is anything else."""
    listed = list(values) if isinstance(values, Iterable) and not isinstance(values, str | bytes | Mapping) else []
    is_number = [isinstance(value, int | float) and math.isfinite(value) for value in listed]
    return [float(value) for value in listed] if all(is_number) else []
