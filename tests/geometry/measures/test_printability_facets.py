"""Passes over triangles against the same in plain numpy."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability import facets
from scaffold_geometry.surfaces import triangles

UP = np.array([0.0, 0.0, 1.0])
VERTICES, FACES = shapes.ball(2.0, (3.0, -1.0, 40.0), divisions=2)
RUGGED = VERTICES + np.random.default_rng(5).normal(0.0, 0.1, VERTICES.shape)


def test_areas_and_cosines_are_those_of_the_normals():
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    areas, cosines = facets.facing(RUGGED, FACES, direction)
    a, b, c = np.moveaxis(RUGGED[FACES], 1, 0)
    normals = np.cross(b - a, c - a)
    assert areas == pytest.approx(triangles.face_areas(RUGGED, FACES))
    assert cosines == pytest.approx(normals @ direction / np.linalg.norm(normals, axis=1))


def test_face_without_area_faces_nowhere():
    areas, cosines = facets.facing(np.eye(3), np.array([(0, 1, 1)]), UP)
    assert (areas[0], cosines[0]) == (0.0, 0.0)


def test_shells_have_their_signed_volumes_and_centroids():
    surface = shapes.together((RUGGED, FACES), shapes.inverted(shapes.box((0.0, 2.0, 4.0), (1.0, 4.0, 7.0))))
    shells = triangles.face_pieces(surface[1])
    volumes, centres = facets.shell_sums(*surface, shells, 2)
    assert volumes == pytest.approx(triangles.piece_volumes(*surface, shells))
    assert volumes[1] == pytest.approx(-6.0)
    assert centres[1] == pytest.approx([0.5, 3.0, 5.5])


def test_faces_that_share_a_vertex_are_joined_however_far_apart_in_the_file():
    faces = np.array([(5, 6, 7), (0, 1, 2), (8, 9, 3), (2, 3, 4)])
    assert facets.label_connected_faces(faces, 10).tolist() == [0, 1, 1, 1]
    ball = shapes.together((VERTICES, FACES), (VERTICES, FACES))
    mixed = ball[1][np.random.default_rng(1).permutation(len(ball[1]))]
    parts = facets.label_connected_faces(mixed, len(ball[0]))
    assert parts[0] == 0
    assert np.array_equal(parts, ((mixed[:, 0] >= len(VERTICES)) != (mixed[0, 0] >= len(VERTICES))).astype(int))


def test_faces_near_a_place_are_those_whose_boxes_come_near():
    places = np.array([(3.0, -1.0, 42.0), (5.0, -1.0, 40.0)])
    corners = RUGGED[FACES]
    low, high = corners.min(axis=1), corners.max(axis=1)
    meets = (low[:, None] <= places + 0.3).all(axis=2) & (high[:, None] >= places - 0.3).all(axis=2)
    near = facets.faces_near(RUGGED, FACES, places, 0.3)
    assert np.array_equal(near, meets.any(axis=1))
    assert 0 < near.sum() < len(near)


@pytest.mark.parametrize("turned", [False, True])
def test_cone_about_the_lowest_vertex_is_measured_and_signed(turned):
    """A corner of a cube bounds an eighth of all directions; seen from within a pore it is as much of the pore."""
    cube = shapes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    vertices, faces = shapes.inverted(cube) if turned else cube
    asked = np.zeros(8, bool)
    asked[0] = True
    angles = facets.cone_angles(vertices, faces, np.ones(3) / np.sqrt(3.0), asked)
    assert angles == pytest.approx([np.pi / 2.0 if turned else -np.pi / 2.0, *[0.0] * 7])


def test_wedge_below_a_face_that_looks_up_still_starts_at_its_edge():
    vertices, faces = shapes.prism([(0.0, 0.0), (5.0, 0.0), (5.0, 0.5)], 2.0)
    assert facets.cone_angles(vertices, faces, UP, np.arange(6) == 0)[0] == pytest.approx(-np.arctan(0.1))
