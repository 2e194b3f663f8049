"""The search for triangles that cross, against exact arithmetic of others: CGAL's, through libigl, and fractions."""

from __future__ import annotations

from fractions import Fraction
from itertools import permutations, product

import numpy as np
import pytest
import trimesh

from scaffold_geometry.surfaces.exact_predicates import orient_2d, orient_3d
from scaffold_geometry.surfaces.self_intersections import degenerate_faces, self_intersecting_faces
from shapes import self_intersections_by_cgal

BALL = trimesh.creation.icosphere(4)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)
TWO = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [2, 1, 1]])


def gyroid(count: int) -> tuple[np.ndarray, np.ndarray]:
    from skimage.measure import marching_cubes

    x, y, z = np.meshgrid(*[np.linspace(0.1, 4.1 * np.pi, count)] * 3, indexing="ij")
    field = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    vertices, faces, _, _ = marching_cubes(np.pad(field, 1, constant_values=-1.0), 0.05, method="lorensen")
    return vertices.astype(np.float64), faces.astype(np.int64)


def found(vertices: np.ndarray, faces: np.ndarray) -> list[int]:
    return np.flatnonzero(self_intersecting_faces(vertices, faces)).tolist()


def exact_volume(points: np.ndarray) -> Fraction:
    a, b, c, d = ([Fraction(value) for value in point] for point in points.tolist())
    p, q, r = ([x - y for x, y in zip(corner, d, strict=True)] for corner in (a, b, c))
    return p[0] * (q[1] * r[2] - q[2] * r[1]) - p[1] * (q[0] * r[2] - q[2] * r[0]) + p[2] * (q[0] * r[1] - q[1] * r[0])


@pytest.mark.parametrize(("vertices", "faces"), [(VERTICES, FACES), gyroid(40)], ids=["ball", "gyroid"])
@pytest.mark.parametrize("offset", [0.0, 20_000.0])
def test_a_clean_surface_has_none(vertices: np.ndarray, faces: np.ndarray, offset: float):
    assert found(vertices + offset, faces) == []


def test_one_planted_intersection_is_found():
    vertices, faces = gyroid(40)
    corners = vertices[faces[len(faces) // 2]]
    centre = corners.mean(axis=0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    needle = centre + 0.01 * np.array([normal, -normal, corners[0] - centre])
    with_needle = np.concatenate([vertices, needle]), np.concatenate([faces, [len(vertices) + np.arange(3)]])

    assert found(*with_needle) == [len(faces) // 2, len(faces)]


def test_a_vertex_pushed_through_the_far_side_is_found_as_cgal_finds_it():
    vertices = VERTICES.copy()
    vertices[200] *= -1.01

    assert found(vertices, FACES) == self_intersections_by_cgal(vertices, FACES) != []


@pytest.mark.parametrize(
    ("apex", "crosses"),
    [
        ([1.0, 1.0, 1.0], True),  # through the middle
        ([1.0, 1.0, 0.0], True),  # a corner upon the face
        ([1.0, 1.0, -1e-15], False),  # just short of it
    ],
)
def test_touching_counts_and_nearness_does_not(apex: list[float], crosses: bool):  # noqa: FBT001
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [2, 1, -1], apex])

    assert found(vertices, np.array([[0, 1, 2], [3, 4, 5]])) == ([0, 1] if crosses else [])


@pytest.mark.parametrize(
    ("faces", "corners", "crosses"),
    [
        ([[0, 1, 2], [1, 0, 3]], [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, -1, 0]], False),  # neighbours, unfolded
        ([[0, 1, 2], [1, 0, 3]], [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 2, 0]], True),  # folded upon each other
        ([[0, 1, 2], [1, 0, 3]], [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 2, 1e-9]], False),  # nearly so
        ([[0, 1, 2], [0, 3, 4]], [[0, 0, 0], [2, 0, 0], [0, 2, 0], [-1, 0, 0], [0, -1, 0]], False),  # a vertex
        ([[0, 1, 2], [0, 3, 4]], [[0, 0, 0], [2, 0, 0], [0, 2, 0], [3, 1, 0], [1, 3, 0]], True),  # and an area
        ([[0, 1, 2], [0, 3, 4]], [[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 1, 0], [1, 1, 1]], True),  # and a line
        ([[0, 1, 2], [0, 3, 4]], [[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 1, -1], [1, 1, 1]], True),  # and through
        ([[0, 1, 2], [3, 4, 5]], [[0, 0, 0], [9, 0, 0], [0, 9, 0], [1, 1, 0], [2, 1, 0], [1, 2, 0]], True),  # within
        ([[0, 1, 2], [3, 4, 5]], [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [2, 1, 0]], False),  # beside
    ],
)
def test_neighbours_may_have_in_common_what_they_share(faces: list, corners: list, crosses: bool):  # noqa: FBT001
    vertices = np.array(corners, np.float64)

    for first, second in product(permutations(faces[0]), permutations(faces[1])):
        assert found(vertices, np.array([first, second])) == ([0, 1] if crosses else [])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("span", [4, 7, 1000])
