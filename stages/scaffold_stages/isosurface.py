"""Stage `isosurface`: the boundary between solid and void, at an iso-value or at the porosity asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, model_validator

from scaffold_pipeline.artifacts import Fact, Floats, Ints, IsoSurface, OuterShape, ScalarField
from scaffold_pipeline.contract import Follows, Millimetres, Params, Share, stage
from scaffold_pipeline.errors import StageError
from scaffold_stages._kernels.contours import inward_offset, iso_surface
from scaffold_stages._kernels.grids import samples_inside

if TYPE_CHECKING:
    from scaffold_stages._kernels.solids import Body

TOLERANCE = 1e-3
"""How near the clipped solid's porosity must come: a fifth of what the written file may be off."""

ROUNDS = 8


class IsosurfaceParams(Params):
    """Parameters of `isosurface`: `porosity` or `iso`, one of them."""

    porosity: Share | None = Field(default=None, gt=0.0, lt=1.0)
    """Share of the outer shape's volume that shall be pores, met on the clipped solid."""

    iso: float | None = None
    """The field's value at the surface, instead of a porosity: solid is where the field is above it."""

    skin: Annotated[Millimetres, Follows("intersect_outer", "skin")] = Field(default=0.0, ge=0.0)
    """Thickness of the shell that `intersect_outer` will keep: counted as solid in meeting the porosity."""

    @model_validator(mode="after")
    def _one_target(self) -> IsosurfaceParams:
        if (self.porosity is None) == (self.iso is None):
            raise ValueError("give either porosity or iso")
        return self


@stage(writes="porous", version=1)
def isosurface(field: ScalarField, outer: OuterShape, *, params: IsosurfaceParams) -> IsoSurface:
    """Extract the closed surface of {field > iso}; a porosity is solved for on the volume of the clipped solid.

    Raises `StageError` where no surface exists at the iso, or no iso gives the porosity.
    """
    inside = samples_inside(outer.vertices, outer.faces, field.origin, field.spacing, field.values.shape)
    samples = np.sort(field.values[inside])
    if not len(samples) or samples[0] == samples[-1]:
        raise StageError("the field is the same everywhere inside the outer shape: it has no iso-surface")
    if params.iso is not None:
        vertices, faces = _surface(field, params.iso, samples)
        return IsoSurface(vertices, faces, iso=params.iso, skin=params.skin)
    return _at_porosity(field, outer, samples, params.porosity or 0.0, params.skin)


def _surface(field: ScalarField, iso: float, samples: Floats) -> tuple[Floats, Ints]:
    vertices, faces = iso_surface(field.values, iso, field.origin, field.spacing)
    if not len(faces):
        low, high = float(samples[0]), float(samples[-1])
        raise StageError(f"iso {iso:g}: no surface; inside the outer shape the field runs from {low:.3g} to {high:.3g}")
    return vertices, faces


@dataclass(frozen=True, eq=False)
class _Trial:
    """One iso tried: the share of samples below it, its surface, and the porosity that its solid has."""

    share: float
    iso: float
    vertices: Floats
    faces: Ints
    porosity: float


def _at_porosity(field: ScalarField, outer: OuterShape, samples: Floats, porosity: float, skin: float) -> IsoSurface:
    """Search in the share of samples below the iso, in which porosity is nearly linear, by regula falsi."""
    from scaffold_stages._kernels.solids import to_body

    shape = to_body(outer.vertices, outer.faces, "outer shape")
    core = _core(outer, skin, porosity)
    pores = (shape if core is None else core).volume() / shape.volume()
    low, high = (0.0, 0.0), (1.0, pores)
    share = porosity / pores
    if not 0.0 < share < 1.0:
        raise StageError(f"porosity {porosity:g}: a skin of {skin:g} mm leaves at most {pores:.3f}; lower one of them")
    for rounds in range(1, ROUNDS + 1):
        trial = _try(field, samples, share, shape, core)
        if abs(trial.porosity - porosity) <= TOLERANCE:
            facts: dict[str, Fact] = {"porosity_solved": trial.porosity, "rounds": rounds}
            return IsoSurface(trial.vertices, trial.faces, trial.iso, porosity, skin, facts)
        low, high = (low, (share, trial.porosity)) if trial.porosity > porosity else ((share, trial.porosity), high)
        share = low[0] + (high[0] - low[0]) * (porosity - low[1]) / (high[1] - low[1])
    raise StageError(
        f"porosity {porosity:g}: after {ROUNDS} rounds the solid has {trial.porosity:.4f} at iso {trial.iso:.4g}; the "
        "pores are too coarse for the voxels: lower voxel_size"
    )


def _core(outer: OuterShape, skin: float, porosity: float) -> Body | None:
    from scaffold_stages._kernels.solids import to_body

    if skin == 0.0:
        return None
    vertices, faces = inward_offset(outer.vertices, outer.faces, skin)
    if not len(faces):
        raise StageError(f"skin {skin:g} mm: the outer shape is nowhere so thick, so porosity {porosity:g} has no room")
    return to_body(vertices, faces, f"inward offset by {skin:g} mm")


def _try(field: ScalarField, samples: Floats, share: float, shape: Body, core: Body | None) -> _Trial:
    from scaffold_stages._kernels.solids import clipped, shells_of, to_body

    iso = float(np.quantile(samples, share))
    vertices, faces = _surface(field, iso, samples)
    solid, _ = clipped(to_body(vertices, faces, f"iso-surface at {iso:.4g}"), shape, core)
    pieces = shells_of(solid).pieces
    kept = pieces[0].volume() if pieces else 0.0
    return _Trial(share, iso, vertices, faces, 1.0 - kept / shape.volume())
