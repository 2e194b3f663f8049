"""The memory that a run may need, told before it runs: from the voxels that its plan asks for and the shape's size.

Two things take memory: grids, whose voxels fill the box about the shape, and surfaces, which have about a triangle for
each voxel of the field inside it where a strut is 16 voxels long, fewer where it is longer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from scaffold_pipeline.artifacts import Fact, ScalarField
from scaffold_pipeline.config.plan import Plan, Step

USUAL = 2**30
"""Bytes that a run is taken to need of which neither voxels nor shape are known."""

_BASE, _PER_VOXEL, _PER_VOXEL_INSIDE = 1.2 * 2**30, 16, 300
"""Bytes of a run with no voxels (libraries, and the picture of the solid), for each voxel of a grid's box, and for each
one of the field inside the shape. Eight runs from bone to written solid (heel, patella, proximal femur, femur and hip
bone and a machined part, 0.5 to 5 million voxels inside, struts of 14 to 36 voxels) had 0.75 to 1.08 of that sum."""

_BOX = 3.0
"""Volume of the box about a shape in volumes of the shape, where its sides are not known."""


class Grids(NamedTuple):
    """The voxels in a mm^3 of a plan's finest field, and of the finest grid of any stage; 0 where there is none."""

    field: float
    any: float


def grids_of(plan: Plan) -> Grids:
    """Return the voxels that `plan` asks for by each `voxel_size` and `grid`."""
    found = [(step, size) for step in plan.steps for size in _voxel_sizes(step)]
    of_fields = [size for step, size in found if issubclass(step.stage.output, ScalarField)]
    return Grids(_density(of_fields), _density([size for _, size in found]))


def _voxel_sizes(step: Step) -> Iterator[float]:
    grid = getattr(step.params, "grid", None)
    for size in (getattr(step.params, "voxel_size", None), getattr(grid, "spacing", None)):
        if isinstance(size, float):
            yield size


def _density(sizes: list[float]) -> float:
    return min(sizes) ** -3 if sizes else 0.0


def expected_peak(grids: Grids, shape: Mapping[str, Fact]) -> int:
    """Return the bytes that a run with such grids may need, `shape` being the facts of what its first stage gave."""
    volume = shape.get("volume_mm3")
    if not grids.any or not isinstance(volume, float):
        return USUAL
    sides = [shape.get(f"size_{axis}") for axis in "xyz"]
    box = math.prod(side for side in sides if isinstance(side, float)) if None not in sides else _BOX * volume
    return round(_BASE + _PER_VOXEL * grids.any * box + _PER_VOXEL_INSIDE * grids.field * volume)
