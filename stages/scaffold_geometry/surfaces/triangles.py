"""Formulas on triangle meshes: vertices (n, 3), faces (m, 3) corner indices, counter-clockwise from outside.

A half-edge `h` runs from corner `h % 3` of face `h // 3` to that face's next corner. Two faces are neighbours if they
share an edge, not if they share only a vertex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces.edges import components
from scaffold_geometry.surfaces.keys import equal_rows, hash_rows, sort_keys, unique_keys

FLAT = 1e-12
"""Height, as a share of the greatest coordinate, below which float64 cannot distinguish an area from 0."""


class EdgeFaults(NamedTuple):
    """Numbers of edges with one face, with more than two, and with two faces of the same direction."""

    boundary: int
    non_manifold: int
    misoriented: int


class Winding(NamedTuple):
    """The faces to flip, (m,) bool, so that neighbours agree, and whether this is possible everywhere."""

    turn: Bools
    orientable: bool


def merge_coincident(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the mesh with coincident vertices merged, in the order of `vertices`."""
    if not len(vertices):
        return vertices, faces
    places = vertices + 0.0  # -0.0 and 0.0 are equal
    first, place = equal_rows(hash_rows(places))
    if not np.array_equal(places[first][place], places):  # two positions share a key: once in 10^6 files
        _, exact = np.unique(places, axis=0, return_inverse=True)
        first, place = equal_rows(exact.reshape(-1))
    return places[first], place[faces]


def size_in_words(vertices: Floats, faces: Ints) -> str:
    """Return the size of the bounding box of the used vertices as `70.2 x 57.7 x 61.8`."""
    return " x ".join(f"{length:.4g}" for length in np.ptp(vertices[faces], axis=(0, 1)))


