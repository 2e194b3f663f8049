"""Quality of hexahedra, and movement of their vertices that keeps it.

`vertices` (n, 3), `cells` (m, 8) in VTK's order. The scaled Jacobian at a corner is the product det(a, b, c) of the
unit vectors along its three edges: 1 for a cube, positive at all eight corners of a cell that is not inverted.

P. M. Knupp, "Achieving finite element mesh quality via optimization of the Jacobian matrix norm and associated
quantities", IJNME 48 (2000).
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.jit import kernel

_NEIGHBOURS = np.array([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)])
"""The corners at the other ends of each corner's edges, so that det(a, b, c) is positive in a cube."""

_HALVINGS = 4
"""Halvings of a step, to a sixteenth, before it is given up; the next sweep tries again."""


@kernel
def least_jacobian(vertices: Floats, cell: Ints) -> float:
    """Return the least scaled Jacobian of one cell (8,); -1 if two corners coincide."""
    least = 1.0
    for corner in range(8):
        at, one, two, three = (
            cell[corner],
            cell[_NEIGHBOURS[corner, 0]],
            cell[_NEIGHBOURS[corner, 1]],
            cell[_NEIGHBOURS[corner, 2]],
        )
        x, y, z = vertices[at, 0], vertices[at, 1], vertices[at, 2]
        ax, ay, az = vertices[one, 0] - x, vertices[one, 1] - y, vertices[one, 2] - z
        bx, by, bz = vertices[two, 0] - x, vertices[two, 1] - y, vertices[two, 2] - z
        cx, cy, cz = vertices[three, 0] - x, vertices[three, 1] - y, vertices[three, 2] - z
        product = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        squared = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz) * (cx * cx + cy * cy + cz * cz)
        least = min(least, product / np.sqrt(squared) if squared > 0.0 else -1.0)
    return least


@kernel
def least_jacobians(vertices: Floats, cells: Ints) -> Floats:
    """Return the least scaled Jacobian of each cell, (m,)."""
    least = np.empty(len(cells))
    for cell in range(len(cells)):
        least[cell] = least_jacobian(vertices, cells[cell])
    return least


@kernel
def _least_around(vertices: Floats, cells: Ints, owners: Ints) -> float:
    least = 1.0
    for owner in owners:
        least = min(least, least_jacobian(vertices, cells[owner]))
    return least


@kernel
def sweep(
    vertices: Floats, targets: Floats, order: Ints, cells: Ints, starts: Ints, owners: Ints, floor: float
) -> None:
    """Move each vertex of `order` in turn towards its target (n, 3), in place, as far as its cells allow.

    The cells of vertex v are `owners[starts[v]:starts[v + 1]]`. A step is halved until none of them has a scaled
    Jacobian below `floor`, or below their present least one if that is smaller; after four halvings it is given up.
    """
    for vertex in order:
        own = owners[starts[vertex] : starts[vertex + 1]]
        x, y, z = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
        bound = min(floor, _least_around(vertices, cells, own))
        share = 1.0
        for _ in range(_HALVINGS + 1):
            vertices[vertex, 0] = x + share * (targets[vertex, 0] - x)
            vertices[vertex, 1] = y + share * (targets[vertex, 1] - y)
            vertices[vertex, 2] = z + share * (targets[vertex, 2] - z)
            if _least_around(vertices, cells, own) >= bound:
                break
            share /= 2.0
        else:
            vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2] = x, y, z