def test_random_triangles_are_judged_as_by_cgal(seed: int, span: int):
    rng = np.random.default_rng(seed)
    vertices = np.unique(rng.integers(0, span, (60, 3)).astype(np.float64), axis=0)
    corners = np.sort(rng.integers(0, len(vertices), (150, 3)), axis=1)
    faces = np.unique(corners[(np.diff(corners, axis=1) > 0).all(axis=1)], axis=0)[:: 1 if span > 10 else 3]
    faces = faces[~degenerate_faces(vertices, faces)]

    assert found(vertices, faces) == self_intersections_by_cgal(vertices, faces)


@pytest.mark.parametrize("seed", range(4))
def test_signs_are_exact_where_rounding_would_decide(seed: int):
    rng = np.random.default_rng(seed)
    base = rng.integers(-(2**52), 2**52, (3, 3)).astype(np.float64)
    weights = rng.integers(0, 4, (200, 3))
    for weight in weights:
        nearly = base[0] + np.rint((weight[:, None] * (base - base[0])).sum(axis=0) / 8.0)
        points = np.ascontiguousarray(np.concatenate([base, [nearly + rng.integers(-1, 2, 3)]]))
        exact = exact_volume(points)
        flat = (points[:3, :2] - points[3, :2]).tolist()
        area = Fraction(flat[0][0]) * Fraction(flat[1][1]) - Fraction(flat[0][1]) * Fraction(flat[1][0])

        assert orient_3d(points, 0, 1, 2, 3) == (exact > 0) - (exact < 0)
        assert orient_2d(points, 0, 1, 3, 2) == (area > 0) - (area < 0)


@pytest.mark.parametrize("seed", range(4))
def test_signs_are_exact_of_coordinates_of_any_size(seed: int):
    rng = np.random.default_rng(seed)
    for _ in range(200):
        points = rng.uniform(-1.0, 1.0, (4, 3)) * 2.0 ** rng.integers(-190, 1, (4, 3)) * rng.integers(0, 2, (4, 3))
        points[3] = points[:3].sum(axis=0) / 4.0  # in their plane with the origin, but for rounding
        exact = exact_volume(points)
        flat = [[Fraction(value) for value in row] for row in points[:, :2].tolist()]
        p, q = ([x - y for x, y in zip(row, flat[2], strict=True)] for row in flat[:2])
        area = p[0] * q[1] - p[1] * q[0]

        assert orient_3d(points, 0, 1, 2, 3) == (exact > 0) - (exact < 0)
        assert orient_2d(points, 0, 1, 2, 2) == (area > 0) - (area < 0)


def test_a_gap_far_finer_than_the_greatest_coordinate_is_no_touch():
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [2, 1, -1], [1, 1, -1e-30]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])

    assert found(vertices, faces) == self_intersections_by_cgal(vertices, faces) == []
    vertices[5, 2] = 1e-30
    assert found(vertices, faces) == self_intersections_by_cgal(vertices, faces) == [0, 1]


def test_a_face_that_is_there_twice_lies_upon_itself():
    twice = np.concatenate([FACES, FACES[:1]])

    assert found(VERTICES, twice) == [0, len(FACES)]
    assert self_intersections_by_cgal(VERTICES, twice) == []  # which is why it is not asked


def test_faces_without_area_are_told_apart():
    vertices = np.array([[0.0, 0, 0], [1, 1, 1], [3, 3, 3], [3, 3, 3 + 1e-14]])

    assert degenerate_faces(vertices, np.array([[0, 1, 2], [0, 1, 3]])).tolist() == [True, False]


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_faces_cross_nothing(count: int):
    assert found(TWO, np.arange(3 * count).reshape(-1, 3)) == []


def test_all_faces_at_one_place_are_compared():
    copies = np.concatenate([TWO[:3] + np.array([0.0, 0.0, 1e-9 * k]) for k in range(50)] + [TWO[3:] * [1, 1, 0.5]])

    assert found(copies, np.arange(len(copies)).reshape(-1, 3)) == list(range(51))
