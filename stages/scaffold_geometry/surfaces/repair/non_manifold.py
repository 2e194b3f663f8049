"""Split a surface where it touches itself, if possible."""

from __future__ import annotations

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import Surface
from scaffold_geometry.surfaces.repair.log import OpCounts, RepairOp
from scaffold_geometry.surfaces.repair.vertex_splitting import split_non_manifold
from scaffold_pipeline.errors import StageError

_EDGES = RepairOp("edges_parted", "split {} edges where the surface touched itself")
_VERTICES = RepairOp("vertices_parted", "split {} vertices where the surface touched itself")


def try_split_non_manifold(vertices: Floats, faces: Ints, done: OpCounts | None = None) -> Surface:
    """Return a closed surface with two faces at every edge and one fan at every vertex; unchanged if this fails."""
    faults = triangles.edge_faults(faces)
    if not faults.non_manifold and not triangles.touching_vertices(faces):
        return vertices, faces
    # Splitting moves vertices into the solid, which must be on the inner side.
    is_inverted = float(triangles.piece_volumes(vertices, faces, faces[:, 0] * 0).sum()) < 0.0
    try:
        found = split_non_manifold(vertices, faces[:, ::-1] if is_inverted else faces)
    except StageError:
        return vertices, faces
    if done is not None:
        done[_EDGES] += found.touching_edges
        done[_VERTICES] += found.touching_vertices
    return triangles.drop_unreferenced(found.vertices, found.faces[:, ::-1] if is_inverted else found.faces)
