"""Stage `intersect_outer`: cut the porous surface to the outer shape, to make one printable solid."""

from __future__ import annotations

from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.artifacts import Fact, IsoSurface, OuterShape, Solid
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Millimetres, Params, Share, stage


class IntersectOuterParams(Params):
    """Parameters of `intersect_outer`."""

    skin: Millimetres = Field(default=0.0, ge=0.0)
    """Thickness of a solid shell under the outer surface; 0 leaves the pores open there."""

    min_closed_pore: Share = Field(default=0.001, ge=0.0, le=1.0)
    """Closed pores below this share of the pore volume are filled, as powder or resin could not leave them."""

    fill: bool = False
    """Whether all closed pores are filled, however large."""


@stage(writes="solid", version=6)
def intersect_outer(porous: IsoSurface, outer: OuterShape, *, params: IntersectOuterParams) -> Solid:
    """Cut the porous surface to the outer shape, optionally with a solid skin, and keep the largest piece.

    The outer surface of the solid is on the outer shape's own facets. Raises `StageError` if either surface is not a
    closed manifold, the skin leaves no pore, or nothing remains, and warns if the outer
    shape is in several bodies, of which one is filled.
    """
    from scaffold_geometry.surfaces import booleans
    from scaffold_geometry.surfaces.float32 import snap_to_float32

    _require_counted(porous, params.skin)
    shape = booleans.to_manifold(outer.vertices, outer.faces, "outer shape")
    _warn_of_bodies(booleans.split_shells(shape).volumes)
    core = booleans.offset_core(outer.vertices, outer.faces, params.skin)
    solid, void = booleans.clip_to_outer(
        booleans.to_manifold(porous.vertices, porous.faces, "porous surface"), shape, core
    )
    if solid.is_empty():
        raise StageError("nothing remains inside the outer shape; lower porosity or iso")
    shells = booleans.split_shells(solid)
    smallest_kept = 1.0 if params.fill else params.min_closed_pore
    kept = booleans.find_main_piece(shells, smallest_kept * (shape.volume() - solid.volume()))
    pores = booleans.pore_volumes(booleans.split_shells(void), kept, shape.volume())
    surface = outer.vertices, outer.faces
    rounded = snap_to_float32(*shells.mesh_of(kept.is_kept), "clipped solid")
    facts: dict[str, Fact] = {
        "rounding_distance_mm": rounded.moved,
        "clip_distance_mm": booleans.distance_from(shape, solid, kept.is_kept[shells.numbers], surface),
        "pieces_removed": len(kept.floating),
        "volume_removed_mm3": float(kept.floating.sum() - kept.foreign.sum()),
        "closed_pores": kept.closed_pores,
        "closed_pores_filled": len(kept.filled),
        "closed_pore_volume_filled_mm3": float(kept.filled.sum()),
    }
    return Solid(rounded.vertices, rounded.faces, pores, facts)


def _warn_of_bodies(volumes: Floats) -> None:
    """Tell of an outer shape in several bodies, by the volumes of its shells (k,), mm^3: one of them is filled."""
    bodies = volumes[volumes > 0.0]
    if len(bodies) > 1:
        share = 1.0 - bodies.max() / bodies.sum()
        warn(
            f"outer shape: is in {len(bodies)} bodies, but the solid is one piece: {share:.1%} of the volume stays "
            "empty and counts as pores; run each body alone, or load the largest by load_surface"
        )


def _require_counted(porous: IsoSurface, skin: float) -> None:
    """Require that the porosity was solved for with this skin, or the solid would have another."""
    if porous.porosity_requested is not None and porous.skin != skin:
        raise StageError(
            f"skin {skin:g} mm: the porosity was solved for a skin of {porous.skin:g} mm; leave isosurface.skin out, "
            "so that it has the same value"
        )
