"""Functions on cells: `vertices` (n, 3) and `cells`, kind -> (m, corners) in VTK's order.

Cells are numbered consecutively, kind after kind, in the order of the mapping.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.artifacts.cells import CELL_TYPES, cell_volumes

Cells: TypeAlias = dict[str, Ints]

_REVERSED = {
    "tetrahedron": [0, 2, 1, 3],
    "pyramid": [0, 3, 2, 1, 4],
    "wedge": [3, 4, 5, 0, 1, 2],
    "hexahedron": [4, 5, 6, 7, 0, 1, 2, 3],
}
"""The corners of each kind in an order that changes the sign of the volume and keeps the faces."""


class Faces(NamedTuple):
    """How cells meet: the boundary's `triangles` (t, 3) and `quadrangles` (q, 4), outward, and the cell of each.

    `neighbours` (p, 2) are cells that share a face correctly; `clashing` (c, 2) are on the same side of a shared face,
    or have its corners in a different order; `crowded` are cells at a face that more than two cells share.
    """

    triangles: Ints
    quadrangles: Ints
    triangle_cells: Ints
    quadrangle_cells: Ints
    neighbours: Ints
    clashing: Ints
    crowded: Ints


def count(cells: Cells) -> int:
    """Return the number of cells of all kinds."""
    return sum(len(corners) for corners in cells.values())


def select_cells(cells: Cells, is_chosen: Bools) -> Cells:
    """Return the cells selected by the mask `is_chosen` (m,) over all kinds; empty kinds are removed."""
    ends = np.cumsum([len(corners) for corners in cells.values()])[:-1]
    parts = zip(cells.items(), np.split(is_chosen, ends), strict=True)
    return {kind: corners[part] for (kind, corners), part in parts if part.any()}


def drop_unused_vertices(vertices: Floats, cells: Cells) -> tuple[Floats, Cells]:
    """Return the mesh without the vertices that are in no cell."""
    used = np.zeros(len(vertices), dtype=bool)
    for corners in cells.values():
        used[corners] = True
    places = np.cumsum(used) - 1
    return vertices[used], {kind: places[corners] for kind, corners in cells.items()}


def merge_vertices(vertices: Floats, cells: Cells, distance: float) -> Cells:
    """Return the cells with vertices merged into the first of each group linked by distances up to `distance`."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(vertices).query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
    group = connected_components(graph, directed=False)[1]
    first = np.unique(group, return_index=True)[1].astype(np.int64)[group]
    return {kind: first[corners] for kind, corners in cells.items()}


def count_coincident_points(points: Floats, distance: float) -> int:
    """Return the number of `points` that have a neighbour within `distance`."""
    from scipy.spatial import cKDTree

    return len(np.unique(cKDTree(points).query_pairs(distance, output_type="ndarray")))


def duplicate_vertex_cells(cells: Cells) -> Bools:
    """Return a mask of the cells that use a vertex twice, (m,)."""
    rows = [np.sort(corners, axis=1) for corners in cells.values()]
    return np.concatenate([(row[:, 1:] == row[:, :-1]).any(axis=1) for row in rows])


def self_crossing_cells(vertices: Floats, cells: Cells) -> Bools:
    """Return a mask of the cells with a self-crossing quadrangle, (m,): it turns left at two corners, right at two."""
    return np.concatenate([_self_crossing_of_kind(vertices[corners], kind) for kind, corners in cells.items()])


def _self_crossing_of_kind(corners: Floats, kind: str) -> Bools:
    is_crossed = np.zeros(len(corners), dtype=bool)
    for face in CELL_TYPES[kind].faces:
        ring = corners[:, face]
        ahead = np.roll(ring, -1, axis=1) - ring
        turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
        against = np.einsum("mki,mi->mk", turns, turns[:, 0]) < 0.0
        is_crossed |= against.sum(axis=1) == len(face) // 2  # one corner against three is reflex, not a crossing
    return is_crossed


def duplicate_cells(cells: Cells) -> Bools:
    """Return a mask of the cells with the same corners as an earlier cell of their kind, (m,)."""
    return np.concatenate([triangles.duplicate_faces(corners) for corners in cells.values()])


def volumes(vertices: Floats, cells: Cells) -> Floats:
    """Return the signed volume of each cell, (m,)."""
    return np.concatenate([cell_volumes(vertices, corners, kind) for kind, corners in cells.items()])


