"""Where parts of a surface start and meet as it grows from the lowest vertex up: the merge tree of a height.

Edelsbrunner, Letscher, Zomorodian, "Topological persistence and simplification" (2002): of two parts that meet the
one that started higher ends there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.jit import kernel


def part_heights(faces: Ints, heights: Floats) -> Floats:
    """Return by how much the part that starts at each vertex rises before it meets one that started lower, (n,).

    `heights` (n,) of the vertices; of equal ones the first counts as lower. A part that meets none has infinity, a
    vertex at which none starts -1.
    """
    order = np.argsort(heights, kind="stable")
    ranks = np.empty(len(order), np.int32)
    ranks[order] = np.arange(len(order), dtype=np.int32)
    rises = np.empty(len(order))
    rises[order] = _rises(heights[order], *_lower_neighbours(faces, ranks))
    return rises


@kernel
def _lower_neighbours(faces: Ints, ranks: NDArray[np.int32]) -> tuple[Ints, NDArray[np.int32]]:
    """Return the lower neighbours of each vertex, all by rank: those of vertex i from starts[i] to starts[i + 1]."""
    starts = np.zeros(len(ranks) + 2, np.int64)
    for i in range(len(faces)):
        for k in range(3):
            starts[max(ranks[faces[i, k]], ranks[faces[i, (k + 1) % 3]]) + 2] += 1
    for i in range(2, len(starts)):
        starts[i] += starts[i - 1]
    lower = np.empty(3 * len(faces), np.int32)
    for i in range(len(faces)):
        for k in range(3):
            a, b = ranks[faces[i, k]], ranks[faces[i, (k + 1) % 3]]
            place = max(a, b) + 1
            lower[starts[place]] = min(a, b)
            starts[place] += 1
    return starts[:-1], lower


@kernel
def _rises(heights: Floats, starts: Ints, lower: NDArray[np.int32]) -> Floats:
    rises = np.full(len(heights), -1.0)
    parents = np.arange(len(heights)).astype(np.int32)
    for vertex in range(len(heights)):
        eldest = vertex
        for k in range(starts[vertex], starts[vertex + 1]):
            eldest = min(eldest, _root(parents, lower[k]))
        if eldest == vertex:
            rises[vertex] = np.inf
        for k in range(starts[vertex], starts[vertex + 1]):
            younger = _root(parents, lower[k])
            if younger != eldest:
                rises[younger] = heights[vertex] - heights[younger]
                parents[younger] = eldest
        parents[vertex] = eldest
    return rises


@kernel
def _root(parents: NDArray[np.int32], place: int) -> int:
    while parents[place] != place:
        parents[place] = parents[parents[place]]
        place = parents[place]
    return place
