"""Which cubes a surface meets, by a search of points in them, and sets of cubes that can be coated."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from scaffold_geometry.surfaces import triangles
from scaffold_geometry.volumes import lattices
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_geometry.volumes.cells import faces
from scaffold_geometry.volumes.hexahedra import cube_sets
from scaffold_geometry.volumes.hexahedra.overlaps import find_overlapping_cubes
from shapes import ball, box

ORIGIN = np.zeros(3)


def test_the_cubes_that_meet_a_ball_are_those_nearer_than_its_radius():
    centre, radius = np.array([4.1, 3.9, 4.05]), 2.7
    vertices, triangles_ = ball(radius, tuple(centre), divisions=5)
    met = find_overlapping_cubes(vertices, triangles_, ORIGIN, 1.0, (8, 8, 8))
    low = np.moveaxis(np.indices((8, 8, 8)), 0, -1)
    distance = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - low - 1.0), 0.0), axis=-1)
    sag = 0.01  # its triangles lie a little within the sphere
    assert met[distance < radius - sag].all()
    assert not met[distance > radius].any()
    assert 100 < met.sum() < 400


def test_a_body_in_a_single_cube_meets_that_alone():
    for size in (0.2, 0.9):
        met = find_overlapping_cubes(
            *box((1.05, 2.05, 0.05), (1.05 + size, 2.05 + size, 0.05 + size)), ORIGIN, 1.0, (3, 3, 3)
        )
        assert np.argwhere(met).tolist() == [[1, 2, 0]]


@pytest.mark.parametrize("size", [0.1, 1.0 / 3.0, 0.7])
def test_a_body_whose_sides_lie_in_those_of_cubes_meets_none_beyond(size: float):
    low, high = size * np.array([1, 2, 1]), size * np.array([4, 4, 6])
    met = find_overlapping_cubes(*box(tuple(low), tuple(high)), ORIGIN, size, (6, 6, 7))
    expected = np.zeros_like(met)
    expected[1:4, 2:4, 1:6] = True
    np.testing.assert_array_equal(met, expected)


def test_a_plate_thinner_than_a_cube_meets_all_along_it():
    met = find_overlapping_cubes(*box((0.5, 0.5, 1.2), (5.5, 4.5, 1.25)), ORIGIN, 1.0, (6, 5, 3))
    assert met[:, :, 1].all()
    assert met.sum() == 30


def test_large_triangles_are_looked_at_in_parts(monkeypatch: pytest.MonkeyPatch):
    surface = ball(3.0, (4.0, 4.0, 4.0), divisions=2)
    whole = find_overlapping_cubes(*surface, ORIGIN, 0.5, (16, 16, 16))
    monkeypatch.setattr("scaffold_geometry.volumes.hexahedra.overlaps._MOST_PAIRS", 50)
    np.testing.assert_array_equal(find_overlapping_cubes(*surface, ORIGIN, 0.5, (16, 16, 16)), whole)


def mask_of(places: list[tuple[int, ...]], counts: tuple[int, int, int] = (2, 2, 2)):
    cubes = np.zeros(counts, bool)
    cubes[tuple(np.transpose(places))] = True
    return cubes


@pytest.mark.parametrize(
    ("places", "is_bad"),
    [
        ([(0, 0, 0)], False),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], False),
        ([(0, 0, 0), (1, 1, 0)], True),  # they touch at an edge
        ([(0, 0, 0), (1, 1, 1)], True),  # at a corner
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)], True),  # a manifold, but without a way out
    ],
)
def test_cubes_about_a_corner_have_a_way_out_or_none(places: list[tuple[int, ...]], is_bad: bool):  # noqa: FBT001
    ways, bad = cube_sets.outward_directions(mask_of(places))
    assert bad[1, 1, 1] == is_bad
    if not is_bad:  # the way leads out of every face at the corner
        np.testing.assert_array_equal(ways[1, 1, 1], [1, 1, 1])


def test_among_all_sets_of_eight_cubes_those_with_a_way_out_are_manifold():
    number = 0
    for taken in product((False, True), repeat=8):
        cubes = np.array(taken).reshape(2, 2, 2)
        if not cubes.any() or cube_sets.outward_directions(cubes)[1].any():
            continue
        number += 1
        assert_manifold(cubes)
    assert number > 50


def assert_manifold(cubes: np.ndarray):
    lattice, cells = lattices.on_lattice(np.argwhere(cubes), lattices.HEXAHEDRON)
    surface, _ = boundary_triangles(lattice.astype(float), faces({"hexahedron": cells}))
    assert not any(triangles.edge_faults(surface))
    assert triangles.touching_vertices(surface) == 0


@pytest.mark.parametrize("shallowest", [-np.inf, 0.3, np.inf])
def test_mending_makes_any_set_a_manifold(shallowest: float):
    rng = np.random.default_rng(5)
    depths = rng.uniform(0.0, 1.0, (7, 8, 9))
    cubes = depths > 0.4
    assert cube_sets.outward_directions(cubes)[1].any()
    mended = cube_sets.make_core_manifold(cubes, depths, shallowest)
    assert not cube_sets.outward_directions(mended)[1].any()
    if mended.any():
        assert_manifold(mended)
    assert not (mended & ~cubes)[depths < shallowest].any()


def test_mending_adds_the_deepest_cubes_and_keeps_mirrored_sets_mirrored():
    depths = np.random.default_rng(6).uniform(0.0, 1.0, (6, 6, 4))
    depths = np.concatenate([depths, depths[::-1]])
    mended = cube_sets.make_core_manifold(depths > 0.35, depths, 0.2)
    np.testing.assert_array_equal(mended, mended[::-1])

    crossed = mask_of([(0, 0, 0), (1, 1, 0)], (2, 2, 1))
    depths = np.array([0.9, 0.3, 0.2, 0.8]).reshape(2, 2, 1)
    np.testing.assert_array_equal(
        cube_sets.make_core_manifold(crossed, depths, 0.25).ravel(), [True, True, False, True]
    )
    np.testing.assert_array_equal(
        cube_sets.make_core_manifold(crossed, depths, 0.5).ravel(), [True, False, False, False]
    )
