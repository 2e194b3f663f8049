"""Extremes along and around segments, against fields whose extremes are known."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.fields.certificate import Rings, extremes_of

STARTS = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [0.0, 0.0, 5.0]])
ENDS = np.array([[4.0, 0.0, 0.0], [1.0, 2.0, 7.0], [0.0, 3.0, 1.0]])
PLACES = (0.2, 0.9)


def extremes_along(at, sign):
    return extremes_of(at, STARTS, ENDS, Rings(PLACES, (0.1,)), sign)[0]


def extremes_around(at, one, radii, sign, ends=ENDS):
    return extremes_of(at, STARTS[one : one + 1], ends[one : one + 1], Rings(PLACES, radii), sign)[1][0]


def peak(share):
    """Return a field that has its only peak, 1, at this share of the first segment."""
    place = STARTS[0] + share * (ENDS[0] - STARTS[0])
    return lambda points: 1.0 - np.linalg.norm(points - place, axis=1)


@pytest.mark.parametrize("share", [0.0, 0.031, 0.37, 0.5, 0.777, 1.0])
def test_a_peak_between_the_samples_is_found(share):
    assert extremes_along(peak(share), 1)[0] == pytest.approx(1.0, abs=1e-4)
    assert extremes_along(lambda points: -peak(share)(points), -1)[0] == pytest.approx(-1.0, abs=1e-4)


def test_a_linear_field_has_its_extremes_at_the_ends():
    slope = np.array([0.3, -0.2, 0.5])
    ends = np.stack([STARTS @ slope, ENDS @ slope])
    np.testing.assert_allclose(extremes_along(lambda points: points @ slope, 1), ends.max(axis=0))
    np.testing.assert_allclose(extremes_along(lambda points: points @ slope, -1), ends.min(axis=0))


def test_rings_have_their_radius_about_their_segment():
    def distance(points):
        a, step = STARTS[1], ENDS[1] - STARTS[1]
        t = ((points - a) @ step / (step @ step)).clip(0.0, 1.0)
        return np.linalg.norm(points - a - t[:, None] * step, axis=1)

    for sign in (1, -1):
        np.testing.assert_allclose(extremes_around(distance, 1, (0.25, 0.5), sign), (0.25, 0.5), rtol=1e-12)


def test_rings_stand_at_their_places_and_go_all_around():
    seen = []

    def keep(points):
        seen.append(points)
        return np.zeros(len(points))

    extremes_around(keep, 0, (0.25,), 1)
    ring = seen[0][9:].reshape(2, 4, 3)
    np.testing.assert_allclose(ring[..., 0], np.tile([[0.8], [3.6]], 4), rtol=1e-12)
    np.testing.assert_allclose(ring.mean(axis=1)[:, 1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ring[:, 1:] - ring[:, :-1], axis=2), 0.25 * 2.0**0.5, rtol=1e-12)


def test_a_segment_thicker_than_the_ring_keeps_its_side_and_a_thinner_one_does_not():
    """A round strut of radius 0.5 along x: solid (positive) within it."""

    def strut(points):
        return 0.5 - np.linalg.norm(points[:, 1:], axis=1)

    within, beyond = extremes_around(strut, 0, (0.49, 0.51), -1)
    assert within > 0.0
    assert beyond < 0.0


def test_a_segment_without_length_has_a_ring_too():
    values = extremes_around(lambda points: points[:, 0], 0, (2.0,), 1, ends=STARTS)
    assert values[0] == pytest.approx(2.0, abs=1e-9)
