"""Stage `jitter`: random porosity by moving the vertices of the mesh."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scaffold_pipeline.artifacts import Floats, Ints, VolumeMesh
from scaffold_pipeline.cell_types import CELL_TYPES
from scaffold_pipeline.contract import Params, Unit, stage

Mask = NDArray[np.bool_]

LEAST_SHARE = 0.05
"""Share of its volume that every part of a cell keeps: below it a cell is nearly flat, and its channels touch its
edges."""

_HALVINGS = 6
"""Halvings of a step before it is given up: a sixty-fourth of it is no movement to speak of."""

_PULLS = 6
"""The same for a step along the boundary that comes out longer than allowed."""


class JitterParams(Params):
    """Parameters of `jitter`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest distance that a vertex moves."""

    boundary: Literal["surface", "free"] = "surface"
    """Whether vertices of the boundary slide on it or move freely."""


@stage(writes="mesh", version=2, libraries=("libigl",))
def jitter(mesh: VolumeMesh, *, params: JitterParams, rng: np.random.Generator) -> VolumeMesh:
    """Move each vertex in a random direction, by at most `amount` of the mean length of its edges.

    Directions are uniform on the sphere, distances uniform up to the greatest. No cell turns over: the steps of the
    vertices of a cell that would are halved until it does not, and at last given up.
    """
    steps = _random_steps(mesh, params.amount, rng)
    sliding = _boundary_vertices(mesh) if params.boundary == "surface" else np.zeros(len(mesh.vertices), bool)
    moved, scales = _sound_move(mesh, steps, sliding)
    facts = {
        **mesh.facts,
        "vertices_moved": int((moved != mesh.vertices).any(axis=1).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return VolumeMesh(moved, mesh.tetrahedra, mesh.pyramids, mesh.wedges, mesh.hexahedra, facts)


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
        np.pad(cells[:, face], ((0, 0), (0, 4 - len(face))), constant_values=-1)
        for kind, cells in mesh.cells.items()
        for face in CELL_TYPES[kind].faces
    ]
    corners = np.concatenate(faces)
    _, first, counts = np.unique(np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True)
    outer = corners[first[counts == 1]]
    quadrangles = outer[outer[:, 3] >= 0]
    return np.asarray(np.concatenate([outer[:, :3], quadrangles[:, [0, 2, 3]]]), np.int64)


def _boundary_vertices(mesh: VolumeMesh) -> Mask:
    is_boundary = np.zeros(len(mesh.vertices), bool)
    is_boundary[_boundary_triangles(mesh)] = True
    return is_boundary


def _sound_move(mesh: VolumeMesh, steps: Floats, sliding: Mask) -> tuple[Floats, Floats]:
    """Return the moved vertices (n, 3) and the factor of each step (n,): 1, or less where a cell would turn over.

    All vertices of all offending cells are held back at once, so that the order of cells decides nothing.
    """
    scales, halvings = np.ones(len(steps)), np.zeros(len(steps), int)
    least = {kind: _least_parts(mesh.vertices, cells, kind) for kind, cells in mesh.cells.items()}
    boundary, moved, changed = _boundary_triangles(mesh), mesh.vertices.copy(), np.ones(len(steps), bool)
    while changed.any():
        moved[changed] = mesh.vertices[changed] + scales[changed, None] * steps[changed]
        on_surface = changed & sliding
        moved[on_surface] = _on_boundary(mesh, boundary, on_surface, moved[on_surface])
        offenders = [
            cells[(_parts(moved, cells, kind) < least[kind]).any(axis=1)].ravel() for kind, cells in mesh.cells.items()
        ]
        changed = np.zeros(len(steps), bool)
        changed[np.concatenate(offenders)] = True
        changed &= scales > 0.0
        halvings[changed] += 1
        scales[changed] = np.where(halvings[changed] > _HALVINGS, 0.0, scales[changed] / 2.0)
    return moved, scales


def _on_boundary(mesh: VolumeMesh, boundary: Ints, which: Mask, wanted: Floats) -> Floats:
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


def _least_parts(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the least volume that each part of each cell may come to, (m, k): a share of its own.

    A cell that is folded to begin with, some part of it not positive, may not fold further.
    """
    parts = _parts(vertices, cells, kind)
    return np.asarray(np.where((parts > 0.0).all(axis=1, keepdims=True), LEAST_SHARE * parts, parts))


def _parts(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the signed volumes of the tetrahedra between a cell's centre, its face centres and its edges, (m, k).

    Where all are positive, all of the cell is seen from its centre, and every channel lies within it.
    """
    corners = vertices[cells]
    centre = corners.mean(axis=1)
    parts = []
    for face in CELL_TYPES[kind].faces:
        ring = corners[:, face] - centre[:, None]
        hub = ring.mean(axis=1)
        ahead = np.roll(ring, -1, axis=1)
        parts.append(np.einsum("ij,ikj->ik", hub, np.cross(ring, ahead)) / 6.0)
    return np.concatenate(parts, axis=1)
