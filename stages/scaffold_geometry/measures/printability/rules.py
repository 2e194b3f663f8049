"""What a printer can do, and what each rule gives back."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator

from scaffold_geometry.arrays import Floats
from scaffold_geometry.measures.declarations import place_metrics
from scaffold_pipeline.artifacts import Fact, Finding, Metric
from scaffold_pipeline.errors import warn
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

_REMOVED = frozenset({"max_knife_edge", "min_aspect", "max_triangles", "max_file_bytes"})
"""Parameters of rules that are gone; a config may still have them for one release."""


class PrintRules(Params):
    """What the printer can do."""

    min_wall: Millimetres | None = Field(default=None, gt=0.0)
    """Thinnest wall that prints; not asked for by default."""

    wall_angle: Degrees = Field(default=20.0, ge=0.0, le=45.0)
    """Two sides that open at no more than this are those of a wall."""

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

    most_places: int = Field(default=50, ge=1, le=1000)
    """How many places each rule names at most, the worst first."""

    @model_validator(mode="before")
    @classmethod
    def _takes_the_names_of_0_1(cls, given: object) -> object:
        """Take `wall_angle` by its former name and leave out what has no rule; either warns, for one release."""
        if not isinstance(given, dict):
            return given
        kept = {name: value for name, value in given.items() if name not in _REMOVED and name != "knife_angle"}
        for name in sorted(_REMOVED & given.keys()):
            warn(f"printing: {name} has no rule any more and is left out; remove it from the config")
        if "knife_angle" in given:
            warn("printing: knife_angle is called wall_angle now; rename it in the config")
            kept.setdefault("wall_angle", given["knife_angle"])
        return kept

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
