"""Loops, pieces and cavities of bodies that show how many they have."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import euler_number as counted_by_skimage

from scaffold_geometry.fields.tpms import gyroid
from scaffold_geometry.measures.connectivity import Connectivity, connectivity
from scaffold_geometry.surfaces import booleans
from scaffold_geometry.surfaces.shells import shell_facts
from shapes import ball, box, inverted, together


def found_in(vertices: np.ndarray, faces: np.ndarray) -> Connectivity:
    facts = shell_facts(vertices, faces)
    assert facts["is_manifold"]
    return connectivity(faces, int(facts["solid_pieces"]), int(facts["closed_pores"]))


def frame(holes: int):
    """Return a bar with square holes through it."""
    bar = booleans.to_manifold(*box((0.0, 0.0, 0.0), (4.0 * holes + 1.0, 5.0, 2.0)), "bar")
    for hole in range(holes):
        bar -= booleans.to_manifold(*box((4.0 * hole + 1.0, 1.0, -1.0), (4.0 * hole + 4.0, 4.0, 3.0)), "hole")
    return booleans.from_manifold(bar)


@pytest.mark.parametrize("holes", [0, 1, 3])
def test_each_hole_is_a_loop(holes: int):
    assert found_in(*frame(holes)) == Connectivity(pieces=1, cavities=0, loops=holes)


def test_pieces_and_cavities_are_told_apart():
    body = together(ball(3.0), inverted(ball(2.0)), ball(1.0), box((5.0, 0.0, 0.0), (6.0, 1.0, 1.0)))
    found = found_in(*body)
    assert found == Connectivity(pieces=3, cavities=1, loops=0)
    assert found.euler_number == 4


def test_connectivity_density_is_the_loops_of_one_piece_in_the_total_volume():
    assert found_in(*frame(3)).density(60.0) == pytest.approx(0.05)
    assert found_in(*ball(3.0)).density(60.0) == 0.0


def test_a_piece_apart_lowers_the_density():
    apart = together(frame(3), ball(1.0, (0.0, 0.0, 9.0)))
    assert found_in(*apart).density(1.0) == 2.0
    assert found_in(*apart).loops == 3


def test_voxels_and_the_surface_of_a_gyroid_agree():
    from skimage.measure import marching_cubes

    phase = np.linspace(0.0, 4.0 * np.pi, 40)
    solid = np.pad(gyroid(phase[:, None, None], phase[:, None], phase) - 0.3, 1, constant_values=-1.0)
    vertices, faces, _, _ = marching_cubes(solid, 0.0, method="lorensen", gradient_direction="ascent")
    found = found_in(vertices.astype(float), faces.astype(np.int64))
    assert found.loops > 10
    assert found.euler_number == counted_by_skimage(solid > 0.0, connectivity=3)
