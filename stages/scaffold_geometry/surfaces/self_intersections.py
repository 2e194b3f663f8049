"""Self-intersections of a triangle mesh: triangles that cross, touch or overlap, found exactly.

Two triangles may have in common only the vertices that they share and the edge between these. A tree of bounding boxes,
in the order of a space-filling curve, gives candidate pairs; signs of determinants decide, computed exactly if rounding
could change a sign.

CGAL's search through libigl finds the same, except duplicate faces, in twice the time and memory
(docs/decisions/libraries.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.jit import kernel, parallel_kernel, prange
from scaffold_geometry.surfaces.exact_predicates import orient_2d, orient_3d
from scaffold_pipeline.processes.isolation import Arrays

_FAN = 4
"""Children of a node: one level of the tree for each two bits of the number of triangles."""

_STACK = 128
"""Size of the stack of nodes: at most three for each level, and 2^60 triangles have 30 levels."""

_BITS = 21
"""Bits of each coordinate in the 63 bits of a position on the curve."""

_FINEST = 2.0**-200
"""Share of the greatest coordinate below which one is set to 0, so that products of the others are exact."""


def self_intersecting_faces(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Bools:
    """Return which faces (m, 3) meet another beyond the vertices and edge that they share, (m,).

    `vertices` (n, 3) are distinct. Faces without area are left out (see `degenerate_faces`); their neighbours overlap
    and are found, as are duplicate faces.
    """
    if len(faces) < 2:  # it takes two
        return np.zeros(len(faces), np.bool_)
    points, corners = _scale(vertices), np.ascontiguousarray(faces, np.int64)
    low, high = _boxes(points, corners)
    order = np.argsort(_places_on_curve(low, high, points.min(axis=0), points.max(axis=0)))
    lows, highs, starts = _tree(low[order], high[order])
    crossing = np.zeros(len(faces), np.bool_)
    crossing[order] = _crossings(points, corners[order], lows, highs, starts)
    return crossing


def degenerate_faces(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Bools:
    """Return which faces (m, 3) have all corners on one line, (m,)."""
    return _flats(_scale(vertices), np.ascontiguousarray(faces, np.int64))


def find_self_intersections(vertices: Floats, faces: Ints) -> Arrays:
    """Return the indices `faces` (k,) of the `self_intersecting_faces`; for a child process, as this can take long."""
    return {"faces": np.flatnonzero(self_intersecting_faces(vertices, faces))}


def _scale(vertices: NDArray[np.floating]) -> Floats:
    """Return the vertices divided by a power of two, so that coordinates are at most 1."""
    points = np.asarray(vertices, np.float64)
    scaled = np.ldexp(points, -int(np.frexp(np.abs(points).max(initial=0.0))[1]))
    return np.ascontiguousarray(np.where(np.abs(scaled) < _FINEST, 0.0, scaled))


def _tree(low: Floats, high: Floats) -> tuple[Floats, Floats, Ints]:
    """Return the boxes of all levels, (k, 3) both, the triangles' own first, and where each level starts."""
    lows, highs, starts = [low], [high], [0]
    while len(lows[-1]) > 1:
        groups = np.arange(0, len(lows[-1]), _FAN)
        starts.append(starts[-1] + len(lows[-1]))
        lows.append(np.minimum.reduceat(lows[-1], groups))
        highs.append(np.maximum.reduceat(highs[-1], groups))
    starts.append(starts[-1] + len(lows[-1]))
    return np.concatenate(lows), np.concatenate(highs), np.array(starts, np.int64)


@parallel_kernel
def _boxes(points: Floats, faces: Ints) -> tuple[Floats, Floats]:
    low, high = np.empty((len(faces), 3)), np.empty((len(faces), 3))
    for i in prange(len(faces)):
        for axis in range(3):
            a, b, c = points[faces[i, 0], axis], points[faces[i, 1], axis], points[faces[i, 2], axis]
            low[i, axis], high[i, axis] = min(a, b, c), max(a, b, c)
    return low, high


@parallel_kernel
def _places_on_curve(low: Floats, high: Floats, least: Floats, greatest: Floats) -> NDArray[np.uint64]:
    """Return the position of each box's centre on the Morton curve: the interleaved bits of its coordinates."""
    places = np.empty(len(low), np.uint64)
    extent = max(greatest[0] - least[0], greatest[1] - least[1], greatest[2] - least[2], _FINEST)
    steps = (1 << _BITS) - 1
    for i in prange(len(low)):
        place = np.uint64(0)
        for axis in range(3):
            share = (0.5 * (low[i, axis] + high[i, axis]) - least[axis]) / extent
            place |= _spread(np.uint64(share * steps)) << np.uint64(axis)
        places[i] = place
    return places


