"""Stage `clean_surface`: remove floating pieces, flat triangles and slivers of an iso-surface, with MeshLab."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.triangles import drop_unreferenced, face_pieces, flat_faces, piece_volumes
from scaffold_pipeline.artifacts import Fact, IsoSurface
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import Arrays, call_in_child
from scaffold_pipeline.stages.contract import Millimetres, Params, Share, Unit, stage

TIME_LIMIT = 1800.0
"""Seconds; five million triangles take under two minutes."""

_FIRST_SHARE = 0.6
"""Share of the allowed distance for the first simplification: merges add up to 1.5 times their tolerance, and at a few
places in a million to more, so that the distance is measured."""

_SIMPLIFICATIONS = 8


class CleanSurfaceParams(Params):
    """Parameters of `clean_surface`."""

    min_piece: Share = Field(default=0.001, ge=0.0, lt=1.0)
    """Floating pieces below this share of the solid's volume are removed, and closed pores of this size are filled."""

    # three steps leave a thousandth of the slivers and do not thin struts, ten break some: docs/decisions/cleaning.md
    smoothing: int = Field(default=3, ge=0, le=200)
    """Steps of Taubin smoothing, which removes terraces and slivers at constant volume; 0 turns it off."""

    most_moved: Annotated[float, Unit("voxels of the field")] = Field(default=0.5, gt=0.0)
    """Greatest distance by which smoothing moves a vertex; vertices move mostly along the surface."""

    simplify: Millimetres = Field(default=0.0, ge=0.0)
    """Greatest distance by which simplification moves the surface; 0 turns it off."""


@stage(writes="porous", version=3)
def clean_surface(porous: IsoSurface, *, params: CleanSurfaceParams) -> IsoSurface:
    """Clean the surface in MeshLab, remove floating pieces, smooth at constant volume, simplify to an error in mm.

    Duplicate vertices and triangles are merged, non-manifold edges and vertices split, flat triangles collapsed.
    Smoothing comes before simplification, as it needs the uniform triangles of the grid. Raises `StageError` if
    MeshLab's libraries are missing or the surface is not closed.
    """
    answer = call_in_child(
        clean_in_child,
        {"vertices": porous.vertices, "faces": porous.faces},
        {"min_piece": params.min_piece, "smoothing": params.smoothing},
        seconds=TIME_LIMIT,
        about=f"cleaning a surface of {len(porous.faces)} triangles; larger voxels make fewer",
    )
    vertices, faces, smoothed = (answer.pop(name) for name in ("vertices", "faces", "smoothed"))
    facts: dict[str, Fact] = {name: number.item() for name, number in answer.items()}
    if params.smoothing:
        vertices, moved = _smooth(vertices, smoothed, faces, porous.spacing, params.most_moved)
        facts |= moved
    if params.simplify > 0.0:
        count = len(faces)
        vertices, faces, facts["simplification_error"] = _simplify(vertices, faces, params.simplify)
        facts["triangles_merged"] = count - len(faces)
    return replace(porous, vertices=vertices, faces=faces, facts={**porous.facts, **facts})


def clean_in_child(vertices: Floats, faces: Ints, min_piece: float, smoothing: int) -> Arrays:
    """Return clean `vertices` and `faces`, the vertices `smoothed`, and counts of what was done, each of shape ()."""
    from scaffold_geometry.surfaces.meshlab import smooth_with_meshlab, weld_with_meshlab

    welded = weld_with_meshlab(vertices, faces)
    kept, facts = _without_crumbs(welded.vertices, welded.faces, min_piece)
    vertices, faces = _without_flats(*drop_unreferenced(welded.vertices, kept))
    facts |= {
        "flat_triangles_removed": len(kept) - len(faces),
        "duplicate_vertices_merged": welded.duplicate_vertices,
        "duplicate_triangles_removed": welded.duplicate_faces,
        "non_manifold_edges_split": welded.non_manifold_edges,
        "non_manifold_vertices_split": welded.non_manifold_vertices,
    }
    smoothed = smooth_with_meshlab(vertices, faces, smoothing) if smoothing else vertices
    numbers = {name: np.asarray(number) for name, number in facts.items()}
    return {"vertices": vertices, "faces": faces, "smoothed": smoothed, **numbers}


