"""Limit the smoothing of a surface: constant volume, a greatest distance for each vertex, no self-intersection.

Vertices are (n, 3) mm, faces (m, 3) of a closed surface; both surfaces have the same faces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.self_intersections import self_intersecting_faces

_VOLUME_STEPS = 4
_SAME_VOLUME = 1e-6

_ROUNDS = 12
"""Times that vertices are put back: two bones and the femur of the README needed none, a gyroid in ten steps one."""


class Smoothed(NamedTuple):
    """The smoothed vertices, (n, 3) mm, and how far they moved.

    `moved` is the greatest distance of a vertex, and so of any point of the surface, mm; `offset` the root mean square
    of the distances along the normals, mm; `put_back` the number of vertices moved back to undo self-intersections.
    """

    vertices: Floats
    moved: float
    offset: float
    put_back: int


def hold_smoothing(vertices: Floats, smoothed: Floats, faces: Ints, limit: float) -> Smoothed:
    """Return the `smoothed` vertices, each within `limit` mm of its old position, at the volume of `vertices`.

    Where smoothing makes the surface intersect itself, as between walls less than a voxel apart, the vertices are moved
    back to their old positions; if this does not help within some rounds, all vertices are moved back.
    """
    limits = np.full(len(vertices), limit)
    held = _at_volume(vertices, smoothed, faces, limits)
    crossing = self_intersecting_faces(held, faces)
    most = int(self_intersecting_faces(vertices, faces).sum()) if crossing.any() else 0
    for _ in range(_ROUNDS):
        if int(crossing.sum()) <= most:
            return _measure_moves(vertices, held, faces, int((limits == 0.0).sum()))
        limits[faces[crossing]] = 0.0
        held = _at_volume(vertices, smoothed, faces, limits)
        crossing = self_intersecting_faces(held, faces)
    return Smoothed(vertices, 0.0, 0.0, len(vertices))


def _measure_moves(vertices: Floats, held: Floats, faces: Ints, put_back: int) -> Smoothed:
    moves = held - vertices
    along = np.einsum("ij,ij->i", moves, _normals(held, faces))
    furthest = float(np.linalg.norm(moves, axis=1).max(initial=0.0))
    return Smoothed(held, furthest, float(np.sqrt(np.square(along).mean())), put_back)


def _at_volume(old: Floats, vertices: Floats, faces: Ints, limits: Floats) -> Floats:
    """Move a surface along its normals to the volume of `old`, each vertex within `limits` (n,) mm of `old`."""
    wanted, _ = _volume_and_area(old, faces)
    vertices = _within(old, vertices, limits)
    for _ in range(_VOLUME_STEPS):
        volume, area = _volume_and_area(vertices, faces)
        if abs(volume - wanted) <= _SAME_VOLUME * abs(wanted):
            break
        vertices = _within(old, vertices + (wanted - volume) / area * _normals(vertices, faces), limits)
    return vertices


def _within(old: Floats, vertices: Floats, limits: Floats) -> Floats:
    """Return the vertices, moved back to `limits` (n,) mm from their `old` positions if further."""
    moves = vertices - old
    lengths = np.linalg.norm(moves, axis=1)
    return np.asarray(old + (np.minimum(lengths, limits) / np.maximum(lengths, np.finfo(float).tiny))[:, None] * moves)


def _volume_and_area(vertices: Floats, faces: Ints) -> tuple[float, float]:
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0), float(doubled.sum() / 2.0)


def _normals(vertices: Floats, faces: Ints) -> Floats:
    """Return the unit normal at each vertex, weighted by area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normals[:, axis], 3), len(vertices)) for axis in range(3)], axis=1
    )
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(float).tiny))