def drop_unreferenced(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the mesh without the vertices that no face uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def duplicate_vertex_faces(faces: Ints) -> Bools:
    """Return which faces use a vertex twice, (m,)."""
    collapsed: Bools = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return collapsed


def flat_faces(vertices: Floats, faces: Ints) -> Bools:
    """Return which faces have no height over their longest side, (m,), including those with coincident corners."""
    corners = vertices[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(axis=1, initial=0.0)
    doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat: Bools = doubled <= longest * FLAT * np.abs(vertices).max(initial=0.0)
    return flat


def duplicate_faces(faces: Ints) -> Bools:
    """Return which faces have the same corners as an earlier one, in any order, (m,)."""
    corners = np.sort(faces, axis=1)
    first, group = equal_rows(hash_rows(corners)) if len(faces) else (faces[:0, 0], faces[:0, 0])
    if not np.array_equal(corners[first][group], corners):  # two triples share a key: once in 10^6 files
        first, group = equal_rows(np.unique(corners, axis=0, return_inverse=True)[1].reshape(-1))
    repeated = np.ones(len(faces), dtype=bool)
    repeated[first] = False
    return repeated


def edge_faults(faces: Ints) -> EdgeFaults:
    """Count the edges at which a surface is not closed, manifold or consistently oriented."""
    key = _edge_keys(faces)
    _, edge, uses = unique_keys(key)
    forward = np.bincount(edge, weights=_tails(faces) < _heads(faces), minlength=len(uses))
    pairs = uses == 2  # an edge of a closed surface has two faces
    return EdgeFaults(
        boundary=int((uses == 1).sum()),
        non_manifold=int((uses > 2).sum()),
        misoriented=int((pairs & (forward != 1)).sum()),
    )


def face_pieces(faces: Ints) -> Ints:
    """Return the number of the edge-connected piece that each face belongs to, (m,), from 0."""
    one, other = _neighbours(faces)
    return components(one // 3, other // 3, len(faces))


def corner_fans(faces: Ints) -> Ints:
    """Return the number of the fan that each corner belongs to, (m, 3), from 0.

    A fan is a set of faces at a vertex, connected by edges; at a vertex with two fans the surface touches itself.
    """
    one, other = _neighbours(faces)
    is_same_way = _tails(faces)[one] == _tails(faces)[other]
    at_tail = np.where(is_same_way, other, _next(other))
    at_head = np.where(is_same_way, _next(other), other)
    starts, ends = np.concatenate([one, _next(one)]), np.concatenate([at_tail, at_head])
    return components(starts, ends, faces.size).reshape(-1, 3)


def touching_vertices(faces: Ints) -> int:
    """Count the vertices at which a surface touches itself: those with more than one fan."""
    fans = corner_fans(faces).ravel()
    vertex = np.empty(int(fans.max(initial=-1)) + 1, dtype=np.int64)
    vertex[fans] = faces.ravel()  # all corners of a fan are at one vertex
    return int((np.bincount(vertex) > 1).sum())


def euler_characteristic(faces: Ints) -> int:
    """Return vertices - edges + faces, with the vertices that the faces use."""
    return len(np.unique(faces)) - len(unique_keys(_edge_keys(faces))[0]) + len(faces)


def consistent_winding(faces: Ints) -> Winding:
    """Find the faces to flip for a consistent orientation; in each piece, the smaller set of faces is flipped.

    Every face is two nodes of a graph, unchanged and flipped; edges of the mesh connect nodes that agree. A piece is
    orientable if both nodes of a face are never connected. Edges of more than two faces are ignored.
    """
    count = len(faces)
    one, other = _neighbours(faces, only_pairs=True)
    clash = (_tails(faces)[one] == _tails(faces)[other]).astype(np.int64)
    if not clash.any():
        return Winding(turn=np.zeros(count, dtype=bool), orientable=True)
    a, b = one // 3, other // 3
    side = components(
        np.concatenate([a, a + count]), np.concatenate([b + clash * count, b + (1 - clash) * count]), 2 * count
    )
    as_is, turned = side[:count], side[count:]
    # The larger of a piece's two components has the orientation of most of its faces.
    sizes = np.bincount(as_is, minlength=2 * count)
    turn = (sizes[as_is] < sizes[turned]) | ((sizes[as_is] == sizes[turned]) & (as_is > turned))
    return Winding(turn=turn, orientable=bool((as_is != turned).all()))


def turn_faces(faces: Ints, turn: Bools) -> Ints:
    """Return the faces with those of `turn` (m,) flipped."""
    return np.where(turn[:, None], faces[:, ::-1], faces)


def piece_volumes(vertices: Floats, faces: Ints, pieces: Ints) -> Floats:
    """Return the signed volume of each piece, in the cube of the vertices' unit."""
    if not len(faces):
        return np.zeros(0)
    a, b, c = np.moveaxis((vertices - vertices[faces].mean(axis=(0, 1)))[faces], 1, 0)
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return np.bincount(pieces, weights=volumes).astype(np.float64)


def face_areas(vertices: Floats, faces: Ints) -> Floats:
    """Return the area of each face, (m,), in the square of the vertices' unit."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def winding_number(point: Floats, vertices: Floats, faces: Ints) -> float:
    """Return the winding number of a closed surface about `point` (3,): 1 inside, 0 outside, negated if inverted.

    The sum of solid angles of Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126: exact, and faster
    for one point than libigl's fast version, which first builds a tree (docs/decisions/libraries.md).
    """
    a, b, c = np.moveaxis(vertices[faces] - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    products = [np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + products[0] * lc + products[1] * la + products[2] * lb
    above = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(np.arctan2(above, below).sum() / (2.0 * np.pi))


def _tails(faces: Ints) -> Ints:
    return faces.ravel()


def _heads(faces: Ints) -> Ints:
    return np.roll(faces, -1, axis=1).ravel()


def _next(half_edge: Ints) -> Ints:
    return half_edge - half_edge % 3 + (half_edge + 1) % 3


def _edge_keys(faces: Ints) -> Ints:
    """Return a key for the undirected edge of each half-edge, (3m,)."""
    tails, heads = _tails(faces), _heads(faces)
    return np.asarray(np.minimum(tails, heads) * (faces.max(initial=0) + 1) + np.maximum(tails, heads))


def _neighbours(faces: Ints, *, only_pairs: bool = False) -> tuple[Ints, Ints]:
    """Return pairs of half-edges on one edge: k - 1 pairs for an edge of k faces, or none if `only_pairs` and k > 2."""
    key = _edge_keys(faces)
    order, ordered = sort_keys(key)
    meets = ordered[1:] == ordered[:-1]
    if only_pairs:
        run = np.concatenate([[False], meets, [False]])
        meets = meets & ~run[:-2] & ~run[2:]
    return order[:-1][meets], order[1:][meets]
