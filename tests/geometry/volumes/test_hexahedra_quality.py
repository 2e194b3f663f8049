"""Scaled Jacobians against a plain oracle, and sweeps that leave no cell worse than they may."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.fields.oracle import HEXAHEDRON, Floats, Ints
from scaffold_geometry.volumes.hexahedra.quality import least_jacobians, sweep
from shapes import hexahedra

ONE = np.arange(8).reshape(1, 8)


def least_of(vertices: Floats, cells: Ints):
    """Return the least scaled Jacobian of each cell, by the corners that differ in one coordinate."""
    found = []
    for cell in cells:
        corners = vertices[cell]
        jacobians = []
        for corner, place in enumerate(HEXAHEDRON):
            others = [np.flatnonzero((np.abs(place - step) == HEXAHEDRON).all(axis=1))[0] for step in np.eye(3)]
            edges = corners[others] - corners[corner]
            edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
            jacobians.append(np.linalg.det(edges) * np.prod(1.0 - 2.0 * place))
        found.append(min(jacobians))
    return np.array(found)


def ways_of(cells: Ints, count: int):
    owners = np.argsort(cells.ravel(), kind="stable") // 8
    starts = np.concatenate([[0], np.cumsum(np.bincount(cells.ravel(), minlength=count))])
    return starts, owners


def test_bent_cells_have_the_jacobians_of_the_oracle():
    mesh = hexahedra((3, 2, 2))
    rng = np.random.default_rng(4)
    for amount in (0.05, 0.2, 0.5):
        vertices = mesh.vertices + rng.normal(0.0, amount, mesh.vertices.shape)
        expected = least_of(vertices, mesh.hexahedra)
        np.testing.assert_allclose(least_jacobians(vertices, mesh.hexahedra), expected, atol=1e-12)
    assert expected.min() < 0.0  # some of them are inverted


def test_neither_size_nor_place_changes_a_jacobian_and_a_mirror_its_sign():
    bent = HEXAHEDRON + 0.1 * np.random.default_rng(1).normal(size=(8, 3))
    (least,) = least_jacobians(bent, ONE)
    assert least_jacobians(7.0 * bent + 3.0, ONE)[0] == pytest.approx(least)
    assert least_jacobians(HEXAHEDRON * [2.0, 3.0, 0.1], ONE)[0] == pytest.approx(1.0)
    assert least_jacobians(HEXAHEDRON * [-1.0, 1.0, 1.0], ONE)[0] == pytest.approx(-1.0)


def test_a_cell_with_two_corners_at_one_place_is_worth_nothing():
    collapsed = HEXAHEDRON.copy()
    collapsed[1] = collapsed[0]
    assert least_jacobians(collapsed, ONE)[0] == -1.0


def test_a_vertex_that_harms_no_cell_reaches_its_target():
    vertices, target = HEXAHEDRON.copy(), HEXAHEDRON.copy()
    target[6] = (1.1, 1.2, 1.0)
    sweep(vertices, target, np.array([6]), ONE, *ways_of(ONE, 8), 0.3)
    np.testing.assert_array_equal(vertices, target)


@pytest.mark.parametrize("floor", [0.05, 0.3])
def test_no_sweep_takes_a_cell_below_the_floor(floor: float):
    mesh = hexahedra((4, 4, 4))
    rng = np.random.default_rng(2)
    targets = mesh.vertices + rng.normal(0.0, 0.6, mesh.vertices.shape)
    assert least_jacobians(targets, mesh.hexahedra).min() < 0.0  # unguarded
    vertices, order = mesh.vertices.copy(), np.arange(len(targets))
    sweep(vertices, targets, order, mesh.hexahedra, *ways_of(mesh.hexahedra, len(order)), floor)
    assert least_jacobians(vertices, mesh.hexahedra).min() >= floor
    assert (vertices != mesh.vertices).any(axis=1).mean() > 0.5


def test_a_poor_cell_may_move_but_get_no_worse():
    poor = HEXAHEDRON.copy()
    poor[6] = (0.55, 0.55, 0.95)
    (before,) = least_jacobians(poor, ONE)
    assert before < 0.3
    for towards in (HEXAHEDRON[6], np.array([0.2, 0.2, 0.9])):
        vertices, target = poor.copy(), poor.copy()
        target[6] = towards
        sweep(vertices, target, np.array([6]), ONE, *ways_of(ONE, 8), 0.3)
        (after,) = least_jacobians(vertices, ONE)
        assert after >= before
    np.testing.assert_array_equal(vertices, poor)  # the second step is given up altogether
