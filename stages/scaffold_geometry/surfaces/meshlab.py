"""MeshLab's filters on arrays; no other module imports pymeshlab (Cignoni et al., "MeshLab", 2008).

MeshLab can crash: call these functions in a child process. Every parameter of a filter is given at every call, as some
filters keep those of the last call. Vertices are (n, 3) mm, faces (m, 3).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_pipeline.errors import StageError

_REMEDY = "install the system's OpenGL libraries (Debian, Ubuntu: apt-get install libgl1 libopengl0)"

_DUPLICATE_VERTICES = "meshing_remove_duplicate_vertices"
_DUPLICATE_FACES = "meshing_remove_duplicate_faces"
_UNREFERENCED = "meshing_remove_unreferenced_vertices"
_NON_MANIFOLD_EDGES = "meshing_repair_non_manifold_edges"
_NON_MANIFOLD_VERTICES = "meshing_repair_non_manifold_vertices"
_TAUBIN = "apply_coord_taubin_smoothing"
_TOPOLOGY = "get_topological_measures"

_TAUBIN_WEIGHTS = {"lambda_": 0.5, "mu": -0.53}
"""Taubin, "A signal processing approach to fair surface design" (1995): shrink, then swell a little more."""


MeshSet = Any
"""A `pymeshlab.MeshSet`, which has no type information."""


class Welded(NamedTuple):
    """A surface with distinct vertices and two faces at each edge, and the counts of merged and split elements."""

    vertices: Floats
    faces: Ints
    duplicate_vertices: int
    duplicate_faces: int
    non_manifold_edges: int
    non_manifold_vertices: int


def weld_with_meshlab(vertices: Floats, faces: Ints) -> Welded:
    """Merge coincident vertices, remove duplicate faces, and split non-manifold edges and vertices.

    Unused vertices are removed too. Raises `StageError` if MeshLab's libraries are missing.
    """
    filters = (_DUPLICATE_VERTICES, _DUPLICATE_FACES, _NON_MANIFOLD_EDGES, _NON_MANIFOLD_VERTICES, _UNREFERENCED)
    meshes = _mesh_set(vertices, faces, *filters, _TOPOLOGY)
    meshes.apply_filter(_UNREFERENCED)
    used, _ = _counts(meshes)
    meshes.apply_filter(_DUPLICATE_VERTICES)
    meshes.apply_filter(_UNREFERENCED)
    places, kept = _counts(meshes)
    meshes.apply_filter(_DUPLICATE_FACES)
    _, single = _counts(meshes)
    found = meshes.apply_filter(_TOPOLOGY)
    edges, points = int(found["non_two_manifold_edges"]), int(found["non_two_manifold_vertices"])
    if edges:
        meshes.apply_filter(_NON_MANIFOLD_EDGES, method="Split Vertices")  # the other method removes faces
    if points:
        meshes.apply_filter(_NON_MANIFOLD_VERTICES, vertdispratio=0.0)  # split where it is: nothing moves
    meshes.apply_filter(_UNREFERENCED)
    return Welded(*_arrays(meshes), used - places, kept - single, edges, points)


def smooth_with_meshlab(vertices: Floats, faces: Ints, steps: int) -> Floats:
    """Return the vertices after `steps` of Taubin smoothing with equal weights, (n, 3) mm.

    Raises `StageError` if MeshLab's libraries are missing.
    """
    meshes = _mesh_set(vertices, faces, _TAUBIN)
    meshes.apply_filter(_TAUBIN, stepsmoothnum=steps, selected=False, **_TAUBIN_WEIGHTS)
    return np.asarray(meshes.current_mesh().vertex_matrix())


def _mesh_set(vertices: Floats, faces: Ints, *filters: str) -> MeshSet:
    """Return a mesh set with the surface, after checking that the filters exist.

    If a system library is missing, pymeshlab cannot be imported, or lacks some of its filters.
    """
    try:
        import pymeshlab
    except ImportError as error:
        raise StageError(f"pymeshlab cannot be loaded ({error}): {_REMEDY}") from error
    there = pymeshlab.filter_list()
    for name in filters:
        if name not in there:
            raise StageError(f"pymeshlab has no filter {name}: {_REMEDY}")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
    return meshes


def _counts(meshes: MeshSet) -> tuple[int, int]:
    """Return the numbers of vertices and faces."""
    mesh = meshes.current_mesh()
    return mesh.vertex_number(), mesh.face_number()


def _arrays(meshes: MeshSet) -> tuple[Floats, Ints]:
    mesh = meshes.current_mesh()
    return np.asarray(mesh.vertex_matrix(), np.float64), np.asarray(mesh.face_matrix(), np.int64)
