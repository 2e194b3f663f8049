"""The sums of the exact field: on a grid and at loose points, against plain numpy term by term."""

from __future__ import annotations

from itertools import product

import numba
import numpy as np
import pytest

from geometry.fields import oracle
from geometry.fields.oracle import REFERENCE_MESHES, Floats, one_tetrahedron, phi, to_segment
from scaffold_geometry.fields.interpolant import (
    Elements,
    assemble,
    elements_of,
    evaluate,
    evaluate_on_grid,
    solve,
    values_of,
)
from scaffold_geometry.fields.interpolant_sums import LANES
from scaffold_geometry.fields.radial_bases import BASES
from scaffold_geometry.fields.skeleton import skeleton_of

IMQ, C = "inverse_multiquadric", 0.1
MESHES = {**REFERENCE_MESHES, "one_tetrahedron": one_tetrahedron}
ROUNDING = 2e-15
"""Of the sum of all terms' sizes: about ten roundings a term."""

Axes = tuple[Floats, Floats, Floats]


def some_elements(points: int = 7, segments: int = 9) -> Elements:
    rng = np.random.default_rng(1)
    return Elements(rng.normal(size=(points, 3)), *rng.normal(size=(2, segments, 3)))


def some_weights(elements: Elements) -> Floats:
    return np.random.default_rng(2).normal(size=elements.unknowns)


def some_axes() -> Axes:
    """A row is two blocks of lanes and a part of one."""
    return np.linspace(-1.0, 1.1, 3), np.linspace(-0.9, 1.0, 4), np.linspace(-1.2, 1.0, 2 * LANES + 5)


def corners_of(axes: Axes) -> Floats:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def on_grid(axes: Axes, elements: Elements, weights: Floats, basis: str = IMQ, c: float = C) -> Floats:
    values = np.full(tuple(map(len, axes)), np.nan)
    evaluate_on_grid(axes, np.ones(values.shape, bool), elements, weights, basis, c, values)
    return values


def terms(points: Floats, elements: Elements, weights: Floats, basis: str, c: float = C) -> Floats:
    """Return every w_i phi_i, (m, n), in numpy, a point being a segment of no length."""
    starts, ends = np.vstack([elements.points, elements.starts]), np.vstack([elements.points, elements.ends])
    return weights * phi(basis, to_segment(points[:, None], starts, ends), c)


def require_the_sum_of(expected: Floats, field: Floats, rounding: float = ROUNDING):
    error = np.abs(field.ravel() - expected.sum(axis=1)) / np.abs(expected).sum(axis=1)
    assert error.max() < rounding


@pytest.mark.parametrize(("name", "basis"), list(product(MESHES, BASES)))
def test_grid_and_points_are_the_sums_of_numpy_with_the_weights_of_every_mesh(name: str, basis: str):
    skeleton = skeleton_of(*MESHES[name]())
    elements = elements_of(skeleton)
    weights = solve(assemble(elements, basis, "exact", C), values_of(skeleton)).weights
    low, high = skeleton.vertices.min(axis=0), skeleton.vertices.max(axis=0)
    axes = tuple(np.linspace(*ends, count) for *ends, count in zip(low, high, (3, 2, LANES + 3), strict=True))
    points = corners_of(axes)
    expected = terms(points, elements, weights, basis)
    require_the_sum_of(expected, on_grid(axes, elements, weights, basis))
    require_the_sum_of(expected, evaluate(*points.T, elements, weights, basis, C))


@pytest.mark.parametrize("basis", BASES)
def test_field_on_a_grid_agrees_with_the_oracle(basis: str):
    """With weights of its own: the whole field to 1e-8 of its range, where there is one interpolant."""
    skeleton = skeleton_of(*one_tetrahedron())
    elements = elements_of(skeleton)
    weights = solve(assemble(elements, basis, "exact", C), values_of(skeleton)).weights
    expected = oracle.interpolant_of(one_tetrahedron(), basis, "exact", C).at(corners_of(some_axes()))
    field = on_grid(some_axes(), elements, weights, basis).ravel()
    np.testing.assert_allclose(field, expected, rtol=0, atol=1e-8 * np.ptp(expected))


@pytest.mark.parametrize("basis", BASES)
def test_only_samples_asked_for_are_filled_and_each_alike_whatever_else_is_asked_for(basis: str):
    elements, axes = some_elements(), some_axes()
    weights = some_weights(elements)
    whole = on_grid(axes, elements, weights, basis)
    for share in (0.0, 0.03, 0.5, 1.0):
        near = np.random.default_rng(3).random(whole.shape) < share
        values = np.full(whole.shape, -1.0)
        evaluate_on_grid(axes, near, elements, weights, basis, C, values)
        np.testing.assert_array_equal(values, np.where(near, whole, -1.0))


