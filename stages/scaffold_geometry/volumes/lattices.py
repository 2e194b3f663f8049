"""Cells on a lattice of cubes with whole-number corners: the cube of cell (i, j, k) extends to (i+1, j+1, k+1).

A mesh is its lattice points (n, 3), in lexicographic order, and its cells (m, corners) in VTK's order.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from scaffold_geometry.arrays import Ints
from scaffold_pipeline.artifacts.cells import distinct_rows

HEXAHEDRON: Ints = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
"""The corners of a cube in VTK's order, (8, 3)."""


def _six_tetrahedra() -> Ints:
    """Return the paths along the edges of a cube from one corner to the opposite one, (6, 4, 3), in VTK's order."""
    steps = np.eye(3, dtype=np.int64)
    ways = [np.cumsum([np.zeros(3, np.int64), *steps[list(order)]], axis=0) for order in permutations(range(3))]
    return np.array([way if np.linalg.det(way[1:]) > 0.0 else way[[0, 2, 1, 3]] for way in ways])


TETRAHEDRA = _six_tetrahedra()
"""Kuhn's six tetrahedra of a cube, (6, 4, 3): the same in every cube, so that neighbours share triangles.

H. W. Kuhn, "Some combinatorial lemmas in topology", IBM Journal of Research and Development 4 (1960) 518-524.
"""


def block(counts: tuple[int, int, int]) -> Ints:
    """Return all cells of a block, (m, 3)."""
    return np.indices(counts).reshape(3, -1).T


def on_lattice(cells: Ints, corners: Ints) -> tuple[Ints, Ints]:
    """Return the mesh with `corners`, `HEXAHEDRON` or `TETRAHEDRA`, in each cube of `cells` (m, 3)."""
    places = (cells[:, None] + corners.reshape(-1, 3)).reshape(-1, 3)
    lattice, indices = distinct_rows(places)
    return lattice, indices.reshape(-1, corners.shape[-2])
