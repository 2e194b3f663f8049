"""Triangulate a hole over its own vertices with the least bending: the first step of Liepa (2003), see `holes`.

Dynamic programming over all spans i..j of the loop, all spans of one length at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces.edges import edges_of

_NEVER = 1e9
"""The bend of a triangle with an edge that the surface already has; other bends are 0 to 2."""


@dataclass(frozen=True)
class _Spans:
    """For each span i..j of the loop: the greatest bend, the area, and the apex and normal of its triangle."""

    bends: Floats
    areas: Floats
    middles: Ints
    normals: Floats


def triangulate_hole(vertices: Floats, loop: Ints, rim_normals: Floats, near: Ints) -> Ints:
    """Return triangles over the loop's vertices, (n - 2, 3), with the smallest greatest bend, then the least area.

    `rim_normals` (n, 3) are the surface's normals at each edge of the loop. A new edge is none of the edges of the
    faces `near`, unless there is no other triangulation.
    """
    count, points, taken = len(loop), vertices[loop], _find_existing_edges(loop, near)
    square = (count, count)
    spans = _Spans(np.zeros(square), np.zeros(square), np.zeros(square, np.int64), np.zeros((*square, 3)))
    at = np.arange(count)
    spans.normals[at, (at + 1) % count] = rim_normals
    for length in range(2, count):
        start = at[: count - length]
        _span(points, spans, start, length, taken[start, start + length])
    return np.asarray(loop[_list_triangles(spans.middles)])


def _span(points: Floats, spans: _Spans, start: Ints, length: int, is_taken: Bools) -> None:
    """Find the best triangle for each span of one length, over all vertices between its ends."""
    first, end = start[:, None], start[:, None] + length
    middle = first + np.arange(1, length)
    normals = np.cross(points[middle] - points[first], points[end] - points[first])
    doubled = np.linalg.norm(normals, axis=2)
    normals /= np.maximum(doubled, np.finfo(float).tiny)[..., None]
    beside = [spans.normals[first, middle], spans.normals[middle, end]]
    if length == len(points) - 1:  # the last triangle is also at the loop's last edge
        beside.append(spans.normals[end, first])
    bends = np.maximum(spans.bends[first, middle], spans.bends[middle, end])
    for neighbour in beside:
        bends = np.maximum(bends, 1.0 - np.einsum("ijk,ijk->ij", normals, np.broadcast_to(neighbour, normals.shape)))
    bends = np.where(is_taken[:, None], _NEVER, np.round(bends, 6))
    areas = spans.areas[first, middle] + spans.areas[middle, end] + doubled / 2.0
    row, best = np.arange(len(start)), _least(bends, areas)
    of_span = (start, start + length)
    spans.bends[of_span], spans.areas[of_span] = bends[row, best], areas[row, best]
    spans.middles[of_span], spans.normals[of_span] = middle[row, best], normals[row, best]


def _least(bends: Floats, areas: Floats) -> Ints:
    """Return for each row the index of the least bend, and for equal bends of the least area."""
    is_least = bends <= bends.min(axis=1, keepdims=True)
    return np.asarray(np.where(is_least, areas, np.inf).argmin(axis=1), dtype=np.int64)


def _find_existing_edges(loop: Ints, faces: Ints) -> Bools:
    """Return which pairs of the loop's vertices already have an edge, (n, n), except neighbours on the loop."""
    count = len(loop)
    taken = np.zeros((count, count), bool)
    order = np.argsort(loop)
    ends = edges_of(faces).ends
    place = order[np.minimum(np.searchsorted(loop[order], ends), count - 1)]
    one, other = place[(loop[place] == ends).all(axis=1)].T
    taken[one, other] = taken[other, one] = True
    at = np.arange(count)
    taken[at, (at + 1) % count] = taken[(at + 1) % count, at] = False
    return taken


def _list_triangles(middles: Ints) -> Ints:
    """Return the triangles of the best spans of the whole loop, as indices on the loop."""
    found, todo = [], [(0, len(middles) - 1)]
    while todo:
        start, end = todo.pop()
        if end - start > 1:
            middle = int(middles[start, end])
            found.append((start, middle, end))
            todo += [(start, middle), (middle, end)]
    return np.array(found, np.int64)
