"""Stage `jitter`: random porosity by moving the vertices of the mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.volumes.jitter import random_steps, sound_move
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.stages.contract import Params, Unit, stage

_PULLS = 6
"""Halvings of a step along the boundary that comes out longer than allowed, before it is given up."""


class JitterParams(Params):
    """Parameters of `jitter`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest distance that a vertex moves."""

    boundary: Literal["surface", "free"] = "surface"
    """Whether vertices of the boundary slide on it or move freely."""


@stage(writes="mesh", version=2)
def jitter(mesh: VolumeMesh, *, params: JitterParams, rng: np.random.Generator) -> VolumeMesh:
    """Move each vertex in a random direction, by at most `amount` of the mean length of its edges.

    Directions are uniform on the sphere, distances uniform up to the greatest. No cell turns over: the steps of the
    vertices of a cell that would are halved until it does not, and at last given up.
    """
    steps = random_steps(mesh.vertices, mesh.cells, params.amount, rng, 3)
    moved, scales = sound_move(
        mesh.vertices, mesh.cells, steps, _slider(mesh) if params.boundary == "surface" else None
    )
    facts = {
        **mesh.facts,
        "vertices_moved": int((moved != mesh.vertices).any(axis=1).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return VolumeMesh(moved, mesh.tetrahedra, mesh.pyramids, mesh.wedges, mesh.hexahedra, facts)


def _boundary_triangles(mesh: VolumeMesh) -> Ints:
    """Return the faces of only one cell as triangles, (m, 3): quadrangles are cut along a diagonal."""
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
    """Return what brings those vertices of the boundary that move back to it."""
    sliding, boundary = _boundary_vertices(mesh), _boundary_triangles(mesh)

    def settle(changed: Bools, moved: Floats) -> Floats:
        on_surface = changed & sliding
        moved[on_surface] = _on_boundary(mesh, boundary, on_surface, moved[on_surface])
        return moved

    return settle


def _on_boundary(mesh: VolumeMesh, boundary: Ints, which: Bools, wanted: Floats) -> Floats:
    """Return the boundary's points nearest to where its vertices `which` want to go, (k, 3), no farther than that.

    About a notch the nearest point can be farther from the start than the one wanted, up to twice: then half the way
    is wanted, and so on.
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