@kernel
def _spread(bits: np.uint64) -> np.uint64:
    """Return the 21 bits with two zeros between neighbours."""
    bits = (bits | (bits << np.uint64(32))) & np.uint64(0x001F00000000FFFF)
    bits = (bits | (bits << np.uint64(16))) & np.uint64(0x001F0000FF0000FF)
    bits = (bits | (bits << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    bits = (bits | (bits << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (bits | (bits << np.uint64(2))) & np.uint64(0x1249249249249249)


@parallel_kernel
def _crossings(points: Floats, faces: Ints, lows: Floats, highs: Floats, starts: Ints) -> Bools:
    """Return which faces cross another: each lowest node is tested against the later nodes of the tree."""
    crossing = np.zeros(len(faces), np.bool_)
    top = len(starts) - 2
    for group in prange(starts[2] - starts[1]):
        levels, nodes = np.empty(_STACK, np.int64), np.empty(_STACK, np.int64)
        levels[0], nodes[0] = top, 0
        waiting = 1
        while waiting:
            waiting -= 1
            level, node = levels[waiting], nodes[waiting]
            if not _overlap(lows, highs, starts[1] + group, starts[level] + node):
                continue
            if level == 1:
                _cross_groups(crossing, points, faces, lows, highs, group, node)
                continue
            first = node * _FAN
            last = min(first + _FAN, starts[level] - starts[level - 1])
            width = 1 << (2 * (level - 2))
            for child in range(first, last):
                if (child + 1) * width > group:  # contains a group that is not before this one
                    levels[waiting], nodes[waiting] = level - 1, child
                    waiting += 1
    return crossing


@kernel
def _cross_groups(
    crossing: Bools, points: Floats, faces: Ints, lows: Floats, highs: Floats, group: int, other: int
) -> None:
    """Mark the faces of two nodes that cross."""
    for i in range(group * _FAN, min((group + 1) * _FAN, len(faces))):
        if not _overlap(lows, highs, i, len(faces) + other):
            continue
        for j in range(max(i + 1, other * _FAN), min((other + 1) * _FAN, len(faces))):
            if crossing[i] and crossing[j]:  # a heap of 20,000 triangles takes 1 s, not 44 s
                continue
            if _overlap(lows, highs, i, j) and _meet(points, faces, i, j):
                crossing[i] = True
                crossing[j] = True


@kernel(inline=True)
def _overlap(lows: Floats, highs: Floats, i: int, j: int) -> bool:
    """Return whether two boxes overlap; without early exit, as branches cost more than comparisons."""
    return bool(
        (lows[i, 0] <= highs[j, 0])
        & (lows[j, 0] <= highs[i, 0])
        & (lows[i, 1] <= highs[j, 1])
        & (lows[j, 1] <= highs[i, 1])
        & (lows[i, 2] <= highs[j, 2])
        & (lows[j, 2] <= highs[i, 2])
    )


@kernel
def _meet(points: Floats, faces: Ints, i: int, j: int) -> bool:
    """Return whether two faces meet beyond the vertices and edge that they share."""
    shared, turn, other_turn = 0, 0, 0
    for k in range(3):
        for m in range(3):
            if faces[i, k] == faces[j, m]:
                shared += 1
                turn += k
                other_turn += m
    if shared == 0:
        return _meet_apart(points, faces[i, 0], faces[i, 1], faces[i, 2], faces[j, 0], faces[j, 1], faces[j, 2])
    if shared == 3:  # all corners
        return True
    if shared == 2:  # an edge: the corners' numbers add up to 3, less that of the third
        turn, other_turn = 3 - turn, 3 - other_turn
    a, b, c = faces[i, turn], faces[i, (turn + 1) % 3], faces[i, (turn + 2) % 3]
    d, e = faces[j, (other_turn + 1) % 3], faces[j, (other_turn + 2) % 3]
    if shared == 1:
        return _meet_beyond_vertex(points, a, b, c, d, e)
    return _fold(points, b, c, a, faces[j, other_turn])


@kernel
def _meet_beyond_vertex(points: Floats, a: int, b: int, c: int, d: int, e: int) -> bool:
    """Return whether triangles a, b, c and a, d, e meet beyond a: the side opposite to a in one meets the other."""
    of_d, of_e = orient_3d(points, a, b, c, d), orient_3d(points, a, b, c, e)
    if of_d * of_e > 0:
        return False
    of_b, of_c = orient_3d(points, a, d, e, b), orient_3d(points, a, d, e, c)
    if of_b * of_c > 0:
        return False
    return _pierces(points, d, e, of_d, of_e, a, b, c) or _pierces(points, b, c, of_b, of_c, a, d, e)


@kernel
def _meet_apart(points: Floats, a: int, b: int, c: int, d: int, e: int, f: int) -> bool:
    """Return whether triangles without a common vertex meet: a side of one meets the other."""
    of_d, of_e, of_f = orient_3d(points, a, b, c, d), orient_3d(points, a, b, c, e), orient_3d(points, a, b, c, f)
    if abs(of_d + of_e + of_f) == 3:  # all on one side
        return False
    of_a, of_b, of_c = orient_3d(points, d, e, f, a), orient_3d(points, d, e, f, b), orient_3d(points, d, e, f, c)
    if abs(of_a + of_b + of_c) == 3:
        return False
    return (
        _pierces(points, d, e, of_d, of_e, a, b, c)
        or _pierces(points, e, f, of_e, of_f, a, b, c)
        or _pierces(points, f, d, of_f, of_d, a, b, c)
        or _pierces(points, a, b, of_a, of_b, d, e, f)
        or _pierces(points, b, c, of_b, of_c, d, e, f)
        or _pierces(points, c, a, of_c, of_a, d, e, f)
    )


@kernel
def _pierces(points: Floats, p: int, q: int, of_p: int, of_q: int, a: int, b: int, c: int) -> bool:
    """Return whether segment p-q meets triangle a, b, c; `of_p`, `of_q` are the sides of its plane of p and q."""
    if of_p * of_q > 0:
        return False
    if of_p == 0 and of_q == 0:
        return _meets_in_plane(points, p, q, a, b, c)
    ab, bc, ca = orient_3d(points, p, q, a, b), orient_3d(points, p, q, b, c), orient_3d(points, p, q, c, a)
    return not (min(ab, bc, ca) < 0 < max(ab, bc, ca))


@kernel
def _fold(points: Floats, p: int, q: int, a: int, b: int) -> bool:
    """Return whether triangles p, q, a and q, p, b overlap."""
    if orient_3d(points, p, q, a, b) != 0:
        return False
    for axis in range(3):
        of_a = orient_2d(points, p, q, a, axis)
        if of_a != 0:
            return of_a == orient_2d(points, p, q, b, axis)
    return False


@kernel
def _meets_in_plane(points: Floats, p: int, q: int, a: int, b: int, c: int) -> bool:
    """Return whether segment p-q meets triangle a, b, c in its plane; False if the triangle has no area."""
    for axis in range(3):
        way = orient_2d(points, a, b, c, axis)
        if way != 0:
            return (
                _holds(points, p, a, b, c, way, axis)
                or _cross_in_plane(points, p, q, a, b, axis)
                or _cross_in_plane(points, p, q, b, c, axis)
                or _cross_in_plane(points, p, q, c, a, axis)
            )
    return False


@kernel
def _holds(points: Floats, p: int, a: int, b: int, c: int, way: int, axis: int) -> bool:
    return (
        orient_2d(points, a, b, p, axis) * way >= 0
        and orient_2d(points, b, c, p, axis) * way >= 0
        and orient_2d(points, c, a, p, axis) * way >= 0
    )


@kernel
def _cross_in_plane(points: Floats, p: int, q: int, a: int, b: int, axis: int) -> bool:
    """Return whether segments p-q and a-b, seen along `axis`, have a common point."""
    of_a, of_b = orient_2d(points, p, q, a, axis), orient_2d(points, p, q, b, axis)
    of_p, of_q = orient_2d(points, a, b, p, axis), orient_2d(points, a, b, q, axis)
    if of_a * of_b > 0 or of_p * of_q > 0:
        return False
    if of_a != 0 or of_b != 0 or of_p != 0 or of_q != 0:
        return True
    u, v = (axis + 1) % 3, (axis + 2) % 3  # all on one line: their intervals overlap
    return _apart(points[p, u], points[q, u], points[a, u], points[b, u]) and _apart(
        points[p, v], points[q, v], points[a, v], points[b, v]
    )


@kernel
def _apart(p: float, q: float, a: float, b: float) -> bool:
    return max(p, q) >= min(a, b) and max(a, b) >= min(p, q)


@parallel_kernel
def _flats(points: Floats, faces: Ints) -> Bools:
    flat = np.empty(len(faces), np.bool_)
    for i in prange(len(faces)):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        flat[i] = (
            orient_2d(points, a, b, c, 0) == 0
            and orient_2d(points, a, b, c, 1) == 0
            and orient_2d(points, a, b, c, 2) == 0
        )
    return flat
