"""Stage `clean_surface`: an iso-surface without crumbs and flat triangles, smoothed and simplified where asked for."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from scaffold_pipeline.artifacts import Fact, Floats, Ints, IsoSurface
from scaffold_pipeline.contract import Millimetres, Params, Share, stage
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.isolation import Arrays, call_in_child

TIME_LIMIT = 1800.0
"""Seconds; five million triangles take under a minute."""

_TAUBIN = {"lambda_": 0.5, "mu": -0.53}
"""Taubin, "A signal processing approach to fair surface design" (1995): shrink, then swell a little more."""

_VOLUME_STEPS = 4
_NEEDED_FILTER = "meshing_isotropic_explicit_remeshing"
"""MeshLab's filters come as plug-ins; this one is missing where their system libraries are."""


class CleanSurfaceParams(Params):
    """Parameters of `clean_surface`."""

    min_piece: Share = Field(default=0.001, ge=0.0, lt=1.0)
    """Floating pieces below this share of the solid's volume are removed, and closed pores as small are filled."""

    smoothing: int = Field(default=0, ge=0, le=200)
    """Steps of Taubin smoothing; the volume is kept."""

    simplify: Millimetres = Field(default=0.0, ge=0.0)
    """Triangles are merged where the surface moves by no more than this; 0 keeps them all."""


@stage(writes="porous", version=1)
def clean_surface(porous: IsoSurface, *, params: CleanSurfaceParams) -> IsoSurface:
    """Remove flat triangles and floating pieces; smooth at constant volume; simplify to an error in mm.

    Raises `StageError` where MeshLab's libraries are missing or the cleaned surface is no longer closed.
    """
    from scaffold_stages._kernels.solids import from_body, simplified, to_body
    from scaffold_stages._kernels.triangles import drop_unreferenced

    kept, facts = _without_crumbs(porous, params.min_piece)
    vertices, faces = drop_unreferenced(porous.vertices, kept)
    answer = call_in_child(
        clean_with_meshlab,
        {"vertices": vertices, "faces": faces},
        {"smoothing": params.smoothing},
        seconds=TIME_LIMIT,
        about=f"cleaning a surface of {len(faces)} triangles; try it without smoothing",
    )
    facts["flat_triangles_removed"] = len(faces) - len(answer["faces"])
    vertices, faces = _at_volume_of(porous.vertices, kept, answer["vertices"], answer["faces"])
    body = to_body(vertices, faces, "cleaned surface")
    if params.simplify > 0.0:
        vertices, faces = from_body(simplified(body, params.simplify))
        facts["triangles_merged"] = len(answer["faces"]) - len(faces)
    return IsoSurface(vertices, faces, porous.iso, porous.porosity_requested, porous.skin, {**porous.facts, **facts})


def _without_crumbs(porous: IsoSurface, min_piece: float) -> tuple[Ints, dict[str, Fact]]:
    """Return the faces of the shells that are large enough, and what was left out."""
    from scaffold_stages._kernels.triangles import face_pieces, piece_volumes

    pieces = face_pieces(porous.faces)
    volumes = piece_volumes(porous.vertices, porous.faces, pieces)
    least = min_piece * float(volumes[volumes > 0.0].sum())
    small = np.abs(volumes) < least
    facts: dict[str, Fact] = {
        "floating_pieces_removed": int((small & (volumes > 0.0)).sum()),
        "floating_volume_removed_mm3": float(volumes[small & (volumes > 0.0)].sum()),
        "closed_pores_filled": int((small & (volumes <= 0.0)).sum()),
        "closed_pore_volume_filled_mm3": float(-volumes[small & (volumes <= 0.0)].sum()),
    }
    return porous.faces[~small[pieces]], facts


def _at_volume_of(
    old_vertices: Floats, old_faces: Ints, vertices: Floats, faces: Ints
) -> tuple[Floats, Ints]:
    """Move a smoothed surface along its normals until it encloses the volume that it had."""
    wanted, _ = _volume_and_area(old_vertices, old_faces)
    for _ in range(_VOLUME_STEPS):
        volume, area = _volume_and_area(vertices, faces)
        if abs(volume - wanted) <= 1e-6 * abs(wanted):
            break
        vertices = vertices + (wanted - volume) / area * _normals(vertices, faces)
    return vertices, faces


def _volume_and_area(vertices: Floats, faces: Ints) -> tuple[float, float]:
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0), float(doubled.sum() / 2.0)


def _normals(vertices: Floats, faces: Ints) -> Floats:
    """Return the unit normal at each vertex, weighted by area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normals[:, axis], 3), len(vertices)) for axis in range(3)], axis=1
    )
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(float).tiny))


def clean_with_meshlab(vertices: Floats, faces: Ints, smoothing: int) -> Arrays:
    """Return the surface without flat and repeated triangles, smoothed; runs in a child process."""
    try:
        import pymeshlab
    except ImportError as error:
        raise StageError(f"pymeshlab cannot be loaded ({error}): {_REMEDY}") from error
    if _NEEDED_FILTER not in pymeshlab.filter_list():
        raise StageError(f"pymeshlab came up without many of its filters: {_REMEDY}")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
    meshes.apply_filter("meshing_remove_duplicate_faces")
    meshes.apply_filter("meshing_remove_null_faces")
    meshes.apply_filter("meshing_remove_unreferenced_vertices")
    if smoothing:
        meshes.apply_filter("apply_coord_taubin_smoothing", stepsmoothnum=smoothing, selected=False, **_TAUBIN)
    cleaned = meshes.current_mesh()
    return {"vertices": cleaned.vertex_matrix(), "faces": cleaned.face_matrix().astype(np.int64)}


_REMEDY = "install the system's OpenGL libraries (Debian, Ubuntu: apt-get install libgl1 libopengl0)"
