"""Edges of a closed surface at which the solid is sharp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Indices, Ints
from scaffold_geometry.jit import kernel

_NONE = np.float32(-2.0)


class SharpEdges(NamedTuple):
    """Edges, (k, 2) vertex indices, the smaller first, and the angle of the solid between their two faces, radians."""

    edges: Ints
    angles: Floats


def sharp_edges(vertices: Floats, faces: Ints, greatest: float) -> SharpEdges:
    """Return the edges of a surface, (n, 3) and (m, 3), at which the solid's angle is below `greatest`, radians.

    That angle lies between a face and its neighbour, through the solid. Faces without area have no angle.
    """
    starts, others, owners = _edges_by_vertex(faces, len(vertices))
    cosines = _sharp_cosines(vertices, faces, starts, others, owners, np.cos(greatest))
    found = np.flatnonzero(cosines != _NONE)
    firsts = np.searchsorted(starts, found, side="right") - 1
    edges = np.stack([firsts, others[found].astype(np.int64)], axis=1)
    return SharpEdges(edges, np.arccos(np.minimum(cosines[found].astype(np.float64), 1.0)))


@kernel
def _edges_by_vertex(faces: Ints, count: int) -> tuple[Ints, Indices, Indices]:
    """Return half-edges by the smaller of their vertices: where each vertex's start, their other ends, their faces."""
    starts = np.zeros(count + 2, np.int64)
    for i in range(len(faces)):
        for k in range(3):
            starts[min(faces[i, k], faces[i, (k + 1) % 3]) + 2] += 1
    for i in range(2, len(starts)):
        starts[i] += starts[i - 1]
    others, owners = np.empty(3 * len(faces), np.int32), np.empty(3 * len(faces), np.int32)
    for i in range(len(faces)):
        for k in range(3):
            a, b = faces[i, k], faces[i, (k + 1) % 3]
            place = starts[min(a, b) + 1]
            others[place], owners[place] = max(a, b), i
            starts[min(a, b) + 1] += 1
    return starts[:-1], others, owners


@kernel
def _sharp_cosines(
    vertices: Floats, faces: Ints, starts: Ints, others: Indices, owners: Indices, least: float
) -> NDArray[np.float32]:
    """Return the cosine of the angle at each half-edge whose other half follows, if greater than `least`, else -2."""
    cosines = np.full(len(others), _NONE, np.float32)
    for vertex in range(len(starts) - 1):
        for i in range(starts[vertex], starts[vertex + 1]):
            for j in range(i + 1, starts[vertex + 1]):
                if others[i] == others[j]:
                    cosine = _solid_cosine(vertices, faces[owners[i]], faces[owners[j]])
                    if cosine > least:
                        cosines[i] = cosine
                    break
    return cosines


@kernel
def _solid_cosine(vertices: Floats, face: Ints, other: Ints) -> float:
    """Return the cosine of the solid's angle between two neighbours, -2 where it is hollow or one has no area."""
    x, y, z = _normal(vertices, face)
    u, v, w = _normal(vertices, other)
    lengths = np.sqrt((x * x + y * y + z * z) * (u * u + v * v + w * w))
    if lengths == 0.0:
        return -2.0
    beyond = 0.0
    for k in range(3):
        beyond += x * (vertices[other[k], 0] - vertices[face[0], 0])
        beyond += y * (vertices[other[k], 1] - vertices[face[0], 1])
        beyond += z * (vertices[other[k], 2] - vertices[face[0], 2])
    return -(x * u + y * v + z * w) / lengths if beyond <= 0.0 else -2.0


@kernel
def _normal(vertices: Floats, face: Ints) -> tuple[float, float, float]:
    a, b, c = face[0], face[1], face[2]
    ux, uy, uz = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    vx, vy, vz = (
        vertices[c, 0] - vertices[a, 0],
        vertices[c, 1] - vertices[a, 1],
        vertices[c, 2] - vertices[a, 2],
    )
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
