"""The window of the certificate as a picture: an SVG bar for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import ClassVar

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.wording import to_text


def draw_window(metrics: Mapping[str, Fact]) -> str:
    """Return the certificate's window as a bar: where channels close, where struts break, and the iso-value."""
    closed, broken, iso = (_finite(metrics.get(key)) for key in ("channel_max", "strut_min", "iso"))
    if closed is None or broken is None:
        return ""
    known = [-1.0, 1.0, closed, broken, *([] if iso is None else [iso])]
    scale = _Scale(min(known), max(known))
    marks = [
        scale.mark(closed, 16, f"channel_max {to_text(closed)}: all channels open above"),
        scale.mark(broken, 34, f"strut_min {to_text(broken)}: all struts whole below"),
    ]
    if iso is not None:
        marks.append(scale.mark(iso, 92, f"iso {to_text(iso)}"))
    return (
        f'<figure class="window"><svg viewBox="0 0 {_Scale.WIDTH:g} 100" role="img" '
        'aria-label="The iso-value in the window of the certificate">'
        + scale.band(scale.low, scale.high, "open")
        + scale.band(scale.low, closed, "closed")
        + scale.band(broken, scale.high, "broken")
        + "".join(marks)
        + f"</svg>\n<figcaption>{_judgement(closed, broken, iso)}</figcaption></figure>"
    )


@dataclass(frozen=True)
class _Scale:
    """Where field values from `low` to `high` lie on the bar, in its own units."""

    low: float
    high: float

    WIDTH: ClassVar[float] = 800.0
    EDGE: ClassVar[float] = 8.0

    def place(self, value: float) -> float:
        return self.EDGE + (value - self.low) / (self.high - self.low) * (self.WIDTH - 2.0 * self.EDGE)

    def band(self, start: float, end: float, kind: str) -> str:
        x = self.place(start)
        return f'<rect class="{kind}" x="{x:.1f}" y="44" width="{self.place(end) - x:.1f}" height="24"/>'

    def mark(self, value: float, y: float, label: str) -> str:
        """Return a line across the bar and its label at height `y`, beside the line where there is more room."""
        x = self.place(value)
        anchor, shift = ("start", 5.0) if x < self.WIDTH / 2.0 else ("end", -5.0)
        top, bottom = (38.0, y + 4.0) if y > 44.0 else (y - 10.0, 74.0)  # below or above the bar
        return (
            f'<line x1="{x:.1f}" y1="{top:g}" x2="{x:.1f}" y2="{bottom:g}"/>'
            f'<text x="{x + shift:.1f}" y="{y:g}" text-anchor="{anchor}">{escape(label)}</text>'
        )


def _judgement(closed: float, broken: float, iso: float | None) -> str:
    if iso is None:
        return "The field's promise before any voxel was computed."
    if closed < iso < broken:
        return "The iso-value lies within the window: as sampled, every channel is open and every strut whole."
    faults = [
        *([f"{to_text(closed - iso)} below channel_max, so channels are closed"] if iso <= closed else []),
        *([f"{to_text(iso - broken)} above strut_min, so struts are broken"] if iso >= broken else []),
    ]
    return f"The iso-value lies {' and '.join(faults)}."


def _finite(value: Fact) -> float | None:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    return None
