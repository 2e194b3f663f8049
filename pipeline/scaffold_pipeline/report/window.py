"""The window of the certificate as a bar: positions of its bands and marks, drawn by `charts.html.j2`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.wording import to_text


class Band(NamedTuple):
    """A part of the bar: `open` (channels open and struts whole), `closed` or `broken`."""

    kind: str
    x: float
    width: float


class Mark(NamedTuple):
    """A line across the bar, and its label."""

    x: float
    top: float
    bottom: float
    text_x: float
    text_y: float
    anchor: str
    label: str


class Window(NamedTuple):
    """The bar, and its meaning in a sentence."""

    bands: tuple[Band, ...]
    marks: tuple[Mark, ...]
    judgement: str


def draw_window(metrics: Mapping[str, Fact]) -> Window | None:
    """Return the certificate's window: limits of channels and struts, and the iso-value; None without a certificate."""
    closed, broken, iso = (_finite(metrics.get(key)) for key in ("channel_max", "strut_min", "iso"))
    if closed is None or broken is None:
        return None
    known = [-1.0, 1.0, closed, broken, *([] if iso is None else [iso])]
    scale = _Scale(min(known), max(known))
    marks = [
        scale.mark(closed, 16.0, f"channel_max {to_text(closed)}: all channels open above"),
        scale.mark(broken, 34.0, f"strut_min {to_text(broken)}: all struts whole below"),
    ]
    if iso is not None:
        marks.append(scale.mark(iso, 92.0, f"iso {to_text(iso)}"))
    bands = (
        scale.band(scale.low, scale.high, "open"),
        scale.band(scale.low, closed, "closed"),
        scale.band(broken, scale.high, "broken"),
    )
    return Window(bands, tuple(marks), _judgement(closed, broken, iso))


@dataclass(frozen=True)
class _Scale:
    """Positions of field values from `low` to `high` on the bar, in its own units."""

    low: float
    high: float

    WIDTH: ClassVar[float] = 800.0
    EDGE: ClassVar[float] = 8.0

    def place(self, value: float) -> float:
        return self.EDGE + (value - self.low) / (self.high - self.low) * (self.WIDTH - 2.0 * self.EDGE)

    def band(self, start: float, end: float, kind: str) -> Band:
        x = self.place(start)
        return Band(kind, x, self.place(end) - x)

    def mark(self, value: float, y: float, label: str) -> Mark:
        """Return a line across the bar and its label at height `y`, beside the line where there is more room."""
        x = self.place(value)
        anchor, shift = ("start", 5.0) if x < self.WIDTH / 2.0 else ("end", -5.0)
        top, bottom = (38.0, y + 4.0) if y > 44.0 else (y - 10.0, 74.0)  # below or above the bar
        return Mark(x, top, bottom, x + shift, y, anchor, label)


def _judgement(closed: float, broken: float, iso: float | None) -> str:
    if iso is None:
        return "The certificate of the field, computed before any voxel."
    if closed < iso < broken:
        return "The iso-value is in the window: as sampled, every channel is open and every strut whole."
    faults = [
        *([f"{to_text(closed - iso)} below channel_max, so some channels are closed"] if iso <= closed else []),
        *([f"{to_text(iso - broken)} above strut_min, so some struts are broken"] if iso >= broken else []),
    ]
    return f"The iso-value is {' and '.join(faults)}."


def _finite(value: Fact) -> float | None:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    return None
