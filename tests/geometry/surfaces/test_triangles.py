"""Laws of the triangle formulas, on meshes small enough to check by eye."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from scaffold_geometry.surfaces import triangles

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def moebius_strip(count: int = 6):
    """A strip of `count` quadrangles whose ends meet the wrong way round."""
    pairs = [(2 * k, 2 * k + 1) for k in range(count)] + [(1, 0)]
    ends = list(pairwise(pairs))
    return np.array([face for (a, b), (c, d) in ends for face in ((a, b, c), (b, d, c))])


def test_vertices_at_one_place_become_one_in_the_order_of_first_use():
    vertices = np.array([[1.0, 0, 0], [0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [-0.0, 0, 0]])
    merged, faces = triangles.merge_coincident(vertices, np.array([[0, 1, 3], [2, 4, 3]]))
    assert merged.tolist() == [[1, 0, 0], [0, 0, 0], [0, 1, 0]]
    assert faces.tolist() == [[0, 1, 2], [0, 1, 2]]


def test_vertices_a_hair_apart_stay_two():
    vertices = np.array([[1.0, 0, 0], [np.nextafter(1.0, 2.0), 0, 0]])
    assert len(triangles.merge_coincident(vertices, np.empty((0, 3), np.int64))[0]) == 2


def test_unreferenced_vertices_go_and_the_faces_keep_their_places():
    vertices = np.arange(15.0).reshape(5, 3)
    kept, faces = triangles.drop_unreferenced(vertices, np.array([[4, 0, 2]]))
    assert kept[faces].tolist() == vertices[[[4, 0, 2]]].tolist()
    assert len(kept) == 3


def test_collapsed_flat_and_repeated_faces_are_told_apart():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.25, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 3], [3, 0, 1], [0, 3, 1], [0, 0, 1], [0, 2, 1]])
    assert triangles.duplicate_vertex_faces(faces).tolist() == [False, False, False, True, False]
    assert triangles.flat_faces(vertices, faces).tolist() == [False, False, False, True, True]
    assert triangles.duplicate_faces(faces).tolist() == [False, True, True, False, False]


def test_a_thin_triangle_is_not_flat():
    vertices = np.array([[0.0, 0, 0], [100, 0, 0], [50, 1e-6, 0]])
    assert not triangles.flat_faces(vertices, np.array([[0, 1, 2]])).any()


def test_a_tetrahedron_has_no_edge_faults():
    assert triangles.edge_faults(TETRAHEDRON) == (0, 0, 0)


def test_edge_faults_are_counted():
    assert triangles.edge_faults(TETRAHEDRON[1:]) == (3, 0, 0)
    assert triangles.edge_faults(np.vstack([TETRAHEDRON, [[0, 1, 4]]])) == (2, 1, 0)
    one_turned = TETRAHEDRON.copy()
    one_turned[2] = one_turned[2, ::-1]
    assert triangles.edge_faults(one_turned) == (0, 0, 3)


def test_pieces_hang_together_by_edges_not_by_a_vertex():
    touching = np.vstack([TETRAHEDRON, TETRAHEDRON + 3])
    assert triangles.face_pieces(touching).tolist() == [0] * 4 + [1] * 4
    assert triangles.touching_vertices(touching) == 1
    assert triangles.touching_vertices(TETRAHEDRON) == 0


def test_fans_do_not_depend_on_the_winding():
    mixed = TETRAHEDRON.copy()
    mixed[1] = mixed[1, ::-1]
    assert triangles.touching_vertices(mixed) == 0


@pytest.mark.parametrize("seed", range(5))
def test_any_mixture_of_windings_is_made_consistent(seed: int):
    mixture = np.random.default_rng(seed).random(8) < 0.5
    faces = triangles.turn_faces(np.vstack([TETRAHEDRON, TETRAHEDRON + 4]), mixture)
    winding = triangles.consistent_winding(faces)
    assert winding.orientable
    assert triangles.edge_faults(triangles.turn_faces(faces, winding.turn)) == (0, 0, 0)


def test_the_few_are_turned_not_the_many():
    faces = triangles.turn_faces(TETRAHEDRON, np.array([False, True, False, False]))
    assert triangles.consistent_winding(faces).turn.tolist() == [False, True, False, False]
    assert not triangles.consistent_winding(TETRAHEDRON).turn.any()


def test_a_moebius_strip_cannot_be_oriented():
    assert not triangles.consistent_winding(moebius_strip()).orientable


def test_volume_is_signed_additive_and_indifferent_to_place():
    vertices = np.vstack([CORNERS, 2.0 * CORNERS]) + 1e6
    faces = np.vstack([TETRAHEDRON, (TETRAHEDRON + 4)[:, ::-1]])
    volumes = triangles.piece_volumes(vertices, faces, triangles.face_pieces(faces))
    np.testing.assert_allclose(volumes, [1 / 6, -8 / 6], rtol=1e-8)


def test_the_winding_number_is_one_inside_nought_outside_and_turns_with_the_faces():
    inside, outside = np.array([0.1, 0.1, 0.1]), np.array([0.4, 0.4, 0.4])
    assert triangles.winding_number(inside, CORNERS, TETRAHEDRON) == pytest.approx(1.0)
    assert triangles.winding_number(outside, CORNERS, TETRAHEDRON) == pytest.approx(0.0, abs=1e-12)
    assert triangles.winding_number(inside, CORNERS, TETRAHEDRON[:, ::-1]) == pytest.approx(-1.0)


def test_the_euler_characteristic_counts_used_vertices_only():
    assert triangles.euler_characteristic(TETRAHEDRON + 7) == 2
    assert triangles.euler_characteristic(moebius_strip()) == 0


def test_areas_are_those_of_the_faces():
    np.testing.assert_allclose(triangles.face_areas(CORNERS, TETRAHEDRON), [0.5, 0.5, np.sqrt(3) / 2, 0.5])
