"""The distance of a repaired surface from the original: exact point-to-triangle distances of many samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import Surface

_MOST_SAMPLES = 200_000
_MOST_ASKED = 20_000
"""Most samples tested for inside or outside: each takes 0.1 ms near long triangles."""

_MOST_STEPS = 40
"""Most steps along a triangle's longest side: enough to find the farthest point, without covering planes."""

_WITHIN = 0.25
"""Least winding number on both sides of an inner face: the lower one is about 0.5 for a wall in a body, 0 for the
body's own surface, and -0.5 for a sheet outside."""

_NEGLIGIBLE = 1e-6
"""Share of the diagonal below which a distance is negligible."""

_INNER = 0.02
"""Share of the way to the centre of its face at which both sides of a sample are tested: at a sharp edge, one side of a
face is the other side of the next."""

_BESIDE = 1e-5
"""Distance from a triangle at which the winding number is evaluated, as a share of the diagonal."""


class Farthest(NamedTuple):
    """The greatest distance, and its place (3,) on the surface of the samples."""

    distance: float
    place: Floats


NOWHERE = Farthest(0.0, np.zeros(3))


class Displacement(NamedTuple):
    """The distances between the original and the repaired surface.

    `lost` is the greatest distance of the original from the result, without its faces inside the solid; `gained` that
    of the result from the original. `inner` is the area, mm^2, of the removed faces inside the solid.
    """

    lost: Farthest
    gained: Farthest
    inner: float


def measure_displacement(read: Surface, repaired: Surface, kept: Surface, spacing: float) -> Displacement:
    """Compare the whole original with the whole repaired surface, and the kept part of it with the original.

    Triangles in both surfaces are skipped; the others are sampled about every `spacing`.
    """
    if np.array_equal(read[0], kept[0]) and np.array_equal(np.sort(read[1], axis=1), np.sort(kept[1], axis=1)):
        return Displacement(NOWHERE, NOWHERE, 0.0)
    old, new = find_changed_faces(read, repaired), find_changed_faces(kept, read)
    points = samples(kept[0], kept[1][new], spacing).points
    gained = _greatest(points, _distances(points, read))
    found = samples(read[0], read[1][old], spacing)
    distances = _distances(found.points, repaired)
    far = np.flatnonzero(distances > _NEGLIGIBLE * float(np.linalg.norm(np.ptp(read[0], axis=0))))
    stride = -(-len(far) // _MOST_ASKED) or 1
    asked = far[::stride]
    is_inner = _is_inside(found.only(asked), read)
    is_counted = np.ones(len(distances), bool)
    is_counted[far] = False
    is_counted[asked[~is_inner]] = True
    lost = _greatest(found.points[is_counted], distances[is_counted])
    return Displacement(lost, gained, stride * float(found.areas[asked[is_inner]].sum()))


def find_changed_faces(one: Surface, other: Surface) -> Bools:
    """Return which faces of `one` have no face of `other` with the same three corners, (m,)."""
    vertices = np.concatenate([one[0], other[0]])
    faces = np.concatenate([one[1], other[1] + len(one[0])])
    places, faces = triangles.merge_coincident(vertices, faces)
    first, second, third = np.sort(faces, axis=1).T.astype(np.uint64)
    # beyond two million vertices this overflows, and two triangles may share a key, which is improbable
    key = (first * np.uint64(len(places)) + second) * np.uint64(len(places)) + third
    return ~np.isin(key[: len(one[1])], key[len(one[1]) :])


class Samples(NamedTuple):
    """Points on a surface (k, 3), the same moved towards the centre of their face, its normal, and their area."""

    points: Floats
    inner: Floats
    normals: Floats
    areas: Floats

    def only(self, wanted: Ints) -> Samples:
        """Return some of the samples."""
        return Samples(*(values[wanted] for values in self))


def samples(vertices: Floats, faces: Ints, spacing: float) -> Samples:
    """Return points on the faces, including corners and centres, about `spacing` apart.

    They are sparser if this would give more than 200,000.
    """
    areas = triangles.face_areas(vertices, faces)
    spacing = max(spacing, float(np.sqrt(2.0 * areas.sum() / _MOST_SAMPLES)), float(np.finfo(float).tiny))
    corners = vertices[faces]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1, initial=0.0)
    steps = np.clip(np.ceil(sides / spacing), 1, _MOST_STEPS).astype(int)
    points, owners, shares = [np.empty((0, 3))], [np.empty(0, np.int64)], [np.empty(0)]
    for count in np.unique(steps):
        own = np.flatnonzero(steps == count)
        weights = _lattice(int(count))
        points.append(np.einsum("kc,fcx->fkx", weights, corners[own]).reshape(-1, 3))
        owners.append(np.repeat(own, len(weights)))
        shares.append(np.repeat(areas[own] / len(weights), len(weights)))
    at, owner = np.concatenate(points), np.concatenate(owners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    inner = at + _INNER * (corners.mean(axis=1)[owner] - at)
    return Samples(at, inner, normals[owner], np.concatenate(shares))


def _lattice(steps: int) -> Floats:
    """Return barycentric weights (k, 3) of the corners, `steps` intervals to a side, and of the centre."""
    first, second = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    within = first + second <= steps
    weights = np.column_stack([first[within], second[within], steps - first[within] - second[within]]) / steps
    return np.concatenate([weights, np.full((1, 3), 1.0 / 3.0)])


def _distances(points: Floats, surface: Surface) -> Floats:
    import igl

    if not len(points):
        return np.empty(0)
    vertices, faces = (np.ascontiguousarray(array) for array in surface)
    squared, _, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), vertices, faces)
    return np.sqrt(np.asarray(squared, np.float64))


def _greatest(points: Floats, distances: Floats) -> Farthest:
    if not len(points):
        return NOWHERE
    at = int(np.argmax(distances))
    return Farthest(float(distances[at]), points[at])


def _is_inside(found: Samples, surface: Surface) -> Bools:
    """Return which samples have the inside of a surface on both sides, (k,)."""
    import igl

    if not len(found.points):
        return np.empty(0, bool)
    vertices, faces = surface
    wound = triangles.turn_faces(faces, triangles.consistent_winding(faces).turn)
    if triangles.piece_volumes(vertices, wound, wound[:, 0] * 0).sum() < 0.0:
        wound = wound[:, ::-1]
    wound = np.ascontiguousarray(wound)
    step = _BESIDE * float(np.linalg.norm(np.ptp(vertices, axis=0))) * found.normals
    sides = [igl.fast_winding_number(vertices, wound, found.inner + way * step) for way in (1, -1)]
    inside: Bools = np.minimum(*sides) > _WITHIN
    return inside
