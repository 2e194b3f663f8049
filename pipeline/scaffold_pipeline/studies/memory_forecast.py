"""Estimate of the memory of a run before it starts, from the voxels in its plan and the size of the shape.

Two things take memory: grids, whose voxels fill the bounding box, and surfaces, which have about one triangle per voxel
inside the shape if struts are 16 voxels long, and fewer if struts are longer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from scaffold_pipeline.artifacts import Fact, ScalarField
from scaffold_pipeline.config.plan import Plan, Step

USUAL = 2**30
"""Bytes assumed for a run whose voxels and shape are unknown."""

_BASE, _PER_VOXEL, _PER_VOXEL_INSIDE = 1.2 * 2**30, 16, 300
"""Bytes of a run without voxels (libraries, and the picture of the solid), per voxel of a grid, and per voxel of the
field inside the shape. Eight runs from bone to written solid (heel, patella, proximal femur, femur and hip bone and a
machined part, 0.5 to 5 million voxels inside, struts of 14 to 36 voxels) took 0.75 to 1.08 of that sum."""

_BOX = 3.0
"""Volume of a bounding box over that of the shape, assumed if its sides are unknown."""


class Grids(NamedTuple):
    """Voxels per mm^3 of a plan's finest field, and of the finest grid of any stage; 0 if there is none."""

    field: float
    any: float


def grids_of(plan: Plan) -> Grids:
    """Return the voxel densities that `voxel_size` and `grid` of the stages of `plan` give."""
    sizes = [(step, size) for step in plan.steps for size in _voxel_sizes(step)]
    of_fields = [size for step, size in sizes if issubclass(step.stage.output, ScalarField)]
    return Grids(_density(of_fields), _density([size for _, size in sizes]))


def _voxel_sizes(step: Step) -> Iterator[float]:
    grid = getattr(step.params, "grid", None)
    for size in (getattr(step.params, "voxel_size", None), getattr(grid, "spacing", None)):
        if isinstance(size, float):
            yield size


def _density(sizes: list[float]) -> float:
    return min(sizes) ** -3 if sizes else 0.0


def expected_peak(grids: Grids, shape: Mapping[str, Fact]) -> int:
    """Return the bytes that a run with `grids` may need; `shape` are the facts of the first stage's result."""
    volume = shape.get("volume_mm3")
    if not grids.any or not isinstance(volume, float):
        return USUAL
    sides = [shape.get(f"size_{axis}") for axis in "xyz"]
    box = math.prod(side for side in sides if isinstance(side, float)) if None not in sides else _BOX * volume
    return round(_BASE + _PER_VOXEL * grids.any * box + _PER_VOXEL_INSIDE * grids.field * volume)