def test_single_precision_is_the_rounded_double():
    elements, axes = some_elements(), some_axes()
    whole = on_grid(axes, elements, some_weights(elements))
    values = np.zeros(whole.shape, np.float32)
    evaluate_on_grid(axes, np.ones(whole.shape, bool), elements, some_weights(elements), IMQ, C, values)
    np.testing.assert_array_equal(values, whole.astype(np.float32))


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2 or bool(numba.config.DISABLE_JIT), reason="one thread only")
@pytest.mark.parametrize("basis", BASES)
def test_the_number_of_threads_changes_no_bit(basis: str):
    elements, axes = some_elements(), some_axes()
    points, fields = np.random.default_rng(4).normal(size=(3, 5000)), []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        numba.set_num_threads(threads)
        weights = some_weights(elements)
        grid, loose = on_grid(axes, elements, weights, basis), evaluate(*points, elements, weights, basis, C)
        fields.append((grid.tobytes(), loose.tobytes()))
    assert fields[0] == fields[1]


@pytest.mark.parametrize("length", [0.0, 5e-324, 1e-200, 1e-18], ids=str)
def test_a_segment_of_next_to_no_length_is_a_point(length: float):
    points = np.random.default_rng(5).normal(size=(3, 6, 3))[0]
    steps = length * np.random.default_rng(6).normal(size=points.shape)
    weights, none = np.random.default_rng(7).normal(size=6), np.empty((0, 3))
    as_points = on_grid(some_axes(), Elements(points, none, none), weights)
    as_segments = on_grid(some_axes(), Elements(none, points, points + steps), weights)
    np.testing.assert_allclose(as_segments, as_points, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "direction",
    [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1e-9, 0, 1), (0, 1e-160, 1), (1, 2, 1e-12), (-1, 1, 2)],
    ids=str,
)
def test_distances_are_right_on_and_about_segments_of_any_direction(direction: tuple[float, ...]):
    """A multiquadric with next to no c is the distance itself."""
    start, step = np.array([0.3, -0.2, 0.1]), np.array(direction)
    segment = Elements(np.empty((0, 3)), start[None], (start + step)[None])
    t = np.linspace(-0.5, 1.5, 9)[:, None]
    line = start + t * step
    points = np.vstack([line, line + np.array([0.0, 0.0, 1e-3]), line + np.array([0.4, -0.3, 0.2])])
    expected = np.sqrt(to_segment(points, segment.starts, segment.ends))
    for place, distance in zip(points, expected, strict=True):
        axes = tuple(np.array([coordinate]) for coordinate in place)
        field = on_grid(axes, segment, np.ones(1), "multiquadric", 1e-20)
        assert field.item() == pytest.approx(distance, rel=1e-13, abs=1e-15)
    loose = evaluate(*points.T, segment, np.ones(1), "multiquadric", 1e-20)
    np.testing.assert_allclose(loose, expected, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("basis", BASES)
def test_points_far_away_are_right(basis: str):
    elements = some_elements()
    weights = some_weights(elements)
    axes = (np.array([-1e7, 3e3]), np.array([50.0, 2e5]), np.array([1e4, -1e9]))
    expected = terms(corners_of(axes), elements, weights, basis)
    if basis == "gaussian":
        assert (on_grid(axes, elements, weights, basis) == 0.0).all() or np.abs(expected).max() < 1e-300
    else:
        require_the_sum_of(expected, on_grid(axes, elements, weights, basis))


def test_a_mesh_far_from_the_origin_loses_only_the_digits_of_its_coordinates():
    elements, axes, shift = some_elements(), some_axes(), 2.0**20
    moved = Elements(*(corners + shift for corners in (elements.points, elements.starts, elements.ends)))
    there = Elements(*(corners - shift for corners in (moved.points, moved.starts, moved.ends)))
    nearby = tuple((axis + shift) - shift for axis in axes)
    weights = some_weights(elements)
    far = on_grid(tuple(axis + shift for axis in nearby), moved, weights)
    np.testing.assert_allclose(far, on_grid(nearby, there, weights), rtol=0, atol=1e-12)


def test_nothing_sums_to_nothing():
    none = np.empty((0, 3))
    assert (on_grid(some_axes(), Elements(none, none, none), np.empty(0)) == 0.0).all()
    assert evaluate(*np.empty((3, 0)), some_elements(), some_weights(some_elements()), IMQ, C).shape == (0,)
