"""The corners, edges and faces of each cell type, and the rules of a mesh.

Corners follow VTK's order. Faces are shared with neighbours: the triangles and quadrangles of a solid cell, listed so
that their normals point out of a positively oriented cell, and the edges of a planar cell, counter-clockwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Face = tuple[int, ...]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class CellType:
    """A kind of cell: its number of corners, and its edges and faces as tuples of corner numbers."""

    name: str
    plural: str
    corners: int
    edges: tuple[tuple[int, int], ...]
    faces: tuple[Face, ...]
    is_planar: bool = False


_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_QUADRANGLE = ((0, 1), (1, 2), (2, 3), (3, 0))

CELL_TYPES = {
    cell_type.name: cell_type
    for cell_type in (
        CellType(
            "tetrahedron",
            "tetrahedra",
            4,
            ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
            ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
        ),
        CellType(
            "pyramid",
            "pyramids",
            5,
            ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
            ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
        ),
        CellType(
            "wedge",
            "wedges",
            6,
            ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
            ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
        ),
        CellType(
            "hexahedron",
            "hexahedra",
            8,
            (
                *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6)),
                *((6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
            ),
            ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
        ),
        CellType("triangle", "triangles", 3, _TRIANGLE, _TRIANGLE, is_planar=True),
        CellType("quadrangle", "quadrangles", 4, _QUADRANGLE, _QUADRANGLE, is_planar=True),
    )
}


def cell_measures(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the signed volume, mm^3, of each solid cell or the signed area, mm^2, of each planar one, (m,)."""
    return cell_areas(vertices, cells) if CELL_TYPES[kind].is_planar else cell_volumes(vertices, cells, kind)


def cell_volumes(vertices: Floats, cells: Ints, kind: str) -> Floats:
    """Return the signed volume of each cell, (m,), mm^3: positive if the corners follow VTK's order.

    By the divergence theorem over the cell's faces. Each quadrangle is split into four triangles about its centre, so
    that both cells of a face use the same surface.
    """
    corners = vertices[cells]
    centre = corners.mean(axis=1)
    volumes = np.zeros(len(cells))
    for face in CELL_TYPES[kind].faces:
        ring = corners[:, face] - centre[:, None]
        hub = ring.mean(axis=1)
        for a, b in zip(range(len(face)), (*range(1, len(face)), 0), strict=True):
            volumes += np.einsum("ij,ij->i", hub, np.cross(ring[:, a], ring[:, b])) / 6.0
    return volumes


def cell_areas(vertices: Floats, cells: Ints) -> Floats:
    """Return the signed area of each cell in a plane z = const, (m,), mm^2: positive if counter-clockwise from +z."""
    ring = vertices[cells][:, :, :2]
    ring = ring - ring.mean(axis=1, keepdims=True)
    return np.asarray(_cross(ring, np.roll(ring, -1, axis=1)).sum(axis=1) / 2.0)


