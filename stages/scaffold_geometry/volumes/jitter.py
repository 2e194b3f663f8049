"""Movement of vertices without inverted cells: a step that would invert a cell is shortened."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_pipeline.artifacts.cells import CELL_TYPES, edges_of_cells

Cells = Mapping[str, Ints]

LEAST_SHARE = 0.05
"""Least share of its volume or area that every part of a cell keeps: with less a cell is nearly flat, and its channels
touch its edges."""

_HALVINGS = 6
"""Halvings of a step before it is set to zero: a sixty-fourth of it is negligible."""


def random_steps(vertices: Floats, cells: Cells, amount: float, rng: np.random.Generator, dimensions: int) -> Floats:
    """Return a random step for each vertex, (n, 3) mm, at most `amount` times the mean length of its edges.

    Steps are along the first `dimensions` axes, with directions uniform on the sphere or circle and uniform lengths.
    """
    edges, count = edges_of_cells(cells), len(vertices)
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    local = np.bincount(edges.ravel(), np.repeat(lengths, 2), count) / np.bincount(edges.ravel(), minlength=count)
    directions = rng.standard_normal((count, dimensions))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    steps = np.zeros((count, 3))
    steps[:, :dimensions] = directions * (rng.uniform(0.0, amount, count) * local)[:, None]
    return steps


def move_without_inversion(
    vertices: Floats, cells: Cells, steps: Floats, settle: Callable[[Bools, Floats], Floats] | None = None
) -> tuple[Floats, Floats]:
    """Return the moved vertices (n, 3) and the factor of each step (n,): 1, or less where a cell would be inverted.

    The steps of all vertices of all inverted cells are shortened together, so the order of cells has no effect.
    `settle` takes a mask of the moving vertices, (n,), and the new positions, (n, 3), and returns corrected positions.
    """
    scales, halvings = np.ones(len(steps)), np.zeros(len(steps), int)
    least = {kind: _least_parts(vertices, corners, kind) for kind, corners in cells.items()}
    moved, changed = vertices.copy(), np.ones(len(steps), bool)
    while changed.any():
        moved[changed] = vertices[changed] + scales[changed, None] * steps[changed]
        if settle:
            moved = settle(changed, moved)
        offenders = [
            corners[(parts_of(moved, corners, kind) < least[kind]).any(axis=1)].ravel()
            for kind, corners in cells.items()
        ]
        changed = np.zeros(len(steps), bool)
        changed[np.concatenate(offenders)] = True
        changed &= scales > 0.0
        halvings[changed] += 1
        scales[changed] = np.where(halvings[changed] > _HALVINGS, 0.0, scales[changed] / 2.0)
    return moved, scales


def _least_parts(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the least allowed volume or area of each part of each cell, (m, k): a share of its own.

    A cell that is folded from the start, with some part not positive, may not fold further.
    """
    parts = parts_of(vertices, cells, kind)
    return np.asarray(np.where((parts > 0.0).all(axis=1, keepdims=True), LEAST_SHARE * parts, parts))


def parts_of(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the signed volumes of the tetrahedra between a cell's centre, its face centres and its edges, (m, k).

    For a planar cell, the signed areas of the triangles between its centre and its edges. If all are positive, the
    whole cell can be seen from its centre, and every channel lies inside it.
    """
    corners = vertices[cells]
    spokes = corners - corners.mean(axis=1, keepdims=True)
    if CELL_TYPES[kind].is_planar:
        return np.asarray(np.cross(spokes, np.roll(spokes, -1, axis=1))[:, :, 2] / 2.0)
    parts = []
    for face in CELL_TYPES[kind].faces:
        ring = spokes[:, face]
        hub = ring.mean(axis=1)
        ahead = np.roll(ring, -1, axis=1)
        parts.append(np.einsum("ij,ikj->ik", hub, np.cross(ring, ahead)) / 6.0)
    return np.concatenate(parts, axis=1)
