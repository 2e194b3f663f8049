"""Stage `isosurface`: the boundary between solid and void, at an iso-value or at the porosity asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.voxels.grids import samples_inside
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.artifacts import Fact, IsoSurface, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Follows, Millimetres, Params, Share, Unit, stage

TOLERANCE = 1e-3
"""Tolerance of the clipped solid's porosity: a fifth of the tolerance for the written file."""

ROUNDS = 12

_QUANTILES = 4097


class IsosurfaceParams(Params):
    """Parameters of `isosurface`: `porosity` or `iso`, one of them."""

    porosity: Share | None = Field(default=None, gt=0.0, lt=1.0)
    """Share of the outer shape's volume that is pore, after the clip to the outer shape."""

    iso: Annotated[float | None, Unit("field value")] = None
    """The field's value at the surface, instead of a porosity: the solid is where the field is above it."""

    skin: Annotated[Millimetres, Follows("intersect_outer", "skin")] = Field(default=0.0, ge=0.0)
    """Thickness of the shell that `intersect_outer` keeps: counted as solid in the porosity."""

    min_closed_pore: Annotated[Share, Follows("intersect_outer", "min_closed_pore")] = Field(
        default=0.001, ge=0.0, le=1.0
    )
    """Closed pores below this share of the pore volume, which `intersect_outer` fills: also counted as solid."""

    fill: Annotated[bool, Follows("intersect_outer", "fill")] = False
    """Whether `intersect_outer` fills all closed pores."""

    @model_validator(mode="after")
    def _one_target(self) -> IsosurfaceParams:
        if (self.porosity is None) == (self.iso is None):
            raise ValueError("give either porosity or iso")
        return self


@stage(writes="porous", version=4)
def isosurface(field: ScalarField, outer: OuterShape, *, params: IsosurfaceParams) -> IsoSurface:
    """Extract the closed surface of {field > iso}; a porosity is solved for on the volume of the clipped solid.

    Raises `StageError` if there is no surface at the iso-value, or the skin leaves no room for the porosity. If no
    iso-value gives the porosity, the nearest one is used, with a warning.
    """
    if field.values.shape[2] == 1:
        raise StageError(
            "the field is one layer of samples, which bounds no solid; use a grid with more along z, or contour and "
            "extrude for a plate"
        )
    inside = samples_inside(outer.vertices, outer.faces, field.origin, field.spacing, field.values.shape)
    samples = np.sort(field.values[inside])
    if not len(samples) or samples[0] == samples[-1]:
        raise StageError("the field is the same everywhere inside the outer shape: it has no iso-surface")
    if params.iso is None:
        return _at_porosity(_Search(field, outer, samples, params))
    if not samples[0] <= params.iso < samples[-1]:
        raise StageError(
            f"iso {params.iso:g}: no surface inside the outer shape, where the field runs from {samples[0]:.4g} to "
            f"{samples[-1]:.4g}; choose a value between"
        )
    vertices, faces = extract_iso_surface(field.values, params.iso, field.origin, field.spacing)
    return IsoSurface(vertices, faces, iso=params.iso, skin=params.skin, spacing=field.spacing)


@dataclass(frozen=True, eq=False)
class _Trial:
    """One tried iso-value: the share of samples at or below it, its surface, and the porosity of its solid."""

    share: float
    porosity: float
    iso: float
    vertices: Floats
    faces: Ints


