"""Stage `tpms_field`: the field of a triply periodic minimal surface (TPMS), without mesh and without certificate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats
from scaffold_geometry.fields.sampling import SamplingParams, Voxels, voxels_over
from scaffold_geometry.files.points import read_points
from scaffold_pipeline.artifacts import Metric, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import Millimetres, Params, Share, Unit, stage

if TYPE_CHECKING:
    from collections.abc import Callable

    Level = Callable[[Floats, Floats, Floats], Floats]

_LEAST_SAMPLES = 8
"""Least number of samples per cell that represents its shape: four per shortest wave of I-WP."""

_STEPS = 257
"""Number of places along a grading at which the level is computed; between them it is interpolated linearly."""

_ROUNDING = 1e-6
"""Relative excess of the cell over the shape that is allowed: converting units rounds."""

Between0And1 = Annotated[Share, Field(gt=0.0, lt=1.0)]


class GradingParams(Params):
    """Porosity graded along an axis."""

    axis: Literal["x", "y", "z"] = "z"
    """Direction of the grading."""

    porosity: tuple[Between0And1, Between0And1]
    """Porosity at the low and at the high end; linear between them, constant beyond them."""

    between: tuple[Millimetres, Millimetres] | None = None
    """Coordinates of the two ends; by default those of the outer shape."""

    @model_validator(mode="after")
    def _ascending(self) -> GradingParams:
        if self.between is not None and not self.between[0] < self.between[1]:
            raise ValueError(f"between: must be [low end, high end] in ascending order, got {self.between}")
        return self


class TpmsFieldParams(SamplingParams):
    """Parameters of `tpms_field`."""

    voxel_size: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Distance between samples of the field; a twentieth of the cell size represents the surface well."""

    surface: Literal["schwarz_p", "schwarz_d", "gyroid", "iwp"]
    """Schwarz's P or D, Schoen's gyroid or I-WP."""

    cell_size: Millimetres = Field(gt=0.0)
    """Edge length of the cubic unit cell, the period along x, y and z."""

    kind: Literal["skeletal", "sheet"] = "skeletal"
    """`skeletal`: solid on one side of the surface; `sheet`: a wall along it between two separate pore networks."""

    grading: GradingParams | None = None
    """Porosity graded along an axis: `axis`, `porosity: [low end, high end]` and, in mm, `between: [low, high]`.

    Use it with `isosurface.iso: 0`; a different iso, or a porosity, raises or lowers the porosity everywhere.
    """

    origin: Annotated[tuple[float, float, float] | None, Unit("mm")] = None
    """Corner of a unit cell; by default the least corner of the outer shape's bounding box."""

    @model_validator(mode="after")
    def _fine_enough(self) -> TpmsFieldParams:
        spacing = self.grid.spacing if self.grid else self.voxel_size or 0.0
        if spacing > self.cell_size / _LEAST_SAMPLES:
            raise ValueError(
                f"{'grid.spacing' if self.grid else 'voxel_size'}: must be at most an eighth of cell_size "
                f"({self.cell_size / _LEAST_SAMPLES:g} mm) to resolve the surface, got {spacing:g}"
            )
        return self


METRICS = (
    Metric("tpms", "", "Surface of the field", "Triply periodic, and of which kind.", "How it was computed"),
    Metric("cell_size", "mm", "Cell size", "Edge of the cube that repeats.", "How it was computed"),
)
"""What the field's facts are."""


@stage(writes="field", version=2, metrics=METRICS)
def tpms_field(outer: OuterShape, *, params: TpmsFieldParams) -> ScalarField:
    """Compute the field of a triply periodic minimal surface, skeletal or sheet, over the outer shape.

    The field is f of the nodal approximation (von Schnering, Nesper 1991; formulas in `scaffold_geometry.fields.tpms`),
    or -|f| for a sheet, so that iso-values are the levels in the literature. With a grading, the level of the local
    porosity is subtracted. Samples more than two voxels outside the outer shape are void: they have the least value of
    the field. Raises `StageError` if no whole cell fits into the shape, or if the grid needs more memory than is free.
    """
    points = np.empty((0, 3)) if params.points is None else read_points(params.points)
    _require_a_cell(outer.bounds, params.cell_size)
    voxels = voxels_over(outer, params)
    level = _level(outer.bounds, params)
    values = _on_voxels(level, voxels)
    return ScalarField(
        values,
        voxels.origin,
        voxels.spacing,
        facts={"tpms": f"{params.surface}, {params.kind}", "cell_size": params.cell_size},
        points=points,
        point_values=level(*points.T),
        pore_networks=2 if params.kind == "sheet" else 1,
    )


def _require_a_cell(bounds: Floats, cell_size: float) -> None:
    extents = bounds[1] - bounds[0]
    least = float(extents.min())
    if cell_size > least * (1.0 + _ROUNDING):
        raise StageError(
            f"cell_size {cell_size:g} mm: must be at most the size of the outer shape, {least:.4g} mm along "
            f"{'xyz'[extents.argmin()]}; choose a third of that or less"
        )


def _level(bounds: Floats, params: TpmsFieldParams) -> Level:
    """Return the field as a function of coordinates x, y, z in mm, which broadcast."""
    from scaffold_geometry.fields import tpms

    surface = tpms.SURFACES[params.surface]
    if params.kind == "sheet":
        surface = tpms.sheet_of(surface)
    corner = bounds[0] if params.origin is None else np.array(params.origin)

    def level(x: Floats, y: Floats, z: Floats) -> Floats:
        phases = (
            2.0 * np.pi / params.cell_size * (place - start) for place, start in zip((x, y, z), corner, strict=True)
        )
        return surface(*phases)

    grading = params.grading
    if grading is None:
        return level
    axis = "xyz".index(grading.axis)
    low, high = grading.between or bounds[:, axis].tolist()
    steps = np.linspace(low, high, _STEPS)
    shifts = tpms.levels_at(surface, np.linspace(*grading.porosity, _STEPS))
    return lambda *places: level(*places) - np.interp(places[axis], steps, shifts)


def _on_voxels(level: Level, voxels: Voxels) -> NDArray[np.float32]:
    """Return the field on the voxels, plane by plane: the whole field in double precision needs too much memory."""
    x, y, z = voxels.axes
    values = np.empty(voxels.inside.shape, np.float32)
    for plane, place in zip(values, x, strict=True):
        plane[:] = level(place, y[:, None], z)
    values[~voxels.near] = values[voxels.near].min()
    values.setflags(write=False)  # the artifact does not copy a read-only array
    return values
