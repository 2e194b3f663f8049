"""Basis functions: their formulas, their limits and their slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kernels.oracle import phi
from scaffold_stages._kernels.bases import (
    BASES,
    basis_value,
    gaussian,
    inverse_multiquadric,
    multiquadric,
    thin_plate_spline,
)


def test_every_basis_has_its_own_number():
    assert sorted(BASES.values()) == [0, 1, 2, 3]


@pytest.mark.parametrize("basis", BASES)
def test_a_basis_agrees_with_its_formula_in_the_distance(basis: str):
    for r in (0.0, 1e-8, 1e-3, 0.5, 1.0, 7.0):
        for c in (0.05, 1.0, 2.5):
            expected = float(phi(basis, np.array(r * r), c))
            assert basis_value(BASES[basis], r * r, c) == pytest.approx(expected, rel=1e-12, abs=1e-15)


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
        values = [basis_value(BASES[basis], one, 0.7) for one in squared]
        assert (sign * np.diff(values) > 0).all()


def test_a_thin_plate_spline_tends_to_nothing_at_the_element():
    assert [thin_plate_spline(r * r) for r in (1e-100, 1e-160, 1e-300)] == pytest.approx([0.0] * 3, abs=1e-150)
