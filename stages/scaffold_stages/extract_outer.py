"""`extract_outer`: the boundary of a volume mesh as the outer shape."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import self_intersections, triangles
from scaffold_geometry.surfaces.repair import vertex_splitting
from scaffold_geometry.volumes import cells, lattices
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_pipeline.artifacts import Fact, OuterShape, VolumeMesh
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import call_in_child
from scaffold_pipeline.stages.contract import Params, stage

_REPAIR = "mend the mesh where it was made, or load its surface with load_surface and use tetrahedralise"
_BENT = 1e-6
"""Share of the volume that bent quadrangles, cut into triangles, may change without a word."""


class ExtractOuterParams(Params):
    """Parameters of `extract_outer`."""

    shape: Literal["boundary", "box"] = "boundary"
    """The mesh's own boundary, or its bounding box along the axes: what the figures of Liu, Guo and Yu show."""

    touching: Literal["part", "refuse"] = "part"
    """What to do where the boundary touches itself at a vertex or an edge: move its sheets apart, or stop."""


@stage(writes="outer", version=2, libraries=("llvmlite", "numba", "scipy"))
def extract_outer(mesh: VolumeMesh, *, params: ExtractOuterParams) -> OuterShape:
    """Take the boundary of a volume mesh as the outer shape: closed, outward, quadrangles cut into triangles.

    Or take its bounding box. Where the boundary touches itself, it is parted by a hundredth of an edge, or no file of
    it would be manifold. Raises `StageError` for cells that do not meet face to face and a boundary that passes through
    itself.
    """
    if params.shape == "box":
        return _box(mesh)
    faces = cells.faces(mesh.cells)
    if len(faces.clashing) or len(faces.crowded):
        raise StageError(
            f"mesh: cells do not match at {len(faces.clashing) + len(faces.crowded)} of the faces that they share; "
            f"{_REPAIR}"
        )
    surface, owners = boundary_triangles(mesh.vertices, faces)
    _require_apart(mesh, surface, owners)
    notes = [f"boundary of {cells.count(mesh.cells)} cells, {len(faces.quadrangles)} of its faces quadrangles"]
    vertices, surface = triangles.drop_unreferenced(mesh.vertices, surface)
    facts: dict[str, Fact] = {}
    vertices, surface = _split_touching(vertices, surface, params, notes, facts)
    _require_no_self_intersection(vertices, surface)
    outer = OuterShape(vertices, surface)
    bent = facts["boundary_volume_difference"] = outer.volume / mesh.volume - 1.0
    if abs(bent) > _BENT and len(faces.quadrangles):
        notes.append(f"cutting bent quadrangles changed the volume by {bent:.2g} of itself")
    return OuterShape(outer.vertices, outer.faces, tuple(notes), facts)


def _box(mesh: VolumeMesh) -> OuterShape:
    bounds = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    lattice, hexahedron = lattices.on_lattice(np.zeros((1, 3), np.int64), lattices.HEXAHEDRON)
    corners = np.take_along_axis(bounds, lattice, axis=0)
    surface, _ = boundary_triangles(corners, cells.faces({"hexahedron": hexahedron}))
    return OuterShape(corners, surface, (f"bounding box of {cells.count(mesh.cells)} cells",))


def _require_apart(mesh: VolumeMesh, surface: Ints, owners: Ints) -> None:
    """Require that no body lies within another: about a cell of each, the boundary winds once."""
    vertices, pieces = mesh.vertices, triangles.face_pieces(surface)
    bodies = np.flatnonzero(triangles.piece_volumes(vertices, surface, pieces) > 0.0)
    if len(bodies) == 1:
        return
    first = np.unique(pieces, return_index=True)[1]
    centres = np.concatenate([vertices[corners].mean(axis=1) for corners in mesh.cells.values()])
    for body in bodies:
        centre = centres[owners[first[body]]]
        winding = triangles.winding_number(centre, vertices, surface)
        if round(winding) != 1:
            raise StageError(
                f"mesh: {round(winding)} bodies lie upon each other at {centre[0]:.4g}, {centre[1]:.4g}, "
                f"{centre[2]:.4g} mm; set load_volume_mesh.component to largest, or {_REPAIR}"
            )


def _split_touching(
    vertices: Floats, surface: Ints, params: ExtractOuterParams, notes: list[str], facts: dict[str, Fact]
) -> tuple[Floats, Ints]:
    """Move the surface apart where it touches itself."""
    faults, at_vertices = triangles.edge_faults(surface), triangles.touching_vertices(surface)
    if not faults.non_manifold and not at_vertices:
        return vertices, surface
    if params.touching == "refuse":
        raise StageError(
            f"mesh: its boundary touches itself at {at_vertices} vertices and {faults.non_manifold} edges; set "
            f"`touching: part` to move it apart there, or {_REPAIR}"
        )
    try:
        parted = vertex_splitting.split_non_manifold(vertices, surface)
    except StageError as error:
        raise StageError(f"mesh: {error}; {_REPAIR}") from error
    said = (
        f"parted at {parted.touching_vertices} vertices and {parted.touching_edges} edges where the boundary touches "
        f"itself, by at most {parted.farthest:.2g} mm"
    )
    notes.append(said)
    facts |= {
        "boundary_vertices_parted": parted.touching_vertices,
        "boundary_edges_parted": parted.touching_edges,
        "boundary_parting_mm": parted.farthest,
    }
    warn(f"the outer shape is {said}")
    return parted.vertices, parted.faces


def _require_no_self_intersection(vertices: Floats, surface: Ints) -> None:
    found = call_in_child(
        self_intersections.find_self_intersections,
        {"vertices": vertices, "faces": surface},
        {},
        seconds=60.0 + len(surface) / 5_000,  # exact arithmetic; millions of sound triangles take seconds
        about=f"the mesh's boundary could not be searched for self-intersections: {_REPAIR}",
    )["faces"]
    if len(found):
        at = vertices[surface[found[0]]].mean(axis=0)
        raise StageError(
            f"mesh: its boundary passes through itself: {len(found)} triangles intersect others "
            f"(one at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm); {_REPAIR}"
        )
