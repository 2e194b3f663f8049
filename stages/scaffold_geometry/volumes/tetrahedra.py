"""Tetrahedral meshes of the solid for finite elements, and their checks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.volumes.ftetwild import run_ftetwild
from scaffold_pipeline.artifacts import Fact, Solid, VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes, distinct_rows, faces_of_cells
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import Arrays, call_in_child

VOLUME_TOLERANCE = 0.01
"""Greatest difference between the volumes of the cells and of the solid, as a share of the solid's."""

ENVELOPE = 0.15
"""Greatest distance between mesh and solid, as a share of the target edge or of volume / area, whichever is smaller.

The cells cut corners: on a ball of 12 mm their volume was 0.4 % below that of the solid at 0.1 of volume / area,
0.6 % at 0.15, 0.9 % at 0.2 and 2.1 % at 0.4.
"""

SURFACE_EDGE = 0.7
"""Edge length of the triangles to which the solid's surface is simplified before meshing, in target edges."""

ROUNDS, ENERGY = 40, 10.0
"""Rounds of optimisation, and the energy of the worst cell at which they end: at an energy of 30 the ball took half the
time, but its flattest cell had a dihedral angle of 2 to 3 degrees instead of 11."""

LARGE_SURFACE, LARGE_SURFACE_ROUNDS = 40_000, 4
"""Number of triangles above which fewer rounds are run, and these: the worst of so many cells never reaches `ENERGY`.

On a femoral head of 56,000 triangles 40 rounds did not end within 20 minutes, as each refines around the few bad cells.
4 rounds took 133 s of one core: 74,063 cells, 0.17 % less volume, 213 cells flatter than 5 degrees, the worst 0.7.
"""

FLAT = 5.0
"""Dihedral angle, degrees, below which a cell is reported as flat: finite elements lose accuracy on it."""

_EQUILATERAL = 0.433
"""Area of an equilateral triangle in squares of its edge."""


class Quality(NamedTuple):
    """The least scaled Jacobian and dihedral angle (degrees) of all cells; a regular tetrahedron has 1 and 70.5.

    `flat_cells` have a dihedral angle below `FLAT`.
    """

    scaled_jacobian: float
    dihedral_angle: float
    flat_cells: int


def default_edge(solid: Solid) -> float:
    """Return about half the strut thickness, mm: a rod of thickness t has volume / area = t / 4."""
    return 2.0 * solid.volume / solid.area


def mesh_of(solid: Solid, edge: float | None, seconds: float) -> VolumeMesh:
    """Return the solid as tetrahedra with edges of about `edge` mm, by default `default_edge`, with facts of the mesh.

    fTetWild is not deterministic. Raises `StageError` if it crashes or takes more than `seconds`, or if the cells fail
    `require_solid`.
    """
    target = edge or default_edge(solid)
    envelope = ENVELOPE * min(target, solid.volume / solid.area)
    triangles = solid.area / (_EQUILATERAL * (SURFACE_EDGE * target) ** 2)
    centre = solid.bounds.mean(axis=0)
    answer = call_in_child(
        simplify_and_fill,
        {"vertices": solid.vertices - centre, "faces": solid.faces},
        {"triangles": triangles, "target": target, "envelope": envelope},
        seconds=seconds,
        about=f"mesh of the solid, {len(solid.faces)} triangles, edge_length {target:.3g} mm; raise edge_length or "
        "time_limit",
    )
    mesh = VolumeMesh(answer["vertices"] + centre, answer["cells"])
    require_solid(mesh, solid)
    _warn_of_other_topology(mesh, solid)
    facts: dict[str, Fact] = {"target_edge": target, "envelope": envelope, **_quality_facts(mesh, solid)}
    return VolumeMesh(mesh.vertices, mesh.tetrahedra, facts=facts)


def _quality_facts(mesh: VolumeMesh, solid: Solid) -> dict[str, Fact]:
    from igl import point_mesh_squared_distance

    worst = measure_quality(mesh)
    if worst.flat_cells:
        warn(
            f"mesh of the solid: {worst.flat_cells} of {len(mesh.tetrahedra)} cells have a dihedral angle below "
            f"{FLAT:g} degrees, the least {worst.dihedral_angle:.2g}; a larger edge_length gives better cells"
        )
    skin = mesh.vertices[np.unique(_faces(mesh.tetrahedra).outer)]
    squared, _, _ = point_mesh_squared_distance(skin, solid.vertices, solid.faces)
    return {
        "volume_difference": mesh.volume / solid.volume - 1.0,
        "distance_mm": float(np.sqrt(squared.max())),
        "least_scaled_jacobian": worst.scaled_jacobian,
        "least_dihedral_angle": worst.dihedral_angle,
        "flat_cells": worst.flat_cells,
        "euler_difference": _euler_difference(mesh, solid),
    }


