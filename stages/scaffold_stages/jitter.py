"""Stage `jitter`: random porosity by moving the vertices of the mesh."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scaffold_pipeline.artifacts import Floats, Ints, VolumeMesh
from scaffold_pipeline.cell_types import CELL_TYPES, cell_volumes
from scaffold_pipeline.contract import Params, Unit, stage
from scaffold_pipeline.errors import StageError

LEAST_VOLUME = 0.05
"""Share of its volume that every cell keeps: below it a cell is nearly flat, and its channels touch its edges."""

_HALVINGS = 30


class JitterParams(Params):
    """Parameters of `jitter`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest distance that a vertex moves."""

    boundary: Literal["surface", "free"] = "surface"
    """Whether vertices of the boundary slide on it or move freely."""


@stage(writes="mesh", version=1)
def jitter(mesh: VolumeMesh, *, params: JitterParams, rng: np.random.Generator) -> VolumeMesh:
    """Move each vertex in a random direction, by at most `amount` of the mean length of its edges.

    Directions are uniform on the sphere, distances uniform up to the greatest. No cell turns over: the steps of the
    vertices of a cell that would are halved until it does not.
    """
    steps = _random_steps(mesh, params.amount, rng)
    is_boundary = _boundary_vertices(mesh)
    if params.boundary == "surface":
        steps[is_boundary] = _along_boundary(mesh, steps, is_boundary)
    scales = _sound_scales(mesh, steps)
    facts = {
        **mesh.facts,
        "vertices_moved": int((np.abs(steps).max(axis=1) > 0.0).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return VolumeMesh(
        mesh.vertices + scales[:, None] * steps, mesh.tetrahedra, mesh.pyramids, mesh.wedges, mesh.hexahedra, facts
    )


def _random_steps(mesh: VolumeMesh, amount: float, rng: np.random.Generator) -> Floats:
    edges = mesh.edges
    lengths = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    count = len(mesh.vertices)
    local = np.bincount(edges.ravel(), np.repeat(lengths, 2), count) / np.bincount(edges.ravel(), minlength=count)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(directions * (rng.uniform(0.0, amount, count) * local)[:, None])


def _boundary_triangles(mesh: VolumeMesh) -> Ints:
    """Return the faces of only one cell as triangles, (m, 3): quadrangles are cut along a diagonal."""
    faces = [
        np.pad(cells[:, face], ((0, 0), (0, 4 - len(face))), mode="edge")
        for kind, cells in mesh.cells.items()
        for face in CELL_TYPES[kind].faces
    ]
    corners = np.concatenate(faces)
    _, first, counts = np.unique(np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True)
    outer = corners[first[counts == 1]]
    triangles = np.concatenate([outer[:, [0, 1, 2]], outer[:, [0, 2, 3]]])
    return triangles[triangles[:, 1] != triangles[:, 2]]


def _boundary_vertices(mesh: VolumeMesh) -> NDArray[np.bool_]:
    is_boundary = np.zeros(len(mesh.vertices), bool)
    is_boundary[_boundary_triangles(mesh)] = True
    return is_boundary


def _along_boundary(mesh: VolumeMesh, steps: Floats, is_boundary: NDArray[np.bool_]) -> Floats:
    """Return the steps of the boundary's vertices, ended at the boundary's point nearest to their free end."""
    import igl

    start = mesh.vertices[is_boundary]
    _, _, nearest = igl.point_mesh_squared_distance(start + steps[is_boundary], mesh.vertices, _boundary_triangles(mesh))
    return np.asarray(nearest - start)


def _sound_scales(mesh: VolumeMesh, steps: Floats) -> Floats:
    """Return a factor for each vertex's step, 1 or halved as often as its cells need to keep their volume."""
    scales = np.ones(len(mesh.vertices))
    least = {kind: LEAST_VOLUME * cell_volumes(mesh.vertices, cells, kind) for kind, cells in mesh.cells.items()}
    for _ in range(_HALVINGS):
        moved = mesh.vertices + scales[:, None] * steps
        offenders = [
            cells[cell_volumes(moved, cells, kind) < least[kind]].ravel() for kind, cells in mesh.cells.items()
        ]
        vertices = np.unique(np.concatenate(offenders))
        if not len(vertices):
            return scales
        scales[vertices] /= 2.0
    raise StageError(
        f"jitter: {len(vertices)} vertices still turn a cell over after {_HALVINGS} halvings of their step; lower amount"
    )
