"""Regular polyhedra centred at the origin."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles


def icosahedron() -> tuple[Floats, Ints]:
    """Return its 12 vertices, cyclic permutations of (0, +-1, +-golden ratio), and 20 outward faces."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    turns = [np.roll([0.0, one, two], turn) for turn in range(3) for one in (-1, 1) for two in (-golden, golden)]
    vertices = np.array(turns)
    triples = np.array(list(combinations(range(12), 3)))
    sides = vertices[triples] - np.roll(vertices[triples], 1, axis=1)
    faces = triples[np.isclose(np.linalg.norm(sides, axis=2), 2.0).all(axis=1)]
    inward = np.linalg.det(vertices[faces]) < 0.0
    return vertices, triangles.turn_faces(faces, inward)
