"""The points and segments of a volume mesh that a field is made of.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.cell_types import CELL_TYPES

if TYPE_CHECKING:
    from collections.abc import Mapping

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Skeleton:
    """What a mesh of n vertices, f faces, m cells, h channels and k edges gives a field; lengths mm.

    `vertices` (n, 3); `face_centres` (f, 3), a face shared by two cells once; `cell_centres` (m, 3), the
    kinds one after the other in the order of `CELL_TYPES`; `channel_starts` (h, 3) at cell centres and
    `channel_ends` (h, 3) at face centres, one for each (cell, face), cell after cell; `channel_cells` and
    `channel_faces` (h,), the indices of that cell and face; `edges` (k, 2) vertex indices, the smaller first,
    sorted. `local_lengths` (n,) is the mean length of the edges that meet at each vertex; `edge_lengths` (k,)
    its mean over the ends of each edge and `channel_lengths` (h,) over the corners of each channel's cell:
    the size of the mesh there, not the segment's own length. `mean_edge_length` is over all edges.
    """

    vertices: Floats
    face_centres: Floats
    cell_centres: Floats
    channel_starts: Floats
    channel_ends: Floats
    channel_cells: Ints
    channel_faces: Ints
    edges: Ints
    local_lengths: Floats
    edge_lengths: Floats
    channel_lengths: Floats
    mean_edge_length: float


@dataclass(frozen=True, eq=False)
class _Faces:
    """Unique faces: `centres` (f, 3); the face of each (cell, face) as `of_channels` (h,)."""

    centres: Floats
    of_channels: Ints


def skeleton_of(vertices: Floats, cells: Mapping[str, Ints]) -> Skeleton:
    """Return the skeleton of `vertices` (n, 3) mm and `cells`, kind -> (m, corners) in VTK's order."""
    by_kind = {kind: cells[kind] for kind in CELL_TYPES if kind in cells and len(cells[kind])}
    edges = _unique_edges(by_kind)
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    local_lengths = _mean_at_vertices(edges, lengths, len(vertices))
    cell_centres = _means_over_corners(vertices, by_kind)
    faces = _unique_faces(vertices, by_kind)
    channel_cells = _channel_cells(by_kind)
    return Skeleton(
        vertices=vertices,
        face_centres=faces.centres,
        cell_centres=cell_centres,
        channel_starts=cell_centres[channel_cells],
        channel_ends=faces.centres[faces.of_channels],
        channel_cells=channel_cells,
        channel_faces=faces.of_channels,
        edges=edges,
        local_lengths=local_lengths,
        edge_lengths=local_lengths[edges].mean(axis=1),
        channel_lengths=_means_over_corners(local_lengths, by_kind)[channel_cells],
        mean_edge_length=float(lengths.mean()),
    )


def _means_over_corners(values: Floats, cells: Mapping[str, Ints]) -> Floats:
    """Return the mean of `values` (n, ...) over the corners of each cell, (m, ...)."""
    return np.concatenate([values[corners].mean(axis=1) for corners in cells.values()])


def _unique_edges(cells: Mapping[str, Ints]) -> Ints:
    ends = [corners[:, list(pair)] for kind, corners in cells.items() for pair in CELL_TYPES[kind].edges]
    return _groups(np.sort(np.concatenate(ends), axis=1))[0]


def _mean_at_vertices(edges: Ints, lengths: Floats, count: int) -> Floats:
    """Return the mean length of the edges at each of `count` vertices, (count,)."""
    both = edges.T.ravel()
    totals = np.bincount(both, weights=np.tile(lengths, 2), minlength=count)
    return totals / np.bincount(both, minlength=count)


def _channel_cells(cells: Mapping[str, Ints]) -> Ints:
    faces_per_cell = [np.full(len(corners), len(CELL_TYPES[kind].faces)) for kind, corners in cells.items()]
    counts = np.concatenate(faces_per_cell)
    return np.repeat(np.arange(len(counts)), counts)


def _unique_faces(vertices: Floats, cells: Mapping[str, Ints]) -> _Faces:
    """Find the faces by their corners; triangles are filled up with -1, so one sort serves both shapes."""
    corners = np.concatenate([_faces_of_cells(kind, of_kind) for kind, of_kind in cells.items()])
    corners.sort(axis=1)
    unique, of_channels = _groups(corners)
    is_corner = unique >= 0
    sums = np.where(is_corner[:, :, None], vertices[unique], 0.0).sum(axis=1)
    return _Faces(sums / is_corner.sum(axis=1)[:, None], of_channels)


def _faces_of_cells(kind: str, cells: Ints) -> Ints:
    """Return the corners of each face, cell after cell, (m * faces, 4), -1 where a triangle has none."""
    faces = CELL_TYPES[kind].faces
    corners = np.full((len(cells), len(faces), 4), -1)
    for i, face in enumerate(faces):
        corners[:, i, : len(face)] = cells[:, list(face)]
    return corners.reshape(-1, 4)


def _groups(rows: Ints) -> tuple[Ints, Ints]:
    """Return the distinct rows of `rows` (r, w), in lexicographic order, and which one each is, (r,).

    Rows are packed into one integer each: `np.unique(axis=0)` compares them as byte strings, which is slow.
    """
    keys = _packed(rows)
    order = np.argsort(keys)
    ordered = keys[order]
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = ordered[1:] != ordered[:-1]
    groups = np.empty(len(rows), dtype=np.int64)
    groups[order] = np.cumsum(is_new) - 1
    return rows[order[is_new]], groups


def _packed(rows: Ints) -> Ints:
    """Return one integer for each row, (r,), that compares with others as the rows do."""
    least = rows.min()
    base = int(rows.max() - least) + 1
    keys: Ints = rows[:, 0] - least
    span = base
    for column in rows.T[1:]:
        if span > np.iinfo(np.int64).max // base:
            distinct, keys = np.unique(keys, return_inverse=True)
            span = len(distinct)
        keys = keys * base + (column - least)
        span *= base
    return keys
