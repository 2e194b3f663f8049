"""The points and segments of a mesh from which a field is computed, and the slab around a planar mesh.

In a planar mesh cells are polygons and faces are edges: a channel runs from a cell's centre to the middle of an edge.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_pipeline.artifacts.cells import CELL_TYPES, corner_turns, distinct_rows, edges_of_cells, faces_of_cells

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Geometry of a mesh of n vertices, f faces, m cells, h channels and k edges, for a field; lengths in mm.

    `vertices` (n, 3); `face_centres` (f, 3), a face shared by two cells once; `cell_centres` (m, 3), kind after
    kind in the order of `CELL_TYPES`; `channel_starts` (h, 3) at cell centres and `channel_ends` (h, 3) at face
    centres, one for each (cell, face), cell after cell; `channel_cells` and `channel_faces` (h,), the indices of
    that cell and face; `edges` (k, 2) vertex indices, the smaller first, sorted. `local_lengths` (n,) is the mean
    length of the edges at each vertex; `edge_lengths` (k,) is its mean over the ends of each edge and
    `channel_lengths` (h,) its mean over the corners of each channel's cell: the local size of the mesh, not the
    segment's own length. `mean_edge_length` is the mean over all edges.
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
    edges = edges_of_cells(by_kind)
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
    """Find the faces by their sorted corners, padded with -1, so that one sort covers all shapes."""
    unique, of_channels = distinct_rows(np.sort(faces_of_cells(cells), axis=1))
    is_corner = unique >= 0
    sums = np.where(is_corner[:, :, None], vertices[unique], 0.0).sum(axis=1)
    return _Faces(sums / is_corner.sum(axis=1)[:, None], of_channels)


def slab_around(vertices: Floats, cells: Mapping[str, Ints]) -> tuple[Floats, Ints]:
    """Return a closed slab around a planar mesh, as thick as its mean boundary edge is long, normals outward.

    Its vertices (2 n, 3) mm are those of the mesh, below and above the plane; its triangles (m, 3) cover exactly the
    area of the cells.
    """
    edges = faces_of_cells(cells)
    groups = distinct_rows(np.sort(edges, axis=1))[1]
    a, b = edges[np.bincount(groups)[groups] == 1, :2].T
    half = np.array([0.0, 0.0, np.linalg.norm(vertices[b] - vertices[a], axis=1).mean() / 2.0])
    up = len(vertices)
    walls = [np.stack(corners, axis=1) for corners in ((a, b, b + up), (a, b + up, a + up))]
    bottom = np.concatenate([_fans(vertices, tiles) for tiles in cells.values()])[:, ::-1]
    return np.concatenate([vertices - half, vertices + half]), np.concatenate([bottom, bottom[:, ::-1] + up, *walls])


def _fans(vertices: Floats, tiles: Ints) -> Ints:
    """Return the triangles of planar cells (m, corners), as fans from the corner that turns least: a reflex one."""
    corners = tiles.shape[1]
    first = corner_turns(vertices, tiles).argmin(axis=1)
    ring = np.take_along_axis(tiles, (first[:, None] + np.arange(corners)) % corners, axis=1)
    return np.concatenate([ring[:, [0, i, i + 1]] for i in range(1, corners - 1)])
