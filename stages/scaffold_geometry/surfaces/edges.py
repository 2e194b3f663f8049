"""The edges of a triangle mesh: their faces and directions, and parts connected over edges.

`vertices` (n, 3), `faces` (m, 3). A half-edge `h` runs from corner `h % 3` of face `h // 3` to that face's next corner.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.keys import sort_keys, unique_keys

Surface: TypeAlias = tuple[Floats, Ints]

MANIFOLD = 2
"""Faces at an edge of a closed manifold."""


class Edges(NamedTuple):
    """All edges: `ends` (k, 2) lower vertex first; `of` (3m,) the edge of each half-edge.

    `uses` (k,) is the number of faces at it, `net` (k,) the number of half-edges from its lower vertex minus those from
    its higher one.
    """

    ends: Ints
    of: Ints
    uses: Ints
    net: Ints


def edges_of(faces: Ints) -> Edges:
    """Return the edges of the faces, sorted by their vertices."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max(initial=0)) + 1
    key = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    key, of, uses = unique_keys(key)
    net = np.bincount(of, weights=np.where(tails < heads, 1.0, -1.0), minlength=len(key))
    return Edges(np.column_stack(np.divmod(key, count)), of, uses, net.astype(np.int64))


def patches_of(faces: Ints, edges: Edges) -> Ints:
    """Return the patch of each face, (m,), from 0: faces connected over edges of exactly two faces."""
    order, _ = sort_keys(edges.of)
    starts = np.cumsum(edges.uses) - edges.uses
    pairs = starts[edges.uses == MANIFOLD]
    return components(order[pairs] // 3, order[pairs + 1] // 3, len(faces))


def components(starts: Ints, ends: Ints, count: int) -> Ints:
    """Return the number of the connected component of each of `count` nodes, (count,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(starts), np.int8), (starts, ends)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def open_vertices(edges: Edges) -> Ints:
    """Return the vertices of edges with one face."""
    return np.unique(edges.ends[edges.uses == 1])


def rounding(vertices: Floats) -> float:
    """Return the greatest distance of two copies of one point in a file with float32 or six digits."""
    return ROUNDING * float(np.abs(vertices).max(initial=0.0))


ROUNDING = 2e-6
"""Share of the greatest coordinate: about 16 steps of float32, one of the sixth digit."""