def corner_turns(vertices: Floats, cells: Ints) -> Floats:
    """Return the cross product of both sides at each corner of cells in a plane z = const, (m, corners), mm^2."""
    ring = vertices[cells][:, :, :2]
    return _cross(ring - np.roll(ring, 1, axis=1), np.roll(ring, -1, axis=1) - ring)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the z component of the cross products of vectors in the plane, (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def edges_of_cells(cells: Mapping[str, Ints]) -> Ints:
    """Return every edge of `cells`, kind -> (m, corners), once, (k, 2), smaller index first, sorted."""
    ends = [corners[:, list(pair)] for kind, corners in cells.items() for pair in CELL_TYPES[kind].edges]
    return distinct_rows(np.sort(np.concatenate(ends), axis=1))[0]


def faces_of_cells(cells: Mapping[str, Ints]) -> Ints:
    """Return the corners of each face of each cell, cell after cell, (h, 4), padded with -1."""
    return np.concatenate([_faces_of_kind(kind, corners) for kind, corners in cells.items()])


def _faces_of_kind(kind: str, cells: Ints) -> Ints:
    faces = CELL_TYPES[kind].faces
    corners = np.full((len(cells), len(faces), 4), -1)
    for i, face in enumerate(faces):
        corners[:, i, : len(face)] = cells[:, list(face)]
    return corners.reshape(-1, 4)


def distinct_rows(rows: Ints) -> tuple[Ints, Ints]:
    """Return the distinct rows of `rows` (r, w), in lexicographic order, and the number of each row's, (r,).

    Rows are packed into one integer each: `np.unique(axis=0)` compares them as byte strings, which is slow.
    """
    keys = _pack_rows(rows)
    order = np.argsort(keys)
    ordered = keys[order]
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = ordered[1:] != ordered[:-1]
    groups = np.empty(len(rows), dtype=np.int64)
    groups[order] = np.cumsum(is_new) - 1
    return rows[order[is_new]], groups


def _pack_rows(rows: Ints) -> Ints:
    """Return one integer for each row, (r,), in the order of the rows."""
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


def mesh_faults(vertices: Floats, cells: Mapping[str, Ints]) -> Iterator[str]:
    """Yield a line for each rule that a mesh breaks: `vertices` (n, 3), `cells` kind -> (m, corners)."""
    if not cells:
        yield ": must have at least one cell, got none"
        return
    used, z = np.zeros(len(vertices), dtype=bool), vertices[:, 2]
    if any(CELL_TYPES[kind].is_planar for kind in cells) and z.min() < z.max():
        yield f".vertices: must all have one z, but it runs from {z.min():g} to {z.max():g} mm"
    for kind, corners in cells.items():
        used[corners] = True
        yield from _cell_faults(vertices, corners, kind)
    if not used.all():
        yield f".vertices: every vertex must belong to a cell, {int((~used).sum())} do not"
    yield from _doubled_faces(cells)


def _cell_faults(vertices: Floats, cells: Ints, kind: str) -> Iterator[str]:
    ordered = np.sort(cells, axis=1)
    yield from _broken((ordered[:, 1:] == ordered[:, :-1]).any(axis=1), kind, "have distinct corners")
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused as well
        measures = cell_measures(vertices, cells, kind)
    measure = "area, its corners counter-clockwise" if CELL_TYPES[kind].is_planar else "volume"
    yield from _broken(~((measures > 0.0) & np.isfinite(measures)), kind, f"have a positive {measure}")
    if kind == "quadrangle":
        is_crossed = (corner_turns(vertices, cells) < 0.0).sum(axis=1) > 1
        yield from _broken(is_crossed, kind, "have sides that do not cross")


def _broken(is_broken: Bools, kind: str, rule: str) -> Iterator[str]:
    if is_broken.any():
        yield (
            f".{CELL_TYPES[kind].plural}: every cell must {rule}, but {int(is_broken.sum())} of {len(is_broken)} do "
            f"not (the first is cell {int(np.argmax(is_broken))})"
        )


def _doubled_faces(cells: Mapping[str, Ints]) -> Iterator[str]:
    """Yield a fault if two cells have a face in the same orientation: then they are on the same side of it."""
    faces = faces_of_cells(cells)
    sides = 2 * distinct_rows(np.sort(faces, axis=1))[1] + _is_walked_upwards(faces)
    is_doubled = np.bincount(sides) > 1
    if is_doubled.any():
        first = faces[np.argmax(is_doubled[sides])]
        yield (
            f": a face must have one cell on each side at most, but {int(is_doubled.sum())} have more (the first is "
            f"that of vertices {', '.join(map(str, first[first >= 0]))}); remove duplicate or overlapping cells"
        )


def _is_walked_upwards(faces: Ints) -> Bools:
    """Return which of the `faces` (h, 4) go from their least corner to the lesser of its neighbours, (h,)."""
    corners, rows = (faces >= 0).sum(axis=1), np.arange(len(faces))
    first = np.where(faces >= 0, faces, np.iinfo(np.int64).max).argmin(axis=1)
    ahead, behind = faces[rows, (first + 1) % corners], faces[rows, (first - 1) % corners]
    return np.asarray(np.where(ahead == behind, first == 0, ahead < behind))
