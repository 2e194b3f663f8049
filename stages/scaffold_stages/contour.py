"""Stage `contour`: what is solid of a planar field, at an iso-value or at the porosity asked for."""

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
"""How near the contour's porosity must come before the user is warned: a fifth of what the plate may be off."""

_FINEST = 1e-9
"""Share of the field's range to which the iso of a porosity is found: a field is steep where it is nearly 1 or -1."""


class ContourParams(Params):
    """Parameters of `contour`: `porosity` or `iso`, one of them."""

    porosity: Share | None = Field(default=None, gt=0.0, lt=1.0)
    """Share of the outline's area that shall be pores."""

    iso: Annotated[float | None, Unit("field value")] = None
    """The field's value at the contour, instead of a porosity: solid is where the field is above it."""

    min_piece: Share = Field(default=0.0, ge=0.0, lt=1.0)
    """Pieces below this share of the outline's area go, as slivers do that an outer shape cuts off; 0 keeps all."""

    @model_validator(mode="after")
    def _one_target(self) -> ContourParams:
        if (self.porosity is None) == (self.iso is None):
            raise ValueError("give either porosity or iso")
        return self


@stage(
    writes="contour", version=1, libraries=("libigl", "llvmlite", "manifold3d", "numba", "scikit-image", "scipy", "vtk")
)
def contour(field: ScalarField, mesh: PlanarMesh, outer: OuterShape | None = None, *, params: ContourParams) -> Contour:
    """Extract {field > iso} of a planar field as polygons, cut to the outline of its mesh; or meet a porosity.

    Where there is an outer shape, the outline is that of the mesh within its section in the plane. Raises `StageError`
    where the field has several layers or lies in another plane, and where no contour has the iso or the porosity; it
    tells which there are.
    """
    _require_planar(field, mesh)
    outline = regions.outline_of(mesh.vertices, mesh.cells)
    if outer is not None:
        outline ^= regions.section_at(outer.vertices, outer.faces, mesh.z)
    if outline.is_empty():
        raise StageError(f"nothing of the mesh lies in the section of the outer shape at z = {mesh.z:g} mm; move one")
    search = _Search(field, outline, params.min_piece)
    iso = _iso_of(search, params.porosity) if params.iso is None else params.iso
    if not search.least <= iso < search.greatest:
        raise StageError(
            f"iso {iso:g}: no contour within the outline, where the field runs from {search.least:.4g} to "
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
            f"the field has {layers} layers of samples, but a contour lies in one; give it the field of a planar mesh, "
            "or use isosurface"
        )
    if abs(z - mesh.z) > 1e-6 * field.spacing:
        raise StageError(f"the field lies at z = {z:g} mm, the mesh at {mesh.z:g}; give the field of this mesh")


class _Search:
    """What a porosity is a function of: the field within an outline, where it runs from `least` to `greatest`."""

    def __init__(self, field: ScalarField, outline: Region, min_piece: float) -> None:
        self.values: NDArray[np.float32] = field.values[:, :, 0]
        self.origin, self.spacing, self.outline = field.origin[:2], field.spacing, outline
        self.least_area = min_piece * float(outline.area())
        pixels = [(ring - self.origin) / self.spacing for ring in regions.rings_of(outline)]
        samples = self.values[regions.fill(pixels, (self.values.shape[0], self.values.shape[1]))]
        if not len(samples) or samples.min() == samples.max():
            raise StageError("the field is the same everywhere within the outline: it has no contour")
        self.least, self.greatest = float(samples.min()), float(samples.max())

    def solid_at(self, iso: float) -> Region:
        """Return what is solid at an iso, cut to the outline, without small pieces."""
        whole = regions.region_above(self.values, iso, self.origin, self.spacing) ^ self.outline
        return regions.without_small(whole, self.least_area) if self.least_area else whole

    def porosity_at(self, iso: float) -> float:
        """Return the share of the outline's area that is not solid at an iso."""
        return 1.0 - float(self.solid_at(iso).area() / self.outline.area())


def _iso_of(search: _Search, wanted: float | None) -> float:
    """Return the iso at which the porosity is the one wanted; a warning where it jumps over that."""
    from scipy.optimize import brentq

    wanted = wanted or 0.0
    below_greatest = float(np.nextafter(np.float32(search.greatest), np.float32(-np.inf)))  # some sample stays solid
    low, high = search.porosity_at(search.least), search.porosity_at(below_greatest)
    if not low < wanted < high:
        remedy = "more" if wanted <= low else "less"
        raise StageError(
            f"porosity {wanted:g}: out of reach, as this field gives {low:.4f} to {high:.4f}; ask for {remedy}"
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
            f"porosity {wanted:g}: no iso gives it; the nearest found has {got:.4f} at iso {iso:.4g}, as much of the "
            "field has that value; ask for another porosity, or lower voxel_size"
        )
    return iso
