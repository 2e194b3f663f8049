"""Areas of bodies that are known, and which of their faces lie on the outer shape."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.measures import surface
from scaffold_geometry.measures.surface import faces_of_pores, surface_measures
from scaffold_geometry.surfaces import booleans
from shapes import ball, box

OUTER = box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0))


def block_with_a_bore():
    """Return the outer cube with a bore of 2 x 2 mm through it along z."""
    body = booleans.to_manifold(*OUTER, "cube") - booleans.to_manifold(*box((1.0, 1.0, -1.0), (3.0, 3.0, 5.0)), "bore")
    return booleans.from_manifold(body)


def test_the_walls_of_a_bore_are_the_pores_and_all_else_lies_on_the_shape():
    solid = block_with_a_bore()
    measures = surface_measures(solid, (48.0, 64.0), faces_of_pores(solid, OUTER, 1e-6))
    assert measures.pore_surface_area_mm2 == pytest.approx(4 * 2 * 4)
    assert measures.cut_surface_area_mm2 == pytest.approx(4 * 16 + 2 * (16 - 4))
    assert measures.surface_area_mm2 == pytest.approx(32 + 88)


def test_ratios_are_per_volume_of_solid_and_of_the_shape():
    solid = block_with_a_bore()
    measures = surface_measures(solid, (48.0, 64.0), faces_of_pores(solid, OUTER, 1e-6))
    assert measures.bs_per_bv == pytest.approx(120 / 48)
    assert measures.bs_per_tv == pytest.approx(120 / 64)
    assert measures.pore_surface_per_bv == pytest.approx(32 / 48)
    assert measures.pore_surface_per_tv == pytest.approx(32 / 64)


def test_a_ball_within_the_shape_is_all_pore_surface():
    solid = ball(1.0, (2.0, 2.0, 2.0), divisions=5)
    measures = surface_measures(solid, (4.0 / 3.0 * np.pi, 64.0), faces_of_pores(solid, OUTER, 1e-3))
    assert measures.cut_surface_area_mm2 == 0.0
    assert measures.surface_area_mm2 == pytest.approx(4.0 * np.pi, rel=2e-3)
    assert measures.bs_per_bv == pytest.approx(3.0, rel=2e-3)


def test_a_wall_counts_as_on_the_shape_only_within_the_tolerance():
    solid = box((0.01, 0.0, 0.0), (2.0, 4.0, 4.0))
    areas = [
        surface_measures(solid, (1.0, 1.0), faces_of_pores(solid, OUTER, tolerance)).pore_surface_area_mm2
        for tolerance in (0.001, 0.02)
    ]
    assert areas == pytest.approx([32.0, 16.0])


def test_a_chord_whose_corners_lie_on_a_curved_shape_is_a_pore_wall():
    vertices = np.array([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 5.0]])
    assert faces_of_pores((vertices, np.array([[0, 1, 2]])), ball(5.0), 1e-3).all()


def test_faces_asked_for_in_parts_are_those_asked_for_at_once(monkeypatch: pytest.MonkeyPatch):
    solid = block_with_a_bore()
    at_once = faces_of_pores(solid, OUTER, 1e-6)
    monkeypatch.setattr(surface, "_TRIANGLES", 7)
    np.testing.assert_array_equal(faces_of_pores(solid, OUTER, 1e-6), at_once)
    assert 0 < at_once.sum() < len(at_once)
