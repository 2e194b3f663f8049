"""The corners, edges and faces of each cell type: one table for all that walks over cells.

Corners follow VTK's order; faces are listed so that their normals point out of a positively oriented cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Face = tuple[int, ...]


@dataclass(frozen=True)
class CellType:
    """A kind of cell: its number of corners, and its edges and faces as tuples of corner numbers."""

    name: str
    corners: int
    edges: tuple[tuple[int, int], ...]
    faces: tuple[Face, ...]


CELL_TYPES = {
    cell_type.name: cell_type
    for cell_type in (
        CellType(
            "tetrahedron",
            4,
            ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
            ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
        ),
        CellType(
            "pyramid",
            5,
            ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
            ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
        ),
        CellType(
            "wedge",
            6,
            ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
            ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
        ),
        CellType(
            "hexahedron",
            8,
            (
                *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6)),
                *((6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
            ),
            ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
        ),
    )
}


def cell_volumes(vertices: NDArray[np.float64], cells: NDArray[np.int64], kind: str) -> NDArray[np.float64]:
    """Return the signed volume of each cell, (m,), mm^3: positive where the corners keep VTK's order.

    The divergence theorem over the cell's faces, each quadrangle fanned about its own centre, so that two
    cells which share a face agree on it.
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
