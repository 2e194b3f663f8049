"""Distances of points and segments: laws, limits and a search by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.fields.oracle import searched, to_segment
from scaffold_geometry.fields.segment_distances import (
    DISTANCE_DEFINITIONS,
    frames_of,
    squared_endpoint,
    squared_endpoint_to_segment,
    squared_exact,
    squared_in_frame,
    squared_point_point,
    squared_point_segment,
    squared_segment_segment,
)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def test_distance_of_points_is_euclidean(rng: np.random.Generator):
    p, q = rng.normal(size=(2, 3))
    assert squared_point_point(*p, *q) == pytest.approx(np.linalg.norm(p - q) ** 2, rel=1e-14)


@pytest.mark.parametrize(
    ("point", "squared"),
    [((0.5, 2, 0), 4), ((-3, 4, 0), 25), ((2, 0, 1), 2), ((0.25, 0, 0), 0)],
    ids=["beside", "before the start", "past the end", "on it"],
)
def test_a_point_is_measured_to_the_nearest_point_of_a_segment(point: tuple[float, ...], squared: float):
    assert squared_point_segment(*point, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0) == pytest.approx(squared, abs=1e-15)


def test_distance_of_a_point_from_a_segment_agrees_with_the_oracle(rng: np.random.Generator):
    for p, a, b in rng.normal(size=(200, 3, 3)):
        assert squared_point_segment(*p, *a, *b) == pytest.approx(float(to_segment(p, a, b)), rel=1e-12)


def test_a_segment_of_no_length_is_a_point(rng: np.random.Generator):
    p, a, b = rng.normal(size=(3, 3))
    to_point, to_ab = squared_point_point(*p, *a), squared_point_segment(*p, *a, *b)
    assert squared_point_segment(*p, *a, *a) == to_point
    assert squared_exact(*p, *p, *a, *a) == squared_endpoint(*p, *p, *a, *a) == to_point
    assert squared_exact(*p, *p, *a, *b) == squared_exact(*a, *b, *p, *p) == to_ab
    assert squared_endpoint_to_segment(*p, *p, *a, *b) == to_ab


@pytest.mark.parametrize("reading", DISTANCE_DEFINITIONS.values(), ids=DISTANCE_DEFINITIONS)
def test_distance_of_segments_is_the_same_from_either_and_by_either_end(reading: int, rng: np.random.Generator):
    for a, b, c, d in rng.normal(size=(50, 4, 3)):
        one = squared_segment_segment(reading, *a, *b, *c, *d)
        for other in ((c, d, a, b), (b, a, c, d), (a, b, d, c)):
            assert squared_segment_segment(reading, *np.ravel(other)) == pytest.approx(one, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("reading", DISTANCE_DEFINITIONS.values(), ids=DISTANCE_DEFINITIONS)
def test_a_segment_has_no_distance_from_itself_or_from_one_it_meets_at_an_end(reading: int, rng: np.random.Generator):
    a, b, c = rng.normal(size=(3, 3))
    assert squared_segment_segment(reading, *a, *b, *a, *b) == 0.0
    assert squared_segment_segment(reading, *a, *b, *b, *c) == pytest.approx(0.0, abs=1e-30)


def test_the_three_readings_never_grow(rng: np.random.Generator):
    for ends in rng.normal(size=(200, 12)):
        assert squared_endpoint(*ends) >= squared_endpoint_to_segment(*ends) >= squared_exact(*ends) >= 0.0


def test_the_three_readings_differ_where_segments_cross():
    cross = (-1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -2.0, 3.0, 0.0, 2.0, 3.0)
    assert [squared_segment_segment(reading, *cross) for reading in DISTANCE_DEFINITIONS.values()] == pytest.approx(
        [14, 10, 9]
    )


def test_exact_distance_of_segments_agrees_with_a_search_by_brute_force(rng: np.random.Generator):
    a, b, c, d = np.moveaxis(rng.normal(size=(300, 4, 3)), 1, 0)
    kernel = [squared_exact(*np.ravel(ends)) for ends in zip(a, b, c, d, strict=True)]
    np.testing.assert_allclose(kernel, searched(a, b, c, d), rtol=1e-9, atol=1e-14)
    s, t = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    for i in range(20):
        ab, cd = (p[i] + x[..., None] * (q[i] - p[i]) for p, q, x in ((a, b, s), (c, d, t)))
        sampled = ((ab - cd) ** 2).sum(axis=-1).min()
        assert kernel[i] <= sampled <= (kernel[i] ** 0.5 + 0.2) ** 2


@pytest.mark.parametrize("tilt", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
def test_nearly_parallel_segments_keep_their_distance(tilt: float, rng: np.random.Generator):
    for offset in rng.uniform(-2, 2, 20):
        a, b = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
        c, d = np.array([offset, -tilt, 0.5]), np.array([offset + 1.0, tilt, 0.5])
        true = float(searched(a, b, c, d))
        assert squared_exact(*a, *b, *c, *d) == pytest.approx(true, rel=1e-12, abs=1e-15)


def test_frames_are_orthonormal_and_their_first_axes_level(rng: np.random.Generator):
    steps = np.vstack([rng.normal(size=(20, 3)), np.eye(3), -np.eye(3), [(0, 0, 0), (0, 1e-170, 1e-9), (5e-324, 0, 0)]])
    starts = rng.normal(size=steps.shape) * (np.abs(steps).max(axis=1, keepdims=True) > 1e-12)
    frames = frames_of(starts, starts + steps).T
    beside = np.column_stack([frames[:, 3:5], np.zeros(len(frames))])
    axes = np.stack([beside, frames[:, 5:8], frames[:, 8:11]], axis=1)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=1e-15)
    np.testing.assert_allclose(frames[:, 11:] * frames[:, 8:11], steps, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(frames[:, :3], starts)


def test_a_distance_in_a_frame_is_the_distance(rng: np.random.Generator):
    for p, a, b in rng.normal(size=(200, 3, 3)):
        frame = frames_of(a[None], b[None])[:, 0]
        w = p - frame[:3]
        squared = squared_in_frame((w[:2] @ frame[3:5]) ** 2, w @ frame[5:8], w @ frame[8:11], frame[11])
        assert squared == pytest.approx(squared_point_segment(*p, *a, *b), rel=1e-12)
