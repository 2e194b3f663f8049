"""Stage `extract_outer`: the boundary of a volume mesh as the outer shape."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.repair import vertex_splitting
from scaffold_geometry.surfaces.self_intersections import require_no_self_intersections
from scaffold_geometry.volumes import cells, lattices
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_pipeline.artifacts import Fact, Metric, OuterShape, VolumeMesh
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Params, stage

_REPAIR = "repair the mesh in the program that made it, or load its surface with load_surface and use tetrahedralise"
_BENT = 1e-6
"""Relative change of the volume by splitting non-planar quadrangles above which a note is written."""


class ExtractOuterParams(Params):
    """Parameters of `extract_outer`."""

    shape: Literal["boundary", "box"] = "boundary"
    """The mesh's boundary, or its bounding box, as in the figures of Liu, Guo and Yu."""

    touching: Literal["part", "refuse"] = "part"
    """Where the boundary touches itself at a vertex or an edge: `part` moves its sheets apart, `refuse` stops."""


METRICS = (
    Metric("boundary_volume_difference", "", "Volume by cut quadrangles", "Change, as a share of the mesh's.", ""),
    Metric("boundary_vertices_parted", "", "Boundary vertices parted", "Where the boundary touched itself.", ""),
    Metric("boundary_edges_parted", "", "Boundary edges parted", "Where the boundary touched itself.", ""),
    Metric("boundary_parting_mm", "mm", "Parting of the boundary", "How far vertices were moved, at most.", ""),
)
"""What the facts of the outer shape are."""


@stage(writes="outer", version=2, metrics=METRICS)
def extract_outer(mesh: VolumeMesh, *, params: ExtractOuterParams) -> OuterShape:
    """Take the boundary of a volume mesh, or its bounding box, as the outer shape: a closed, outward surface.

    Quadrangles are split into triangles. Where the boundary touches itself, its sheets are moved apart by a hundredth
    of an edge, so that the surface is manifold. Raises `StageError` if cells do not meet face to face, or if the
    boundary intersects itself.
    """
    if params.shape == "box":
        return _box(mesh)
    faces = cells.faces(mesh.cells)
    if len(faces.clashing) or len(faces.crowded):
        raise StageError(
            f"mesh: cells do not match at {len(faces.clashing) + len(faces.crowded)} of their shared faces; {_REPAIR}"
        )
    surface, owners = boundary_triangles(mesh.vertices, faces)
    _require_apart(mesh, surface, owners)
    notes = [f"boundary of {cells.count(mesh.cells)} cells, {len(faces.quadrangles)} of its faces quadrangles"]
    vertices, surface = triangles.drop_unreferenced(mesh.vertices, surface)
    facts: dict[str, Fact] = {}
    vertices, surface = _split_touching(vertices, surface, params, notes, facts)
    about = f"the search for self-intersections of the mesh's boundary failed: {_REPAIR}"
    require_no_self_intersections(vertices, surface, "mesh: its boundary", _REPAIR, about)
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
    """Require that bodies do not overlap: the boundary's winding number is 1 in a cell of each."""
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
                f"mesh: {round(winding)} bodies overlap at {centre[0]:.4g}, {centre[1]:.4g}, "
                f"{centre[2]:.4g} mm; set load_volume_mesh.component to largest, or {_REPAIR}"
            )


def _split_touching(
    vertices: Floats, surface: Ints, params: ExtractOuterParams, notes: list[str], facts: dict[str, Fact]
) -> tuple[Floats, Ints]:
    """Move the sheets of the surface apart where it touches itself."""
    faults, at_vertices = triangles.edge_faults(surface), triangles.touching_vertices(surface)
    if not faults.non_manifold and not at_vertices:
        return vertices, surface
    if params.touching == "refuse":
        raise StageError(
            f"mesh: its boundary touches itself at {at_vertices} vertices and {faults.non_manifold} edges; set "
            f"`touching: part` to move it apart there, or {_REPAIR}"
        )
    try:
        split = vertex_splitting.split_non_manifold(vertices, surface)
    except StageError as error:
        raise StageError(f"mesh: {error}; {_REPAIR}") from error
    note = (  # notes are part of the artifact's hash
        f"parted at {split.touching_vertices} vertices and {split.touching_edges} edges where the boundary touches "
        f"itself, by at most {split.farthest:.2g} mm"
    )
    notes.append(note)
    facts |= {
        "boundary_vertices_parted": split.touching_vertices,
        "boundary_edges_parted": split.touching_edges,
        "boundary_parting_mm": split.farthest,
    }
    warn(f"the outer shape is {note}")
    return split.vertices, split.faces
