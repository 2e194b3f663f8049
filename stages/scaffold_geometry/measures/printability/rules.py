"""What a printer can do, and what each rule gives back."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from scaffold_geometry.arrays import Floats
from scaffold_geometry.measures.declarations import place_metrics
from scaffold_pipeline.artifacts import Fact, Finding, Metric
from scaffold_pipeline.stages.contract import Millimetres, Params, Unit

_RULES = (
    "what a printer may meet, by the rules in `printing`; what breaks one is a finding with places, not a failed gate"
)
_SECTION = "Printability"

METRICS = (
    Metric("thinnest_wall_mm", "mm", "Thinnest wall", "Of all walls that the surface shows.", _SECTION, method=_RULES),
    *place_metrics("thinnest_wall", "Place of the thinnest wall", "Its middle.", _RULES),
    Metric("wall_percentile_5_mm", "mm", "Walls, 5th percentile", "A twentieth of all walls is thinner.", ""),
    Metric("thin_wall_fraction", "", "Share of thin walls", "Of the surface, below what was asked for.", ""),
    Metric(
        "overhang_area_mm2",
        "mm\u00b2",
        "Overhangs",
        "Area that needs support in the build direction.",
        _SECTION,
        method=_RULES,
    ),
    Metric("overhang_fraction", "", "Share of overhangs", "Of the surface.", ""),
    Metric("overhang_regions", "", "Places of overhangs", "Connected parts of that area.", ""),
    Metric("overhang_largest_mm2", "mm\u00b2", "Largest overhang", "Area of the largest connected part.", ""),
    Metric(
        "unsupported_islands",
        "",
        "Islands",
        "Places where printing would begin in mid-air.",
        _SECTION,
        method=_RULES,
    ),
    Metric(
        "enclosed_voids",
        "",
        "Voids that hold powder",
        "Cavities out of which nothing can be blown.",
        _SECTION,
        method=_RULES,
    ),
    Metric("enclosed_void_mm3", "mm\u00b3", "Volume of enclosed voids", "All of them together.", ""),
    Metric("island_pieces", "", "Loose pieces", "Parts beside the greatest, which fall off.", "", method=_RULES),
    Metric("island_piece_mm3", "mm\u00b3", "Volume of loose pieces", "All of them together.", ""),
)
"""What the rules measure, each in its own module."""

Degrees = Annotated[float, Unit("degrees")]
SquareMillimetres = Annotated[float, Unit("mm^2")]


class PrintRules(Params):
    """What the printer, and the program that slices for it, can do."""

    min_wall: Millimetres | None = Field(default=None, gt=0.0)
    """Thinnest wall that prints; not asked for by default."""

    knife_angle: Degrees = Field(default=20.0, ge=0.0, le=45.0)
    """A rim sharper than this runs out to nothing; two sides that open at less are those of a wall."""

    max_knife_edge: Millimetres | None = Field(default=0.0, ge=0.0)
    """Length that may be so sharp, all rims together; none to measure it only."""

    build_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Which way the layers are stacked, of any length; the plate lies under the lowest point."""

    layer: Millimetres = Field(default=0.05, gt=0.0)
    """Height of a layer: what starts within the first lies on the plate; what is smaller than one is not looked at."""

    overhang_angle: Degrees = Field(default=45.0, ge=0.0, lt=90.0)
    """A face that looks down needs support where it is less steep than this, from the horizontal."""

    bridge: Millimetres = Field(default=0.0, ge=0.0)
    """Overhangs of no greater span, held at their rims, print without support; by default none does."""

    max_overhang_area: SquareMillimetres | None = Field(default=0.0, ge=0.0)
    """Area that may need support, all overhangs together; none to measure it only."""

    min_aspect: float = Field(default=1e-4, ge=0.0, lt=0.5)
    """Height over longest edge below which a triangle is a sliver; one without area always is."""

    max_triangles: int | None = Field(default=5_000_000, gt=0)
    """How many triangles the slicing program takes."""

    max_file_bytes: int | None = Field(default=256 * 2**20, gt=0)
    """How large a binary STL it takes."""

    most_places: int = Field(default=50, ge=1, le=1000)
    """How many places each rule names at most, the worst first."""

    @field_validator("build_direction")
    @classmethod
    def _points_somewhere(cls, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        if not np.linalg.norm(direction) > 0.0:
            raise ValueError(f"must not be zero, got {direction}")
        return direction

    @property
    def up(self) -> Floats:
        """The build direction, of unit length, (3,)."""
        direction = np.array(self.build_direction)
        return np.asarray(direction / np.linalg.norm(direction))


class Outcome(NamedTuple):
    """The numbers of a rule, and what it found where it was broken."""

    values: dict[str, Fact]
    finding: Finding | None
