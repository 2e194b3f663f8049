from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from scaffold_pipeline.cell_types import CELL_TYPES, cell_volumes

PLACES = {
    "tetrahedron": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "pyramid": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]],
    "wedge": [[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1]],
    "hexahedron": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
}
VOLUMES = {"tetrahedron": 1 / 6, "pyramid": 1 / 3, "wedge": 1 / 2, "hexahedron": 1.0}
each_kind = pytest.mark.parametrize("kind", CELL_TYPES)


def ring(face: tuple[int, ...]) -> list[tuple[int, int]]:
    return [*pairwise(face), (face[-1], face[0])]


@each_kind
def test_faces_close_each_edge_is_walked_once_each_way(kind: str):
    walked = Counter(edge for face in CELL_TYPES[kind].faces for edge in ring(face))
    assert set(walked.values()) == {1}
    assert all((b, a) in walked for a, b in walked)


@each_kind
def test_edges_are_those_of_the_faces_and_euler_holds(kind: str):
    cell = CELL_TYPES[kind]
    of_faces = {tuple(sorted(edge)) for face in cell.faces for edge in ring(face)}
    assert sorted(of_faces) == sorted(tuple(sorted(edge)) for edge in cell.edges)
    assert cell.corners - len(cell.edges) + len(cell.faces) == 2


@each_kind
def test_the_reference_cell_has_its_volume_and_faces_that_point_outwards(kind: str):
    vertices = np.array(PLACES[kind], float)
    corners = np.arange(len(vertices))[None]
    assert cell_volumes(vertices, corners, kind)[0] == pytest.approx(VOLUMES[kind])
    for face in CELL_TYPES[kind].faces:
        a, b, c = vertices[list(face[:3])]
        assert np.dot(np.cross(b - a, c - a), vertices[list(face)].mean(axis=0) - vertices.mean(axis=0)) > 0.0


@each_kind
def test_a_volume_scales_stays_under_motion_and_turns_sign_in_a_mirror(kind: str):
    vertices = np.array(PLACES[kind], float)
    corners = np.arange(len(vertices))[None]
    turned = vertices[:, [1, 2, 0]] * 2.0 + [100.0, -20.0, 3.0]
    assert cell_volumes(turned, corners, kind)[0] == pytest.approx(8.0 * VOLUMES[kind])
    assert cell_volumes(vertices * [-1.0, 1.0, 1.0], corners, kind)[0] == pytest.approx(-VOLUMES[kind])


def test_two_cells_with_a_twisted_face_between_them_fill_their_hull_together():
    generator = np.random.default_rng(0)
    low, high = np.array(PLACES["hexahedron"], float), np.array(PLACES["hexahedron"], float) + np.array([0, 0, 1])
    shared = low[4:] + generator.uniform(-0.2, 0.2, (4, 3))
    vertices = np.vstack([low[:4], shared, high[4:]])
    volumes = cell_volumes(vertices, np.array([[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]]), "hexahedron")
    sides = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    faces = [*sides, *(np.array(sides) + 4).tolist(), [0, 3, 2, 1], [8, 9, 10, 11]]
    hull = 0.0
    for face in faces:
        corners = vertices[face]
        for a, b in ring((0, 1, 2, 3)):
            hull += np.dot(corners.mean(axis=0), np.cross(corners[a], corners[b])) / 6.0
    assert volumes.sum() == pytest.approx(hull)
    assert volumes[0] != pytest.approx(1.0)