def simplify_and_fill(vertices: Floats, faces: Ints, triangles: float, target: float, envelope: float) -> Arrays:
    """Return the tetrahedra of `run_ftetwild` in the surface, simplified to about `triangles`; runs in a child process.

    The simplification keeps the volume. It saves time: the triangles of a voxel surface are smaller than the cells.
    """
    from pyvista import PolyData

    if triangles < len(faces):
        simplified = PolyData.from_regular_faces(vertices, faces).decimate(
            1.0 - triangles / len(faces), volume_preservation=True
        )
        vertices, faces = np.asarray(simplified.points, np.float64), simplified.regular_faces
    rounds = ROUNDS if len(faces) <= LARGE_SURFACE else LARGE_SURFACE_ROUNDS
    return run_ftetwild(vertices, faces, target, envelope, rounds, ENERGY)


def require_solid(mesh: VolumeMesh, solid: Solid) -> None:
    """Require that the cells form as many face-connected pieces as the solid, and have its volume.

    `VolumeMesh` has checked that each cell has a positive volume and one neighbour per face. Raises `StageError`.
    """
    from scaffold_geometry.surfaces.triangles import face_pieces, piece_volumes

    pieces = int((piece_volumes(solid.vertices, solid.faces, face_pieces(solid.faces)) > 0.0).sum())
    if (got := _pieces(mesh.tetrahedra)) != pieces:
        raise StageError(
            f"mesh of the solid: number of pieces: must be {pieces} as in the solid, got {got}; thin struts are lost: "
            "lower edge_length"
        )
    if not abs(mesh.volume - solid.volume) <= VOLUME_TOLERANCE * solid.volume:
        raise StageError(
            f"mesh of the solid: must keep its volume to {VOLUME_TOLERANCE:g}, but the cells fill {mesh.volume:.6g} "
            f"of {solid.volume:.6g} mm^3; lower edge_length"
        )


def _warn_of_other_topology(mesh: VolumeMesh, solid: Solid) -> None:
    if difference := _euler_difference(mesh, solid):
        what = "narrow gaps are bridged" if difference < 0 else "thin struts are broken, or small holes filled"
        warn(
            f"mesh of the solid: its Euler characteristic differs by {difference:+d} from that of the solid: {what}; "
            "lower edge_length for a closer mesh"
        )


def _euler_difference(mesh: VolumeMesh, solid: Solid) -> int:
    """Return the Euler characteristic, pieces - handles + closed pores, of the mesh minus that of the solid.

    A closed surface has twice the Euler characteristic of the body that it bounds.
    """
    from scaffold_geometry.surfaces.triangles import euler_characteristic

    cells = mesh.tetrahedra
    of_mesh = len(mesh.vertices) - len(mesh.edges) + _faces(cells).number - len(cells)
    return of_mesh - euler_characteristic(solid.faces) // 2


class _Faces(NamedTuple):
    """The number of faces, the boundary faces, (t, 3), and the pairs of cells that share a face, (p, 2)."""

    number: int
    outer: Ints
    pairs: Ints


def _faces(cells: Ints) -> _Faces:
    corners = np.sort(faces_of_cells({"tetrahedron": cells})[:, :3], axis=1)
    faces, groups = distinct_rows(corners)
    owners = np.argsort(groups, kind="stable")
    same = np.flatnonzero(groups[owners[1:]] == groups[owners[:-1]])
    pairs = np.column_stack([owners[same], owners[same + 1]]) // 4
    return _Faces(len(faces), faces[np.bincount(groups) == 1], pairs)


def _pieces(cells: Ints) -> int:
    """Return the number of face-connected pieces of cells (m, 4)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = _faces(cells).pairs
    graph = coo_array((np.ones(len(pairs), np.int8), tuple(pairs.T)), shape=(len(cells),) * 2)
    return int(connected_components(graph, directed=False)[0])


def measure_quality(mesh: VolumeMesh) -> Quality:
    """Return the worst quality of the cells.

    Scaled Jacobian after Knupp, SIAM J. Sci. Comput. 23 (2001) 193-218: six times the volume, divided by the greatest
    product of the three edges at a corner, times sqrt(2).
    """
    corners = mesh.vertices[mesh.tetrahedra]
    products = [
        np.prod([np.linalg.norm(corners[:, j] - corners[:, i], axis=1) for j in range(4) if j != i], axis=0)
        for i in range(4)
    ]
    volumes = cell_volumes(mesh.vertices, mesh.tetrahedra, "tetrahedron")
    jacobians = 6.0 * np.sqrt(2.0) * volumes / np.max(products, axis=0)
    least = np.degrees(_dihedral_angles(corners).min(axis=1))
    return Quality(float(jacobians.min()), float(least.min()), int((least < FLAT).sum()))


def _dihedral_angles(corners: Floats) -> Floats:
    """Return the six angles between the faces of each tetrahedron, (m, 6), in radians; `corners` (m, 4, 3)."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    normals = [np.cross(p - o, q - o) for o, p, q in ((b, c, d), (a, d, c), (a, b, d), (a, c, b))]
    units = [normal / np.linalg.norm(normal, axis=1, keepdims=True) for normal in normals]
    pairs = [(i, j) for i in range(4) for j in range(i)]
    cosines = [-np.einsum("ij,ij->i", units[i], units[j]) for i, j in pairs]
    angles: Floats = np.arccos(np.clip(np.stack(cosines, axis=1), -1.0, 1.0))
    return angles
