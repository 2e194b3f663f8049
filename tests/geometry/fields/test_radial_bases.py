"""Basis functions: their formulas, their limits and their slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from geometry.fields.oracle import phi
from scaffold_geometry.fields.radial_bases import (
    BASES,
    ROOT_SCALE,
    exponential,
    gaussian,
    inverse_multiquadric,
    logarithm,
    multiquadric,
    radial_basis,
    scale_of,
    scaled_reciprocal_root,
    shift_of,
    summand,
    thin_plate_spline,
)

RNG = np.random.default_rng(21)


def test_every_basis_has_its_own_number():
    assert sorted(BASES.values()) == [0, 1, 2, 3]


@pytest.mark.parametrize("basis", BASES)
def test_a_basis_agrees_with_its_formula_in_the_distance(basis: str):
    for r in (0.0, 1e-8, 1e-3, 0.5, 1.0, 7.0):
        for c in (0.05, 1.0, 2.5):
            expected = float(phi(basis, np.array(r * r), c))
            assert radial_basis(BASES[basis], r * r, c) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_values_at_the_element_itself():
    assert gaussian(0.0, 3.0) == 1.0
    assert multiquadric(0.0, 0.5) == 0.5
    assert inverse_multiquadric(0.0, 0.1) == pytest.approx(10.0)
    assert thin_plate_spline(0.0) == 0.0


def test_known_values_at_other_distances():
    assert gaussian(4.0, 0.5) == pytest.approx(math.exp(-1.0))
    assert multiquadric(9.0, 4.0) == pytest.approx(5.0)
    assert inverse_multiquadric(9.0, 4.0) == pytest.approx(0.2)
    assert thin_plate_spline(math.e**2) == pytest.approx(math.e**2)
    assert thin_plate_spline(1.0) == 0.0


def test_the_two_multiquadrics_are_each_others_inverses():
    for squared in np.linspace(0.0, 9.0, 19):
        assert multiquadric(squared, 0.1) * inverse_multiquadric(squared, 0.1) == pytest.approx(1.0, rel=1e-14)


def test_gaussian_and_inverse_multiquadric_fall_and_the_multiquadric_grows_with_the_distance():
    squared = np.linspace(0.0, 9.0, 50)
    for basis, sign in (("gaussian", -1), ("inverse_multiquadric", -1), ("multiquadric", 1)):
        values = [radial_basis(BASES[basis], one, 0.7) for one in squared]
        assert (sign * np.diff(values) > 0).all()


def test_a_thin_plate_spline_tends_to_nothing_at_the_element():
    assert [thin_plate_spline(r * r) for r in (1e-100, 1e-160, 1e-300)] == pytest.approx([0.0] * 3, abs=1e-150)


def require_within(bound: float, values: list[float], expected: np.ndarray):
    """Compare with extended precision, where there is any."""
    assert np.abs(np.array(values, np.longdouble) / expected - 1.0).max() < bound


@pytest.mark.parametrize("decades", [290, 3, 0.3], ids=str)
def test_the_reciprocal_root_is_within_its_bound(decades: float):
    numbers = 10 ** RNG.uniform(-decades, decades, 4000)
    exact = ROOT_SCALE / np.sqrt(numbers.astype(np.longdouble))
    require_within(5e-16, [scaled_reciprocal_root(number) for number in numbers], exact)


def test_the_reciprocal_root_is_within_its_bound_at_the_ends_of_its_first_guess():
    """The guess is worst at powers of two and half-way between, and the cycle is a factor of four."""
    around = np.array([1.0, 1.5, 2.0, 3.0, 4.0])[:, None] * (1 + np.finfo(float).eps * np.arange(-40, 41))
    numbers = np.concatenate([(around * 4.0**k).ravel() for k in (-450, -7, 0, 5, 450)])
    exact = ROOT_SCALE / np.sqrt(numbers.astype(np.longdouble))
    require_within(5e-16, [scaled_reciprocal_root(number) for number in numbers], exact)


@pytest.mark.parametrize("least", [-700.0, -20.0, -1.0, -1e-9])
def test_the_exponential_is_within_its_bound(least: float):
    numbers = RNG.uniform(least, 0.0, 4000)
    require_within(3e-16, [exponential(number) for number in numbers], np.exp(numbers.astype(np.longdouble)))


def test_the_exponential_of_very_little_is_next_to_nothing():
    assert [exponential(x) for x in (0.0, -0.0)] == [1.0, 1.0]
    assert 0.0 < exponential(-math.inf) == exponential(-1e9) < exponential(-707.0) < 1e-300


@pytest.mark.parametrize(("low", "high"), [(1e-300, 1e-290), (1e-9, 1e9), (0.7, 1.42), (1 - 1e-9, 1 + 1e-9)])
def test_the_logarithm_is_within_its_bound(low: float, high: float):
    numbers = np.exp(RNG.uniform(np.log(low), np.log(high), 4000))
    numbers = numbers[numbers != 1.0]
    require_within(4e-16, [logarithm(number) for number in numbers], np.log(numbers.astype(np.longdouble)))


def test_the_logarithm_of_one_and_of_nothing():
    assert logarithm(1.0) == 0.0
    assert math.isfinite(logarithm(0.0))


@pytest.mark.parametrize("basis", BASES)
def test_a_summand_is_a_basis_function_but_for_its_scale(basis: str):
    number = BASES[basis]
    assert math.frexp(scale_of(number))[0] in {0.5, -0.5}
    for squared in (0.0, 1e-14, 0.3, 1.0, 1e6):
        value = summand(number, squared + shift_of(number, 0.1), 0.1) / scale_of(number)
        assert value == pytest.approx(radial_basis(number, squared, 0.1), rel=1e-15)
