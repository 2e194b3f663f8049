"""The exact union of all that a closed surface encloses: its triangles are cut where they cross; sharp edges stay.

Q. Zhou, E. Grinspun, D. Zorin, A. Jacobson, "Mesh arrangements for solid geometry", ACM Transactions on Graphics 35
(2016).
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.booleans import from_manifold, simplify_manifold, to_manifold
from scaffold_geometry.surfaces.edges import Surface
from scaffold_geometry.surfaces.repair.non_manifold import try_split_non_manifold
from scaffold_geometry.surfaces.self_intersections import find_self_intersections
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays

_SIMPLER = 1e-6
"""Tolerance, as a share of the greatest coordinate, for merging the slivers made by cutting."""


def resolve_self_intersections(vertices: Floats, faces: Ints) -> Arrays:
    """Return `vertices` and `faces` of the boundary of winding number 1 or more; for a child process.

    Raises `StageError` if it is not closed and free of self-intersections after rounding.
    """
    whole = _unite(vertices, faces)
    fault = _fault(*whole)
    if fault:
        raise StageError(f"its union, cut where it crosses itself, {fault}")
    simpler = without_slivers(*whole, _SIMPLER * float(np.abs(whole[0]).max()))
    return {"vertices": simpler[0], "faces": simpler[1]}


def _unite(vertices: Floats, faces: Ints) -> Surface:
    from igl.copyleft import cgal

    nothing = np.empty((0, 3)), np.empty((0, 3), np.int64)
    try:
        new, corners, _ = cgal.mesh_boolean(
            np.ascontiguousarray(vertices), np.ascontiguousarray(faces), *nothing, "union"
        )
    except RuntimeError as error:
        raise StageError(f"it cannot be cut where it crosses itself ({error})") from error
    if not len(corners):
        raise StageError("it encloses nothing")
    return try_split_non_manifold(*_in_order(new, np.asarray(corners, np.int64)))


def _in_order(vertices: Floats, faces: Ints) -> Surface:
    """Return the surface with its vertices and faces sorted, as their order after cutting is not deterministic."""
    order = np.lexsort(vertices.T[::-1])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(vertices[order]), np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])])


def without_slivers(vertices: Floats, faces: Ints, tolerance: float) -> Surface:
    """Return a closed surface with fewer triangles, moved by about `tolerance` at most; unchanged if this fails."""
    simpler = from_manifold(simplify_manifold(to_manifold(vertices, faces, "the rebuilt surface"), tolerance))
    return (vertices, faces) if _fault(*simpler) else simpler


def _fault(vertices: Floats, faces: Ints) -> str:
    """Return why the surface, with coincident vertices merged, does not bound a solid, or an empty text."""
    places, corners = triangles.merge_coincident(vertices, faces)
    faults = triangles.edge_faults(corners)
    if any(faults):
        return f"has {sum(faults)} edges without two faces"
    touching = triangles.touching_vertices(corners)
    if touching:
        return f"touches itself at {touching} vertices"
    crossing = len(find_self_intersections(places, corners)["faces"])
    return f"has {crossing} triangles that cross others" if crossing else ""
