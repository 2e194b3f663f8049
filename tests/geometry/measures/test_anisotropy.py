"""Mean intercept lengths of walls for which they are known in closed form, and of lines that are really drawn."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.measures.anisotropy import anisotropy
from shapes import ball, box, together

TURN = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0]


def rods(sides: int = 64):
    """Return the walls of rods along z, 1 mm thick and 10 mm long, without their ends; their volume."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sides)])
    vertices = np.concatenate([ring, ring + np.array([0.0, 0.0, 10.0])])
    here = np.arange(sides)
    there = (here + 1) % sides
    faces = np.concatenate(
        [np.column_stack([here, there, there + sides]), np.column_stack([here, there + sides, here + sides])]
    )
    area = 0.5 * sides * 0.25 * np.sin(2.0 * np.pi / sides)
    return vertices, faces, 10.0 * area


def plates():
    """Return both sides of a plate 0.5 mm thick and 10 x 10 mm across x and y, without its rims; its volume."""
    vertices, faces = box((0.0, 0.0, 0.0), (10.0, 10.0, 0.5))
    is_level = np.ptp(vertices[faces][:, :, 2], axis=1) == 0.0
    return vertices, faces[is_level], 50.0


def direction_angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(abs(one @ other), 1.0))))


def test_a_ball_is_isotropic_with_its_mean_chord():
    vertices, faces = ball(1.5, divisions=5)
    found = anisotropy(vertices, faces, 4.0 / 3.0 * np.pi * 1.5**3)
    np.testing.assert_allclose(found.lengths, 4.0 / 3.0 * 1.5, rtol=2e-3)
    assert found.degree < 1e-3
    assert found.ratio == pytest.approx(1.0, abs=1e-3)
    assert found.fit_residual < 1e-3


@pytest.mark.parametrize("turn", [np.eye(3), TURN])
def test_balls_stretched_to_twice_their_length_have_twice_the_intercepts_along_it(turn: np.ndarray):
    vertices, faces = ball(1.0, divisions=5)
    stretched = (vertices * [1.0, 1.0, 2.0]) @ turn
    found = anisotropy(stretched, faces, 8.0 / 3.0 * np.pi)
    np.testing.assert_allclose(found.lengths, [8.0 / 3.0, 4.0 / 3.0, 4.0 / 3.0], rtol=3e-3)
    assert found.ratio == pytest.approx(2.0, rel=2e-3)
    assert found.degree == pytest.approx(0.75, abs=1e-3)
    assert direction_angle(found.axes[0], turn[2]) < 0.1


def test_plates_are_crossed_by_their_thickness_and_never_along_them():
    vertices, faces, volume = plates()
    found = anisotropy(vertices @ TURN, faces, volume)
    assert found.lengths[2] == pytest.approx(0.5)
    assert np.isinf(found.lengths[:2]).all()
    assert found.degree == 1.0
    assert direction_angle(found.axes[2], TURN[2]) < 1e-4
    assert found.fit_residual < 1e-9


def test_rods_are_crossed_by_their_mean_chord_and_never_along_them():
    vertices, faces, volume = rods()
    found = anisotropy(vertices @ TURN, faces, volume)
    np.testing.assert_allclose(found.lengths[1:], np.pi / 4.0, rtol=3e-3)  # 4 area / perimeter, by pi / 4
    assert found.degree > 0.9999  # of 64 flat sides
    assert direction_angle(found.axes[0], TURN[2]) < 0.01


def test_rods_of_which_most_go_one_way_prefer_it():
    vertices, faces, volume = rods()
    thrice = together(*3 * [(vertices, faces)], (vertices[:, [2, 0, 1]], faces))
    found = anisotropy(*thrice, 4.0 * volume)
    assert 0.1 < found.degree < 1.0
    assert direction_angle(found.axes[0], np.array([0.0, 0.0, 1.0])) < 0.1


def test_cubes_however_turned_have_the_bias_of_finite_directions_and_no_more():
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    degrees = [
        anisotropy(vertices @ turn, faces, 1.0).degree
        for turn in np.linalg.qr(np.random.default_rng(7).standard_normal((8, 3, 3)))[0]
    ]
    assert 0.0 < max(degrees) < 0.0025


def test_the_lengths_are_those_of_lines_really_drawn():
    # Chords of lines through a box, spread over what it shows along a direction: volume over that area.
    sides = np.array([1.0, 2.0, 4.0])
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 2.0, 4.0))
    direction = np.array([2.0, 3.0, 6.0]) / 7.0
    rng = np.random.default_rng(8)
    across = np.linalg.qr(np.column_stack([direction, *rng.standard_normal((2, 3))]))[0][:, 1:]
    starts = sides / 2.0 + rng.uniform(-4.0, 4.0, (200_000, 2)) @ across.T
    ends = np.sort([(-starts) / direction, (sides - starts) / direction], axis=0)
    chords = ends[1].min(axis=1) - ends[0].max(axis=1)
    drawn = chords[chords > 0.0].mean()
    found = anisotropy(vertices, faces, 8.0)
    fitted = 1.0 / np.sqrt(((found.axes @ direction) ** 2 / found.lengths**2).sum())
    assert fitted == pytest.approx(drawn, rel=3.0 * found.fit_residual)
    assert found.fit_residual < 0.1


def test_the_unit_scales_the_lengths_and_not_the_degree():
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 2.0, 4.0))
    one, other = anisotropy(vertices, faces, 8.0), anisotropy(10.0 * vertices, faces, 8000.0)
    np.testing.assert_allclose(other.lengths, 10.0 * one.lengths)
    assert other.degree == pytest.approx(one.degree)


def test_without_walls_there_is_no_ellipsoid():
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert anisotropy(vertices, faces[:0], 1.0) is None
