"""Porosity counts voxels, and what is open and what is shut in is told apart where voxels touch."""

from __future__ import annotations

import numpy as np
import pytest

from measures.voxel_images import gyroid, image_of, places
from scaffold_stages._measures.image import OUTSIDE, PORE, STRUT, VoxelImage
from scaffold_stages._measures.porosity import porosity
from scaffold_stages._measures.voxelising import voxelise
from shapes import ball, box, inverted, together, volume_of


def test_the_porosity_of_a_gyroid_is_the_half_that_its_symmetry_demands():
    found = porosity(image_of(gyroid(40, 0.0)))
    assert found.total == pytest.approx(0.5, abs=0.01)
    assert found.closed == 0.0
    assert (found.pore_pieces, found.strut_pieces) == (1, 1)
    assert porosity(image_of(gyroid(40, 0.5))).total > 0.6


@pytest.mark.parametrize("spacing", [1.0, 0.3])
def test_voids_have_their_volumes_and_places_largest_first(spacing: float):
    is_strut = np.ones((20, 24, 30), bool)
    is_strut[3:6, 4:6, 7:9] = is_strut[10:14, 10:14, 20:24] = False
    is_strut[:, 20, 2] = False
    found = porosity(image_of(is_strut, spacing, origin=(5.0, 6.0, 7.0)))
    large, small = found.voids
    assert large.volume == pytest.approx(64.0 * spacing**3)
    assert large.place == pytest.approx(np.array([5, 6, 7]) + spacing * np.array([12.5, 12.5, 22.5]))
    assert small.volume == pytest.approx(12.0 * spacing**3)
    assert small.place == pytest.approx(np.array([5, 6, 7]) + spacing * np.array([5.0, 5.5, 8.5]))
    whole = is_strut.size
    assert found.closed == pytest.approx(76.0 / whole)
    assert found.open == pytest.approx(20.0 / whole)
    assert found.total + found.solid == pytest.approx(1.0)
    assert found.pore_pieces == 3


def test_a_ball_shut_into_a_ball_is_closed_until_a_channel_opens_it():
    shell = together(ball(4.0), inverted(ball(2.0)))
    image = voxelise(shell, ball(4.0), 0.25)
    found = porosity(image)
    assert found.closed == pytest.approx(0.125, rel=0.02)
    assert found.open == 0.0
    assert found.voids[0].volume == pytest.approx(volume_of(ball(2.0)), rel=0.03)
    assert found.voids[0].place == pytest.approx(np.zeros(3), abs=0.05)
    drilled = image.phases.copy()
    middle = drilled.shape[0] // 2
    drilled[middle, middle, middle:][drilled[middle, middle, middle:] == STRUT] = PORE
    opened = porosity(VoxelImage(drilled, image.origin, 0.25))
    assert opened.closed == 0.0
    assert opened.open > found.closed


def test_pores_that_touch_along_an_edge_are_two_and_struts_are_one():
    is_strut = np.ones((6, 6, 6), bool)
    is_strut[2, 2, 2] = is_strut[3, 3, 2] = False
    assert porosity(image_of(is_strut)).pore_pieces == 2
    found = porosity(image_of(~is_strut))
    assert (found.strut_pieces, found.pore_pieces) == (1, 1)
    is_strut[2, 3, 2] = False
    assert porosity(image_of(is_strut)).pore_pieces == 1


def test_pores_that_hang_together_only_around_outside_are_pieces_and_open():
    is_strut = np.ones((9, 9, 9), bool)
    is_strut[0:2, 4, 4] = is_strut[7:9, 4, 4] = False
    found = porosity(image_of(is_strut))
    assert found.pore_pieces == 2
    assert found.closed == 0.0


def test_a_skinned_solid_has_closed_pores_only():
    is_strut = np.linalg.norm(places((20, 20, 20)), axis=-1) > 6.0
    found = porosity(image_of(is_strut))
    assert found.open == 0.0
    assert found.closed == found.total > 0.0


def test_a_cavity_of_the_outer_shape_opens_nothing_and_is_no_pore():
    phases = image_of(np.ones((12, 12, 12), bool)).phases
    phases[4:8, 4:8, 4:8] = PORE
    phases[5:7, 5:7, 5:7] = OUTSIDE
    found = porosity(VoxelImage(phases, np.zeros(3), 1.0))
    assert found.open == 0.0
    assert found.voids[0].volume == 64 - 8
    assert found.total == pytest.approx(56 / (12**3 - 8))


@pytest.mark.parametrize("phase", [STRUT, PORE])
def test_a_body_of_one_phase_has_none_of_the_other(phase: int):
    found = porosity(image_of(np.full((4, 4, 4), phase == STRUT)))
    assert found.solid == (1.0 if phase == STRUT else 0.0)
    assert found.open == found.total == 1.0 - found.solid


def test_voids_of_a_solid_off_the_origin_lie_where_they_were_put():
    solid = together(box((10.0, 10.0, 10.0), (16.0, 16.0, 16.0)), inverted(ball(1.0, (12.0, 13.0, 14.5))))
    found = porosity(voxelise(solid, box((10.0, 10.0, 10.0), (16.0, 16.0, 16.0)), 0.1))
    assert found.voids[0].place == pytest.approx([12.0, 13.0, 14.5], abs=0.02)
    assert found.voids[0].volume == pytest.approx(volume_of(ball(1.0)), rel=0.02)
