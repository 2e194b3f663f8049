"""Grids cover a shape evenly, and their samples know inside from outside on every axis."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.voxels.grids import dilate, grid_over, samples_inside
from shapes import ball, box

LOW, HIGH = (1.0, -2.0, 10.0), (4.0, 3.0, 18.0)


def places(origin: np.ndarray, spacing: float, shape: tuple[int, int, int]):
    return origin + spacing * np.moveaxis(np.indices(shape), 0, -1)


def bounds_of(vertices: np.ndarray):
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


@pytest.mark.parametrize("spacing", [0.3, 0.5, 1.0, 7.0])
def test_a_grid_is_centred_on_its_bounds_and_covers_them_with_the_margin(spacing: float):
    bounds = np.array([LOW, HIGH])
    origin, shape = grid_over(bounds, spacing, 2)
    last = origin + spacing * (np.array(shape) - 1)
    assert (origin + last) / 2.0 == pytest.approx(bounds.mean(axis=0), abs=1e-12)
    assert (origin <= bounds[0] - 2 * spacing + 1e-6).all()
    assert (origin > bounds[0] - 3 * spacing).all()
    assert (last >= bounds[1] + 2 * spacing - 1e-6).all()


def test_a_length_that_divides_evenly_gets_no_sample_more_for_rounding():
    _, shape = grid_over(np.array([[0.0, 0.0, 0.0], [0.3, 0.6, 0.9]]), 0.1, 0)
    assert shape == (4, 7, 10)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (20_000.0, -20_000.0, 5_000.0)], ids=["here", "20 m away"])
def test_samples_of_a_box_lie_inside_by_its_own_bounds_on_each_axis(offset: tuple[float, float, float]):
    vertices, faces = box(LOW, HIGH)
    vertices = vertices + offset
    origin, shape = grid_over(bounds_of(vertices), 0.37, 3)
    inside = samples_inside(vertices, faces, origin, 0.37, shape)
    where = places(origin, 0.37, shape)
    expected = ((where > vertices.min(axis=0)) & (where < vertices.max(axis=0))).all(axis=-1)
    assert inside.shape == shape
    assert (inside == expected).all()
    assert expected.any(axis=(1, 2)).sum() != expected.any(axis=(0, 1)).sum()  # mixed-up axes would show


def test_samples_of_a_ball_lie_inside_by_their_distance():
    vertices, faces = ball(5.0, (3.0, -7.0, 11.0), 5)
    origin, shape = grid_over(bounds_of(vertices), 0.3, 2)
    inside = samples_inside(vertices, faces, origin, 0.3, shape)
    depth = 5.0 - np.linalg.norm(places(origin, 0.3, shape) - [3.0, -7.0, 11.0], axis=-1)
    clear = np.abs(depth) > 0.01  # the facets' sagitta
    assert clear.mean() > 0.99
    assert (inside == (depth > 0.0))[clear].all()


def test_a_shell_around_a_hole_has_no_samples_inside_the_hole():
    outside, hole = ball(5.0, divisions=3), ball(3.0, divisions=3)
    vertices = np.concatenate([outside[0], hole[0]])
    faces = np.concatenate([outside[1], hole[1][:, ::-1] + len(outside[0])])
    origin, shape = grid_over(bounds_of(vertices), 0.5, 1)
    inside = samples_inside(vertices, faces, origin, 0.5, shape)
    radius = np.linalg.norm(places(origin, 0.5, shape), axis=-1)
    assert not inside[radius < 2.8].any()
    assert inside[(radius > 3.1) & (radius < 4.7)].all()


def test_samples_exactly_on_the_surface_leave_those_within_and_without_alone():
    vertices, faces = box((0.0, 0.0, 0.0), (2.0, 3.0, 4.0))
    origin, shape = grid_over(bounds_of(vertices), 0.5, 2)
    inside = samples_inside(vertices, faces, origin, 0.5, shape)
    where = places(origin, 0.5, shape)
    assert inside[((where > 0.1) & (where < [1.9, 2.9, 3.9])).all(axis=-1)].all()
    assert not inside[((where < -0.1) | (where > [2.1, 3.1, 4.1])).any(axis=-1)].any()


def test_samples_on_the_surface_belong_to_the_body_above_them_on_each_axis():
    vertices, faces = box((0.0, 0.0, 0.0), (2.0, 3.0, 4.0))
    origin, shape = np.full(3, -1.0), (8, 10, 12)
    where = places(origin, 0.5, shape)
    expected = ((where >= 0.0) & (where < [2.0, 3.0, 4.0])).all(axis=-1)
    assert (samples_inside(vertices, faces, origin, 0.5, shape) == expected).all()


def test_growth_reaches_diagonal_neighbours_and_stops_at_the_edge():
    inside = np.zeros((6, 7, 8), bool)
    inside[0, 3, 4] = True
    for steps in (1, 2):
        i, j, k = np.indices(inside.shape)
        expected = (i <= steps) & (abs(j - 3) <= steps) & (abs(k - 4) <= steps)
        assert (dilate(inside, steps) == expected).all()
    assert not dilate(np.zeros((4, 4, 4), bool), 2).any()