def flat_cells(vertices: Floats, cells: Cells) -> Bools:
    """Return a mask of the flat cells, (m,): their volume is not above float64's rounding error at their position."""
    longest = []
    for kind, corners in cells.items():
        ends = vertices[corners[:, np.array(CELL_TYPES[kind].edges)]]
        longest.append(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1))
    least = triangles.FLAT * np.abs(vertices).max(initial=0.0) * np.concatenate(longest) ** 2
    return np.asarray(np.abs(volumes(vertices, cells)) <= least)


def reorient_cells(vertices: Floats, cells: Cells) -> tuple[Cells, int]:
    """Return the cells with those of negative volume reversed, and the number of these."""
    oriented, number = {}, 0
    for kind, corners in cells.items():
        is_negative = cell_volumes(vertices, corners, kind) < 0.0
        oriented[kind] = np.where(is_negative[:, None], corners[:, _REVERSED[kind]], corners)
        number += int(is_negative.sum())
    return oriented, number


def count_folded_cells(vertices: Floats, cells: Cells) -> int:
    """Return the number of folded cells: their volume may be positive, but parts are not visible from their centre."""
    number = 0
    for kind, corners in cells.items():
        places = vertices[corners]
        centre = places.mean(axis=1)
        is_folded = np.zeros(len(corners), dtype=bool)
        for face in CELL_TYPES[kind].faces:
            ring = places[:, face] - centre[:, None]
            parts = np.einsum("ij,ikj->ik", ring.mean(axis=1), np.cross(ring, np.roll(ring, -1, axis=1)))
            is_folded |= (parts <= 0.0).any(axis=1)
        number += int(is_folded.sum())
    return number


def faces(cells: Cells) -> Faces:
    """Return the boundary faces of the cells, and which cells share a face."""
    triangle, quadrangle = (_match_faces(*_faces_of(cells, width)) for width in (3, 4))
    return Faces(
        triangle.alone,
        quadrangle.alone,
        triangle.cells,
        quadrangle.cells,
        np.concatenate([triangle.neighbours, quadrangle.neighbours]),
        np.concatenate([triangle.clashing, quadrangle.clashing]),
        np.concatenate([triangle.crowded, quadrangle.crowded]),
    )


def pieces(neighbours: Ints, number: int) -> Ints:
    """Return the connected piece of each of `number` cells, (m,), from 0; cells that share a face are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = (neighbours[:, 0], neighbours[:, 1])
    graph = coo_array((np.ones(len(neighbours), np.int8), ends), shape=(number, number))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


class _FaceMatches(NamedTuple):
    alone: Ints
    cells: Ints
    neighbours: Ints
    clashing: Ints
    crowded: Ints


def _faces_of(cells: Cells, width: int) -> tuple[Ints, Ints]:
    """Return the faces with `width` corners, (f, width), and the cell of each, (f,)."""
    rows, owners, start = [np.empty((0, width), np.int64)], [np.empty(0, np.int64)], 0
    for kind, corners in cells.items():
        of_width = [face for face in CELL_TYPES[kind].faces if len(face) == width]
        rows += [corners[:, face] for face in of_width]
        owners += [np.arange(start, start + len(corners))] * len(of_width)
        start += len(corners)
    return np.concatenate(rows), np.concatenate(owners)


def _match_faces(corners: Ints, owners: Ints) -> _FaceMatches:
    """Classify faces (f, k) of cells `owners` (f,): of one cell, of two that match, of two that do not, of more."""
    width = corners.shape[1]
    start = np.argmin(corners, axis=1, keepdims=True) if len(corners) else np.zeros((0, 1), np.int64)
    rolled = np.take_along_axis(corners, (start + np.arange(width)) % width, axis=1)
    rows = np.sort(corners, axis=1)
    order = np.lexsort(rows.T)
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    sizes = np.diff(np.append(np.flatnonzero(is_new), len(order)))
    firsts = np.flatnonzero(is_new)
    alone, (one, other) = order[firsts[sizes == 1]], (order[firsts[sizes == 2] + step] for step in (0, 1))
    agrees = (rolled[one][:, [0, *range(width - 1, 0, -1)]] == rolled[other]).all(axis=1)
    pairs = np.column_stack([owners[one], owners[other]])
    is_crowded = np.repeat(sizes > 2, sizes)
    return _FaceMatches(
        corners[alone], owners[alone], pairs[agrees], pairs[~agrees], np.unique(owners[order[is_crowded]])
    )
