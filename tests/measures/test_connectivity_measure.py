"""Loops, pieces and cavities of bodies that show how many they have."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import euler_number as counted_by_skimage

from scaffold_stages._kernels import solids
from scaffold_stages._kernels.tpms import gyroid
from scaffold_stages._measures.connectivity import Connectivity, connectivity, euler_number
from scaffold_stages._measures.image import OUTSIDE, PORE, STRUT, VoxelImage
from shapes import ball, box, inverted, together


def image_of(struts: np.ndarray) -> VoxelImage:
    phases = np.pad(np.where(struts, STRUT, PORE).astype(np.uint8), 1, constant_values=OUTSIDE)
    return VoxelImage(phases, np.zeros(3), 1.0)


def frame(holes: int):
    """Return a bar with square holes through it."""
    bar = solids.to_body(*box((0.0, 0.0, 0.0), (4.0 * holes + 1.0, 5.0, 2.0)), "bar")
    for hole in range(holes):
        bar -= solids.to_body(*box((4.0 * hole + 1.0, 1.0, -1.0), (4.0 * hole + 4.0, 4.0, 3.0)), "hole")
    return solids.from_body(bar)


@pytest.mark.parametrize("holes", [0, 1, 3])
def test_each_hole_is_a_loop(holes: int):
    assert connectivity(*frame(holes)) == Connectivity(pieces=1, cavities=0, loops=holes)


def test_pieces_and_cavities_are_told_apart():
    body = together(ball(3.0), inverted(ball(2.0)), ball(1.0), box((5.0, 0.0, 0.0), (6.0, 1.0, 1.0)))
    found = connectivity(*body)
    assert found == Connectivity(pieces=3, cavities=1, loops=0)
    assert found.euler_number == 4


def test_connectivity_density_is_the_loops_of_one_piece_in_the_total_volume():
    assert connectivity(*frame(3)).density(60.0) == pytest.approx(0.05)
    assert connectivity(*ball(3.0)).density(60.0) == 0.0


def test_a_piece_apart_lowers_the_density():
    apart = together(frame(3), ball(1.0, (0.0, 0.0, 9.0)))
    assert connectivity(*apart).density(1.0) == 2.0
    assert connectivity(*apart).loops == 3


def test_boxes_that_touch_in_a_corner_are_two_pieces():
    vertices, faces = together(box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), box((1.0, 1.0, 1.0), (2.0, 2.0, 2.0)))
    faces = np.where(faces == 8, 7, faces)  # the corner that both have
    assert (vertices[7] == vertices[8]).all()
    assert connectivity(vertices, faces) == Connectivity(pieces=2, cavities=0, loops=0)


def test_an_open_or_a_non_manifold_surface_has_none():
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert connectivity(vertices, faces[1:]) is None
    assert connectivity(vertices, np.concatenate([faces, faces[:1]])) is None
    assert connectivity(vertices, faces[:0]) is None


def test_voxels_that_share_a_corner_hang_together():
    corner = np.zeros((2, 2, 2), bool)
    corner[0, 0, 0] = corner[1, 1, 1] = True
    assert euler_number(image_of(corner)) == 1
    apart = np.zeros((3, 1, 1), bool)
    apart[[0, 2]] = True
    assert euler_number(image_of(apart)) == 2


def test_a_ring_of_voxels_has_number_0_and_a_shell_2():
    ring = np.ones((3, 3, 1), bool)
    ring[1, 1] = False
    shell = np.ones((3, 3, 3), bool)
    shell[1, 1, 1] = False
    assert euler_number(image_of(ring)) == 0
    assert euler_number(image_of(shell)) == 2


@pytest.mark.parametrize("length", [3, 14, 15, 16, 37])
def test_voxels_are_counted_as_scikit_image_does_across_slabs(length: int):
    struts = np.random.default_rng(length).random((length, 6, 7)) < 0.4
    assert euler_number(image_of(struts)) == counted_by_skimage(struts, connectivity=3)


def test_voxels_and_the_surface_of_a_gyroid_agree():
    from skimage.measure import marching_cubes

    phase = np.linspace(0.0, 4.0 * np.pi, 40)
    solid = np.pad(gyroid(phase[:, None, None], phase[:, None], phase) - 0.3, 1, constant_values=-1.0)
    vertices, faces, _, _ = marching_cubes(solid, 0.0, method="lorensen", gradient_direction="ascent")
    found = connectivity(vertices.astype(float), faces.astype(np.int64))
    assert found.loops > 10
    assert found.euler_number == euler_number(VoxelImage((1 + (solid > 0.0)).astype(np.uint8), np.zeros(3), 1.0))
