"""The voxels that a field is sampled on: from a voxel size or a grid, over an outer shape, as memory allows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Bools, Floats
from scaffold_geometry.voxels.grids import dilate, grid_over, samples_inside
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.memory import available_memory
from scaffold_pipeline.stages.contract import Follows, InputFile, Millimetres, Params, Unit

SampleCount = Annotated[int, Field(ge=2)]
LayerCount = Annotated[int, Field(ge=1)]

MARGIN = 3
"""Samples around the bounding box: the field is void from two samples outside on, and the cut needs no more."""

BYTES_PER_VOXEL = 8
"""The field in single precision, three masks, and one byte in reserve."""


class GridParams(Params):
    """A regular grid: sample (i, j, k) lies at `origin + spacing * (i, j, k)`."""

    origin: Annotated[tuple[float, float, float], Unit("mm")]
    """Position of the first sample."""

    spacing: Millimetres = Field(gt=0.0)
    """Distance between neighbouring samples along each axis."""

    shape: tuple[SampleCount, SampleCount, LayerCount]
    """Number of samples along x, y and z; 1 along z for a section, or for the plane of a planar mesh."""


class SamplingParams(Params):
    """Sampling of a field: base class of the parameters of every field stage."""

    voxel_size: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Distance between samples of the field; a twentieth of the mean edge length keeps a bone's struts unbroken."""

    grid: GridParams | None = None
    """Explicit grid, instead of a voxel size."""

    points: Annotated[InputFile | None, Follows("write_field", "points")] = None
    """CSV file of points x, y, z in mm; the field is evaluated there exactly, without voxels, for `write_field`."""

    @model_validator(mode="after")
    def _one_grid(self) -> SamplingParams:
        if (self.voxel_size is None) == (self.grid is None):
            raise ValueError("give either voxel_size or grid")
        return self


@dataclass(frozen=True, eq=False)
class Voxels:
    """Samples at `origin + spacing * (i, j, k)` mm, `inside` the outer shape or `near` it, up to two voxels off."""

    origin: Floats
    spacing: float
    inside: Bools
    near: Bools

    @property
    def axes(self) -> tuple[Floats, Floats, Floats]:
        """The coordinates of the samples along x, y and z, mm."""
        x, y, z = (self.origin[axis] + self.spacing * np.arange(self.inside.shape[axis]) for axis in range(3))
        return x, y, z


def voxels_over(outer: OuterShape, params: SamplingParams, plane: float | None = None) -> Voxels:
    """Return the voxels over an outer shape; for a planar mesh, one layer at z = `plane` mm.

    Raises `StageError` if they need more memory than is free, or are too coarse for the shape.
    """
    origin, spacing, shape = _grid(outer.bounds, params, plane)
    inside = samples_inside(outer.vertices, outer.faces, origin, spacing, shape)
    if not inside.any():
        raise StageError(f"voxel_size {spacing:g} mm: no sample lies inside the outer shape; use a smaller voxel_size")
    return Voxels(origin, spacing, inside, near=dilate(inside, 2))


def _grid(bounds: Floats, params: SamplingParams, plane: float | None) -> tuple[Floats, float, tuple[int, int, int]]:
    """Return origin, spacing and shape of the grid: the given one, or one that covers `bounds` (2, 3)."""
    if plane is not None:
        bounds = np.insert(bounds[:, :2], 2, plane, axis=1)
    if params.grid is None:
        spacing = params.voxel_size or 0.0
        _require_memory(bounds, spacing)
        origin, shape = grid_over(bounds, spacing, MARGIN)
        return (origin, spacing, shape) if plane is None else (np.append(origin[:2], plane), spacing, (*shape[:2], 1))
    grid = params.grid
    if plane is not None and (grid.shape[2] > 1 or abs(grid.origin[2] - plane) > 1e-6 * grid.spacing):
        raise StageError(
            f"grid: a planar mesh needs one layer of samples in its plane, z = {plane:g} mm, got {grid.shape[2]} from "
            f"z = {grid.origin[2]:g} mm; end origin with {plane:g} and shape with 1"
        )
    last = np.array(grid.origin) + grid.spacing * (np.array(grid.shape) - 1)
    _require_memory(np.array([grid.origin, last]), grid.spacing)
    if (bounds[0] < grid.origin).any() or (bounds[1] > last).any():
        warn("grid: does not cover the outer shape; the solid ends where the grid does")
    return np.array(grid.origin, float), grid.spacing, grid.shape


def _require_memory(bounds: Floats, spacing: float) -> None:
    needed, free = _estimate_memory(bounds, spacing), available_memory()
    if needed <= free:
        return
    fitting = spacing
    while _estimate_memory(bounds, fitting) > free and fitting < np.ptp(bounds, axis=0).max():
        fitting = float(f"{1.1 * fitting:.2g}")
    raise StageError(
        f"voxel_size {spacing:g} mm: the grid needs {needed / 2**30:.1f} GiB, but {free / 2**30:.1f} GiB are free; "
        f"use {fitting:g} mm or more"
    )


def _estimate_memory(bounds: Floats, spacing: float) -> float:
    """Return the greatest number of bytes that a grid over `bounds` (2, 3) needs."""
    counts: list[float] = (np.ptp(bounds, axis=0) / spacing + 2 * MARGIN + 2).tolist()
    return math.prod(counts) * BYTES_PER_VOXEL