class _Search:
    """Porosity as a function of the share of samples at or below the iso-value, which is nearly linear."""

    def __init__(
        self, field: ScalarField, outer: OuterShape, samples: NDArray[np.float32], params: IsosurfaceParams
    ) -> None:
        from scaffold_geometry.surfaces.booleans import offset_core, to_manifold

        self.field, self.last = field, samples[-1]
        self.isos, self.shares = _quantiles(samples)
        self.porosity, self.skin = params.porosity or 0.0, params.skin
        self.smallest_kept = 1.0 if params.fill else params.min_closed_pore
        self.shape = to_manifold(outer.vertices, outer.faces, "outer shape")
        self.core = offset_core(outer.vertices, outer.faces, params.skin)
        self.greatest = (self.shape if self.core is None else self.core).volume() / self.shape.volume()

    def at(self, share: float) -> _Trial:
        """Try an iso-value: clip its surface and measure the solid that `intersect_outer` will keep."""
        from scaffold_geometry.surfaces.booleans import clip_to_outer, find_main_piece, split_shells, to_manifold

        below_last = np.nextafter(self.last, -np.inf, dtype=np.float32)  # some sample stays above it
        iso = min(float(np.interp(share, self.shares, self.isos)), float(below_last))
        vertices, faces = extract_iso_surface(self.field.values, iso, self.field.origin, self.field.spacing)
        solid, _ = clip_to_outer(to_manifold(vertices, faces, f"iso-surface at {iso:.4g}"), self.shape, self.core)
        volume = self.shape.volume()
        least = self.smallest_kept * (volume - solid.volume())
        kept = 0.0 if solid.is_empty() else find_main_piece(split_shells(solid), least).volume
        return _Trial(share, 1.0 - kept / volume, iso, vertices, faces)


def _quantiles(samples: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Return some thousand ascending values of sorted samples, and the share of samples below each.

    A value of many samples, as in a symmetric field, counts once, at the middle of its run: otherwise the iso-value
    would not change there, and jump beside it.
    """
    places = np.linspace(0.0, len(samples) - 1.0, min(len(samples), _QUANTILES)).astype(int)
    values, first, counts = np.unique(samples[places], return_index=True, return_counts=True)
    return values.astype(np.float64), (first + (counts - 1) / 2.0) / (len(places) - 1)


@dataclass
class _Bracket:
    """The bracket of the root: on either side a share and its porosity error, narrowed by the Illinois method.

    Dowell and Jarratt, "A modified regula falsi method for computing the root of an equation", BIT 11 (1971).
    """

    below: float
    above: float
    low: float = 0.0
    high: float = 1.0
    last: float = 0.0

    def guess(self) -> float:
        """Return the zero of the line between the two sides."""
        return self.low - self.below * (self.high - self.low) / (self.above - self.below)

    def narrow(self, share: float, miss: float) -> None:
        """Replace one side; the error of a side that stays twice in a row is halved, so that it moves."""
        is_repeated = miss * self.last > 0.0
        if miss > 0.0:
            self.high, self.above = share, miss
            self.below /= 2.0 if is_repeated else 1.0
        else:
            self.low, self.below = share, miss
            self.above /= 2.0 if is_repeated else 1.0
        self.last = miss


def _at_porosity(search: _Search) -> IsoSurface:
    """Find the iso-value of a porosity."""
    wanted = search.porosity
    if not wanted < search.greatest:
        raise StageError(
            f"porosity {wanted:g}: a skin of {search.skin:g} mm leaves at most {search.greatest:.3f}; lower one of them"
        )
    bracket = _Bracket(-wanted, search.greatest - wanted)
    best, rounds = search.at(bracket.guess()), 1
    bracket.narrow(best.share, best.porosity - wanted)
    while abs(best.porosity - wanted) > TOLERANCE and rounds < ROUNDS:
        trial, rounds = search.at(bracket.guess()), rounds + 1
        bracket.narrow(trial.share, trial.porosity - wanted)
        best = min(best, trial, key=lambda one: abs(one.porosity - wanted))
    if abs(best.porosity - wanted) > TOLERANCE:
        warn(
            f"porosity {wanted:g}: no iso-value gives it; the nearest is {best.porosity:.4f} at iso {best.iso:.4g}, "
            "as pores close or pieces separate all at once there; choose another porosity, or lower voxel_size"
        )
    facts: dict[str, Fact] = {"porosity_solved": best.porosity, "rounds": rounds}
    return IsoSurface(best.vertices, best.faces, best.iso, wanted, search.skin, facts, search.field.spacing)
