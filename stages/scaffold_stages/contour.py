"""Stage `contour`: the solid region of a planar field, at a given iso-value or porosity."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_geometry.planar import regions
from scaffold_geometry.planar.regions import Region
from scaffold_pipeline.artifacts import Contour, OuterShape, PlanarMesh, Polygons, ScalarField
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Params, Share, Unit, stage

TOLERANCE = 1e-3
"""Error of the contour's porosity above which the user is warned: a fifth of the plate's tolerance."""

_FINEST = 1e-9
"""Precision of the iso-value of a porosity, as a share of the field's range: porosity is sensitive near 1 and -1."""


class ContourParams(Params):
    """Parameters of `contour`: either `porosity` or `iso`."""

    porosity: Share | None = Field(default=None, gt=0.0, lt=1.0)
    """Pore area as a share of the outline's area."""

    iso: Annotated[float | None, Unit("field value")] = None
    """Iso-value, instead of a porosity: the solid is where the field is greater."""

    min_piece: Share = Field(default=0.0, ge=0.0, lt=1.0)
    """Pieces smaller than this share of the outline's area are removed, such as slivers at the cut; 0 keeps all."""

    @model_validator(mode="after")
    def _one_target(self) -> ContourParams:
        if (self.porosity is None) == (self.iso is None):
            raise ValueError("give either porosity or iso")
        return self


@stage(writes="contour", version=1)
def contour(field: ScalarField, mesh: PlanarMesh, outer: OuterShape | None = None, *, params: ContourParams) -> Contour:
    """Extract {field > iso} of a planar field as polygons, cut to the mesh's outline, at an iso-value or a porosity.

    With an outer shape, the outline is that of the mesh inside the section of the outer shape. Raises `StageError` if
    the field has several layers or lies in a different plane, or if no contour has the iso-value or porosity; the
    message gives the possible range.
    """
    _require_planar(field, mesh)
    outline = regions.outline_of(mesh.vertices, mesh.cells)
    if outer is not None:
        outline ^= regions.section_at(outer.vertices, outer.faces, mesh.z)
    if outline.is_empty():
        raise StageError(f"mesh: no part of it lies inside the outer shape at z = {mesh.z:g} mm; move one of the two")
    search = _Search(field, outline, params.min_piece)
    iso = _iso_of(search, params.porosity) if params.iso is None else params.iso
    if not search.least <= iso < search.greatest:
        raise StageError(
            f"iso {iso:g}: must be within the range of the field inside the outline, {search.least:.4g} to "
            f"{search.greatest:.4g}; choose a value between"
        )
    region = search.solid_at(iso)
    if region.is_empty():
        raise StageError(f"iso {iso:g}: no piece of solid is left within the outline; lower min_piece or iso")
    solid, whole = (Polygons.of(regions.rings_of(each)) for each in (region, outline))
    return Contour(solid, whole, mesh.z, iso, params.porosity)


def _require_planar(field: ScalarField, mesh: PlanarMesh) -> None:
    layers, z = field.values.shape[2], float(field.origin[2])
    if layers > 1:
        raise StageError(
            f"field: must have one layer of samples for a contour, got {layers}; use the field of a planar mesh, or "
            "isosurface"
        )
    if abs(z - mesh.z) > 1e-6 * field.spacing:
        raise StageError(f"field: must lie in the mesh's plane, z = {mesh.z:g} mm, got {z:g}; use this mesh's field")


class _Search:
    """Porosity as a function of the iso-value: the field inside an outline, with values from `least` to `greatest`."""

    def __init__(self, field: ScalarField, outline: Region, min_piece: float) -> None:
        self.values: NDArray[np.float32] = field.values[:, :, 0]
        self.origin, self.spacing, self.outline = field.origin[:2], field.spacing, outline
        self.least_area = min_piece * float(outline.area())
        pixels = [(ring - self.origin) / self.spacing for ring in regions.rings_of(outline)]
        samples = self.values[regions.rasterise(pixels, (self.values.shape[0], self.values.shape[1]))]
        if not len(samples) or samples.min() == samples.max():
            raise StageError("field: is constant inside the outline and has no contour; check the mesh and voxel_size")
        self.least, self.greatest = float(samples.min()), float(samples.max())

    def solid_at(self, iso: float) -> Region:
        """Return the solid region at an iso-value, cut to the outline, without small pieces."""
        whole = regions.region_above(self.values, iso, self.origin, self.spacing) ^ self.outline
        return regions.remove_small_pieces(whole, self.least_area) if self.least_area else whole

    def porosity_at(self, iso: float) -> float:
        """Return the share of the outline's area that is not solid at an iso-value."""
        return 1.0 - float(self.solid_at(iso).area() / self.outline.area())


def _iso_of(search: _Search, wanted: float | None) -> float:
    """Return the iso-value at which the porosity is `wanted`; warns if the porosity jumps over it."""
    from scipy.optimize import brentq

    wanted = wanted or 0.0
    below_greatest = float(np.nextafter(np.float32(search.greatest), np.float32(-np.inf)))  # some sample stays solid
    low, high = search.porosity_at(search.least), search.porosity_at(below_greatest)
    if not low < wanted < high:
        remedy = "raise" if wanted <= low else "lower"
        raise StageError(
            f"porosity {wanted:g}: must be within the range of this field, {low:.4f} to {high:.4f}; {remedy} porosity"
        )
    iso = float(
        brentq(
            lambda level: search.porosity_at(level) - wanted,
            search.least,
            below_greatest,
            xtol=_FINEST * (search.greatest - search.least),
        )
    )
    got = search.porosity_at(iso)
    if abs(got - wanted) > TOLERANCE:
        warn(
            f"porosity {wanted:g}: no iso-value gives it; the nearest is {got:.4f} at iso {iso:.4g}, because a large "
            "part of the field has this value; choose a different porosity, or lower voxel_size"
        )
    return iso
