from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from scaffold_pipeline.artifacts.cells import (
    CELL_TYPES,
    _is_walked_upwards,
    cell_areas,
    cell_measures,
    cell_volumes,
    distinct_rows,
    mesh_faults,
)

PLACES = {
    "tetrahedron": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "pyramid": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]],
    "wedge": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]],
    "hexahedron": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
}
VOLUMES = {"tetrahedron": 1 / 6, "pyramid": 1 / 3, "wedge": 1 / 2, "hexahedron": 1.0}
TILES = {
    "triangle": [[0, 0, 5], [3, 0, 5], [0, 2, 5]],
    "quadrangle": [[0, 0, 5], [3, 0, 5], [4, 2, 5], [0, 2, 5]],
}
AREAS = {"triangle": 3.0, "quadrangle": 7.0}
each_kind = pytest.mark.parametrize("kind", VOLUMES)
each_tile = pytest.mark.parametrize("kind", AREAS)


def ring(face: tuple[int, ...]) -> list[tuple[int, int]]:
    return [*pairwise(face), (face[-1], face[0])]


def test_every_kind_is_solid_or_planar_and_has_a_field_of_its_own():
    assert {name for name, kind in CELL_TYPES.items() if not kind.is_planar} == set(VOLUMES)
    assert {name for name, kind in CELL_TYPES.items() if kind.is_planar} == set(AREAS)
    assert len({kind.plural for kind in CELL_TYPES.values()}) == len(CELL_TYPES)


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


@each_tile
def test_the_faces_of_a_tile_are_its_edges_walked_with_the_tile_on_the_left(kind: str):
    tile, places = CELL_TYPES[kind], np.array(TILES[kind], float)
    assert tile.faces == tile.edges == tuple(ring(tuple(range(tile.corners))))
    for a, b in tile.faces:
        assert np.cross(places[b] - places[a], places.mean(axis=0) - places[a])[2] > 0.0


@each_tile
def test_an_area_scales_stays_under_motion_and_turns_sign_in_a_mirror(kind: str):
    vertices, corners = np.array(TILES[kind], float), np.arange(len(TILES[kind]))[None]
    assert cell_areas(vertices, corners)[0] == cell_measures(vertices, corners, kind)[0] == AREAS[kind]
    turned = vertices[:, [1, 0, 2]] * [-2.0, 2.0, 1.0] + [1e6, -2e6, 3.0]
    assert cell_areas(turned, corners)[0] == pytest.approx(4.0 * AREAS[kind])
    assert cell_areas(vertices * [-1.0, 1.0, 1.0], corners)[0] == -AREAS[kind]


@each_kind
def test_the_measure_of_a_solid_cell_is_its_volume(kind: str):
    vertices = np.array(PLACES[kind], float)
    assert cell_measures(vertices, np.arange(len(vertices))[None], kind)[0] == pytest.approx(VOLUMES[kind])


@pytest.mark.parametrize("face", [(7, 3), (3, 7), (4, 9, 2), (9, 4, 2), (5, 1, 8, 3), (8, 1, 5, 3), (1, 3, 8, 5)])
def test_the_way_in_which_a_face_is_walked_does_not_depend_on_where_the_walk_starts(face: tuple[int, ...]):
    def way(walk: tuple[int, ...]) -> bool:
        return bool(_is_walked_upwards(np.array([[*walk, *[-1] * (4 - len(walk))]]))[0])

    turned = [face[i:] + face[:i] for i in range(len(face))]
    if len(face) == 2:
        assert [way(walk) for walk in turned] == [face[0] < face[1], face[0] > face[1]]
    else:
        assert {way(walk) for walk in turned} == {way(face)}
        assert {way(walk[::-1]) for walk in turned} == {not way(face)}


@pytest.mark.parametrize("kind", CELL_TYPES)
def test_a_cell_given_twice_lies_twice_on_one_side_of_its_faces(kind: str):
    vertices = np.array({**PLACES, **TILES}[kind], float)
    once = np.arange(len(vertices))[None]
    assert list(mesh_faults(vertices, {kind: once})) == []
    (fault,) = mesh_faults(vertices, {kind: np.repeat(once, 2, axis=0)})
    count, first = len(CELL_TYPES[kind].faces), ", ".join(map(str, CELL_TYPES[kind].faces[0]))
    assert f"at most, but {count} have more (the first is that of vertices {first})" in fault


def test_cells_on_the_same_side_of_a_face_are_found_and_those_on_either_side_are_not():
    vertices = np.array([*PLACES["tetrahedron"], [0.2, 0.2, 2.0], [0.2, 0.2, -1.0]], float)
    above, higher, below = [0, 1, 2, 3], [0, 1, 2, 4], [0, 2, 1, 5]
    assert list(mesh_faults(vertices[[0, 1, 2, 3, 5]], {"tetrahedron": np.array([above, [0, 2, 1, 4]])})) == []
    (fault,) = mesh_faults(vertices, {"tetrahedron": np.array([above, higher, below])})
    assert "but 1 have more (the first is that of vertices 0, 2, 1); remove duplicate or overlapping cells" in fault


def test_rows_too_wide_for_one_integer_are_still_grouped():
    few = np.random.default_rng(7).integers(-1, 2**40, size=(50, 4))
    rows = few[np.random.default_rng(8).integers(0, 50, 400)]
    unique, groups = distinct_rows(rows)
    expected, inverse = np.unique(rows, axis=0, return_inverse=True)
    np.testing.assert_array_equal(unique, expected)
    np.testing.assert_array_equal(groups, inverse)
