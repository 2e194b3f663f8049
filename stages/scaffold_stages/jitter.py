"""Stage `jitter`: random pore geometry by random movement of the mesh's vertices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.volumes.jitter import move_without_inversion, random_steps
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.stages.contract import Params, Unit, stage

_PULLS = 6
"""Halvings of a step along the boundary that is longer than allowed, before it is set to zero."""


class JitterParams(Params):
    """Parameters of `jitter`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest displacement of a vertex."""

    boundary: Literal["surface", "free"] = "surface"
    """`surface`: vertices of the boundary slide along it; `free`: they move as all others."""


@stage(writes="mesh", version=2)
def jitter(mesh: VolumeMesh, *, params: JitterParams, rng: np.random.Generator) -> VolumeMesh:
    """Move each vertex in a random direction, by at most `amount` times the mean length of its edges.

    Directions are uniform on the sphere, distances uniform up to the greatest. No cell is inverted: the steps of a
    cell's vertices are halved until it is not, and after six halvings set to zero.
    """
    steps = random_steps(mesh.vertices, mesh.cells, params.amount, rng, 3)
    moved, scales = move_without_inversion(
        mesh.vertices, mesh.cells, steps, _slider(mesh) if params.boundary == "surface" else None
    )
    facts = {
        **mesh.facts,
        "vertices_moved": int((moved != mesh.vertices).any(axis=1).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return VolumeMesh(moved, mesh.tetrahedra, mesh.pyramids, mesh.wedges, mesh.hexahedra, facts)


def _boundary_triangles(mesh: VolumeMesh) -> Ints:
    """Return the boundary faces as triangles, (m, 3); quadrangles are split along a diagonal."""
    faces = [
        np.pad(cells[:, face], ((0, 0), (0, 4 - len(face))), constant_values=-1)
        for kind, cells in mesh.cells.items()
        for face in CELL_TYPES[kind].faces
    ]
    corners = np.concatenate(faces)
    _, first, counts = np.unique(np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True)
    outer = corners[first[counts == 1]]
    quadrangles = outer[outer[:, 3] >= 0]
    return np.asarray(np.concatenate([outer[:, :3], quadrangles[:, [0, 2, 3]]]), np.int64)


def _boundary_vertices(mesh: VolumeMesh) -> Bools:
    is_boundary = np.zeros(len(mesh.vertices), bool)
    is_boundary[_boundary_triangles(mesh)] = True
    return is_boundary


def _slider(mesh: VolumeMesh) -> Callable[[Bools, Floats], Floats]:
    """Return a function that projects moved boundary vertices back onto the boundary."""
    sliding, boundary = _boundary_vertices(mesh), _boundary_triangles(mesh)

    def settle(changed: Bools, moved: Floats) -> Floats:
        on_surface = changed & sliding
        moved[on_surface] = _project(mesh, boundary, on_surface, moved[on_surface])
        return moved

    return settle


def _project(mesh: VolumeMesh, boundary: Ints, which: Bools, wanted: Floats) -> Floats:
    """Return the boundary points nearest to the positions `wanted` of its vertices `which`, (k, 3).

    At a notch the nearest point can be up to twice as far from the start as the wanted one: then the step is halved
    until it is not.
    """
    import igl

    start = mesh.vertices[which]
    ends, allowed = start.copy(), np.linalg.norm(wanted - start, axis=1)
    left, share = np.flatnonzero(allowed > 0.0), 1.0
    for _ in range(_PULLS):
        if not len(left):
            break
        targets = start[left] + share * (wanted[left] - start[left])
        _, _, nearest = igl.point_mesh_squared_distance(targets, mesh.vertices, boundary)
        fits = np.linalg.norm(nearest - start[left], axis=1) <= allowed[left]
        ends[left[fits]] = nearest[fits]
        left, share = left[~fits], share / 2.0
    return ends
