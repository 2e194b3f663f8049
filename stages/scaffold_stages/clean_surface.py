"""Stage `clean_surface`: an iso-surface without crumbs and flat triangles, smoothed and simplified where asked for."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.triangles import drop_unreferenced, face_pieces, flat_faces, piece_volumes
from scaffold_pipeline.artifacts import Fact, IsoSurface
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays, call_in_child
from scaffold_pipeline.stages.contract import Millimetres, Params, Share, stage

TIME_LIMIT = 1800.0
"""Seconds; five million triangles take under a minute."""

_TAUBIN = {"lambda_": 0.5, "mu": -0.53}
"""Taubin, "A signal processing approach to fair surface design" (1995): shrink, then swell a little more."""

_VOLUME_STEPS = 4
_SMOOTHING_FILTER = "apply_coord_taubin_smoothing"
_REMEDY = "install the system's OpenGL libraries (Debian, Ubuntu: apt-get install libgl1 libopengl0)"

_FIRST_SHARE = 0.6
"""Share of the distance allowed that the first simplification gets: merges add up to as much as 1.5 times theirs, and
at a few places in a million to more, so that the distance is measured."""

_SIMPLIFICATIONS = 8


class CleanSurfaceParams(Params):
    """Parameters of `clean_surface`."""

    min_piece: Share = Field(default=0.001, ge=0.0, lt=1.0)
    """Floating pieces below this share of the solid's volume are removed, and closed pores as small are filled."""

    smoothing: int = Field(default=0, ge=0, le=200)
    """Steps of Taubin smoothing; the volume is kept."""

    simplify: Millimetres = Field(default=0.0, ge=0.0)
    """Triangles are merged where the surface moves by no more than this; 0 keeps them all."""


@stage(writes="porous", version=2, libraries=("libigl", "llvmlite", "manifold3d", "numba", "pymeshlab", "scipy", "vtk"))
def clean_surface(porous: IsoSurface, *, params: CleanSurfaceParams) -> IsoSurface:
    """Remove floating pieces and flat triangles; smooth at constant volume; simplify to an error in mm.

    Smoothing comes first: it counts on triangles as even as those of the grid. Raises `StageError` where MeshLab's
    libraries are missing or the surface is not closed.
    """
    kept, facts = _without_crumbs(porous, params.min_piece)
    vertices, faces = _without_flats(*drop_unreferenced(porous.vertices, kept))
    facts["flat_triangles_removed"] = len(kept) - len(faces)
    if params.smoothing:
        vertices = _smooth(vertices, faces, params.smoothing)
    if params.simplify > 0.0:
        count = len(faces)
        vertices, faces, facts["simplification_error"] = _simplify(vertices, faces, params.simplify)
        facts["triangles_merged"] = count - len(faces)
    return IsoSurface(vertices, faces, porous.iso, porous.porosity_requested, porous.skin, {**porous.facts, **facts})


def _without_crumbs(porous: IsoSurface, min_piece: float) -> tuple[Ints, dict[str, Fact]]:
    """Return the faces of the shells that are large enough, and what was left out."""
    pieces = face_pieces(porous.faces)
    volumes = piece_volumes(porous.vertices, porous.faces, pieces)
    least = min_piece * float(volumes[volumes > 0.0].sum())
    small, solid = np.abs(volumes) < least, volumes > 0.0
    if solid.any() and small[solid].all():
        raise StageError(
            f"min_piece {min_piece:g}: every one of {int(solid.sum())} pieces is smaller, the greatest has "
            f"{volumes.max() / volumes[solid].sum():.3g} of the volume; lower it"
        )
    facts: dict[str, Fact] = {
        "floating_pieces_removed": int((small & solid).sum()),
        "floating_volume_removed_mm3": float(volumes[small & solid].sum()),
        "closed_pores_filled": int((small & ~solid).sum()),
        "closed_pore_volume_filled_mm3": float(-volumes[small & ~solid].sum()),
    }
    return porous.faces[~small[pieces]], facts


def _without_flats(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the surface with an edge of each flat triangle collapsed: taking the triangle out would open a hole."""
    from scaffold_geometry.surfaces.booleans import from_manifold, simplify_manifold, to_manifold

    body = to_manifold(vertices, faces, "surface to clean")
    if not flat_faces(vertices, faces).any():
        return vertices, faces
    return from_manifold(simplify_manifold(body, 0.0))


def _smooth(vertices: Floats, faces: Ints, steps: int) -> Floats:
    answer = call_in_child(
        smooth_with_meshlab,
        {"vertices": vertices, "faces": faces},
        {"steps": steps},
        seconds=TIME_LIMIT,
        about=f"smoothing a surface of {len(faces)} triangles; try it without smoothing",
    )
    return _at_volume_of(vertices, answer["vertices"], faces)


def _simplify(vertices: Floats, faces: Ints, error: float) -> tuple[Floats, Ints, float]:
    """Return the surface with fewer triangles, and how far the two surfaces lie apart: no more than `error` mm."""
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


def _at_volume_of(old: Floats, vertices: Floats, faces: Ints) -> Floats:
    """Move a smoothed surface along its normals until it encloses the volume that it had."""
    wanted, _ = _volume_and_area(old, faces)
    for _ in range(_VOLUME_STEPS):
        volume, area = _volume_and_area(vertices, faces)
        if abs(volume - wanted) <= 1e-6 * abs(wanted):
            break
        vertices = vertices + (wanted - volume) / area * _normals(vertices, faces)
    return vertices


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


def smooth_with_meshlab(vertices: Floats, faces: Ints, steps: int) -> Arrays:
    """Return the smoothed `vertices` (n, 3); runs in a child process."""
    try:
        import pymeshlab
    except ImportError as error:
        raise StageError(f"pymeshlab cannot be loaded ({error}): {_REMEDY}") from error
    if _SMOOTHING_FILTER not in pymeshlab.filter_list():
        raise StageError(f"pymeshlab came up without its filter {_SMOOTHING_FILTER}: {_REMEDY}")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
    meshes.apply_filter(_SMOOTHING_FILTER, stepsmoothnum=steps, selected=False, **_TAUBIN)
    return {"vertices": meshes.current_mesh().vertex_matrix()}