def _smooth(
    vertices: Floats, smoothed: Floats, faces: Ints, spacing: float | None, most_moved: float
) -> tuple[Floats, dict[str, Fact]]:
    """Return the smoothed vertices within their limit, and the distances moved; unlimited without a voxel size."""
    from scaffold_geometry.surfaces.smoothing import hold_smoothing

    held = hold_smoothing(vertices, smoothed, faces, np.inf if spacing is None else most_moved * spacing)
    if held.put_back == len(vertices):
        warn("smoothing: left out, as the surface would cross itself; lower smoothing or most_moved")
    return held.vertices, {
        "smoothing_distance_mm": held.moved,
        "smoothing_distance_voxels": None if spacing is None else held.moved / spacing,
        "smoothing_offset_rms_mm": held.offset,
        "smoothing_vertices_put_back": held.put_back,
    }


def _without_crumbs(vertices: Floats, faces: Ints, min_piece: float) -> tuple[Ints, dict[str, int | float]]:
    """Return the faces of the shells that are large enough, and counts of those removed.

    By labelling: MeshLab removes pieces by triangles or diameter, not volume, and takes 5 times as long for 5 pieces.
    """
    pieces = face_pieces(faces)
    volumes = piece_volumes(vertices, faces, pieces)
    least = min_piece * float(volumes[volumes > 0.0].sum())
    small, solid = np.abs(volumes) < least, volumes > 0.0
    if solid.any() and small[solid].all():
        raise StageError(
            f"min_piece {min_piece:g}: every one of {int(solid.sum())} pieces is smaller, the largest has "
            f"{volumes.max() / volumes[solid].sum():.3g} of the volume; lower it"
        )
    facts: dict[str, int | float] = {
        "floating_pieces_removed": int((small & solid).sum()),
        "floating_volume_removed_mm3": float(volumes[small & solid].sum()),
        "closed_pores_filled": int((small & ~solid).sum()),
        "closed_pore_volume_filled_mm3": float(-volumes[small & ~solid].sum()),
    }
    return faces[~small[pieces]], facts


def _without_flats(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface with an edge of each flat triangle collapsed: removing the triangle would open a hole.

    By Manifold: `meshing_remove_null_faces` of MeshLab removes it; `meshing_remove_t_vertices`, which collapses it,
    left edges of more than two triangles if 5 % were flat.
    """
    from scaffold_geometry.surfaces.booleans import from_manifold, simplify_manifold, to_manifold

    body = to_manifold(vertices, faces, "surface to clean")
    if not flat_faces(vertices, faces).any():
        return vertices, faces
    return from_manifold(simplify_manifold(body, 0.0))


def _simplify(vertices: Floats, faces: Ints, error: float) -> tuple[Floats, Ints, float]:
    """Return the surface with fewer triangles, and its distance from the original: at most `error` mm.

    By Manifold, which takes a distance: MeshLab's quadric simplification with topology kept takes a number of
    triangles, needs three times as long, and moves the surface 1.5 times as far.
    """
    from scaffold_geometry.surfaces.booleans import from_manifold, simplify_manifold, to_manifold

    body, allowed = to_manifold(vertices, faces, "surface to simplify"), _FIRST_SHARE * error
    for _ in range(_SIMPLIFICATIONS):
        fewer_vertices, fewer_faces = from_manifold(simplify_manifold(body, allowed))
        apart = _distance(vertices, faces, fewer_vertices, fewer_faces)
        if apart <= error:
            return fewer_vertices, fewer_faces, apart
        allowed *= max(0.5, 0.9 * error / apart)
    return vertices, faces, 0.0


def _distance(vertices: Floats, faces: Ints, other_vertices: Floats, other_faces: Ints) -> float:
    """Return the greatest distance of the vertices and face centres of either surface from the other, mm."""
    import igl

    points = np.concatenate([vertices, vertices[faces].mean(axis=1)])
    other_points = np.concatenate([other_vertices, other_vertices[other_faces].mean(axis=1)])
    there, _, _ = igl.point_mesh_squared_distance(points, other_vertices, other_faces)
    back, _, _ = igl.point_mesh_squared_distance(other_points, vertices, faces)
    return float(np.sqrt(max(there.max(), back.max())))
