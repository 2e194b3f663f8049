"""The solid filled with tetrahedra for finite elements, and what the mesh is checked for."""

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
"""How far the volume of the cells may be from that of the solid, as a share of it."""

ENVELOPE = 0.15
"""How far the mesh may lie off the solid, in target edges and in volumes over areas, the lesser of both.

The cells cut corners on average: on a ball of 12 mm they took 0.4 % less than the solid at 0.1 of volume over area,
0.6 % at 0.15, 0.9 % at 0.2 and 2.1 % at 0.4.
"""

ENOUGH = 0.7
"""Edge length of the triangles, in target edges, that the solid's surface is thinned out to before it is filled."""

ROUNDS, ENERGY = 40, 10.0
"""Rounds of improvement, and the energy of the worst cell at which they end before: at 30 the ball took half the time,
but its flattest cell had a dihedral angle of 2 to 3 degrees instead of 11."""

MANY, FEW_ROUNDS = 40_000, 4
"""Triangles above which so few rounds must do: the worst of so many cells never gets as good, and all rounds are run.

On a femoral head of 56,000 triangles 40 rounds did not end within 20 minutes, as each refines around the few bad cells.
4 rounds took 133 s of one core: 74,063 cells, 0.17 % less volume, 213 cells flatter than 5 degrees, the worst 0.7.
"""

FLAT = 5.0
"""Dihedral angle, degrees, below which a cell is told of: finite elements lose digits on it."""

_EQUILATERAL = 0.433
"""Area of an equilateral triangle in squares of its edge."""


class Quality(NamedTuple):
    """The least scaled Jacobian and dihedral angle (degrees) of the cells; 1 and 70.5 are those of a regular one.

    `flat_cells` have a dihedral angle below `FLAT`.
    """

    scaled_jacobian: float
    dihedral_angle: float
    flat_cells: int


def default_edge(solid: Solid) -> float:
    """Return about half the thickness of a strut, mm: for a rod of thickness t, volume / area = t / 4."""
    return 2.0 * solid.volume / solid.area


def mesh_of(solid: Solid, edge: float | None, seconds: float) -> VolumeMesh:
    """Return the solid as tetrahedra of about `edge` mm, `default_edge` for None, with facts of them.

    fTetWild cannot repeat itself. Raises `StageError` where it dies or takes more than `seconds`, and where the cells
    are not what `require_solid` asks for.
    """
    target = edge or default_edge(solid)
    envelope = ENVELOPE * min(target, solid.volume / solid.area)
    centre = solid.bounds.mean(axis=0)
    answer = call_in_child(
        fill,
        {"vertices": solid.vertices - centre, "faces": solid.faces},
        {"triangles": solid.area / (_EQUILATERAL * (ENOUGH * target) ** 2), "target": target, "envelope": envelope},
        seconds=seconds,
        about=f"mesh of the solid, {len(solid.faces)} triangles, edge_length {target:.3g} mm; raise edge_length or "
        "time_limit",
    )
    mesh = VolumeMesh(answer["vertices"] + centre, answer["cells"])
    require_solid(mesh, solid)
    _warn_of_other_topology(mesh, solid)
    facts: dict[str, Fact] = {"target_edge": target, "envelope": envelope, **_measure_quality(mesh, solid)}
    return VolumeMesh(mesh.vertices, mesh.tetrahedra, facts=facts)


def _measure_quality(mesh: VolumeMesh, solid: Solid) -> dict[str, Fact]:
    from igl import point_mesh_squared_distance

    worst = quality(mesh)
    if worst.flat_cells:
        warn(
            f"mesh of the solid: {worst.flat_cells} of {len(mesh.tetrahedra)} cells have a dihedral angle below "
            f"{FLAT:g} degrees, the least {worst.dihedral_angle:.2g}; a larger edge_length gives rounder cells"
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


def fill(vertices: Floats, faces: Ints, triangles: float, target: float, envelope: float) -> Arrays:
    """Return what `run_ftetwild` makes of the surface, thinned out to so many `triangles`: the child's side.

    By quadrics that keep the volume: each triangle costs fTetWild time, and those of a voxel are smaller than cells.
    """
    from pyvista import PolyData

    if triangles < len(faces):
        thinned = PolyData.from_regular_faces(vertices, faces).decimate(
            1.0 - triangles / len(faces), volume_preservation=True
        )
        vertices, faces = np.asarray(thinned.points, np.float64), thinned.regular_faces
    return run_ftetwild(vertices, faces, target, envelope, ROUNDS if len(faces) <= MANY else FEW_ROUNDS, ENERGY)


def require_solid(mesh: VolumeMesh, solid: Solid) -> None:
    """Check that the cells hang together by their faces as the solid does, and fill its volume.

    That each has a positive volume, and one neighbour at a face, `VolumeMesh` has checked. Raises `StageError`.
    """
    from scaffold_geometry.surfaces.triangles import face_pieces, piece_volumes

    pieces = int((piece_volumes(solid.vertices, solid.faces, face_pieces(solid.faces)) > 0.0).sum())
    if (found := _pieces(mesh.tetrahedra)) != pieces:
        raise StageError(
            f"mesh of the solid: must be in as many pieces as it, {pieces}, but its cells are in {found}; lower "
            "edge_length, which thin struts are lost at"
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
            f"mesh of the solid: its Euler characteristic is {difference:+d} off that of the solid: {what}; lower "
            "edge_length for a closer mesh"
        )


def _euler_difference(mesh: VolumeMesh, solid: Solid) -> int:
    """Return the Euler characteristic, pieces - handles + closed pores, of the mesh less that of the solid.

    A closed surface has twice that of what it bounds.
    """
    from scaffold_geometry.surfaces.triangles import euler_characteristic

    cells = mesh.tetrahedra
    of_mesh = len(mesh.vertices) - len(mesh.edges) + _faces(cells).number - len(cells)
    return of_mesh - euler_characteristic(solid.faces) // 2


class _Faces(NamedTuple):
    """How many faces cells have, those of one cell only, (t, 3), and the pairs of cells, (p, 2), at one face."""

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
    """Return in how many pieces cells (m, 4) are that share faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = _faces(cells).pairs
    graph = coo_array((np.ones(len(pairs), np.int8), tuple(pairs.T)), shape=(len(cells),) * 2)
    return int(connected_components(graph, directed=False)[0])


def quality(mesh: VolumeMesh) -> Quality:
    """Return the worst of the cells.

    Scaled Jacobian after Knupp, SIAM J. Sci. Comput. 23 (2001) 193-218: six times the volume over the greatest product
    of the three edges at a corner, times sqrt(2).
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
