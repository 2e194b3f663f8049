"""A cubic lattice has its known struts, pores, windows and porosity, from its surface on."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from scaffold_geometry.measures.accessibility import accessibility, reachable_share
from scaffold_geometry.measures.local_thickness import distribution, local_thickness
from scaffold_geometry.surfaces.booleans import from_manifold, to_manifold
from scaffold_geometry.voxels.image import PORE, STRUT
from scaffold_geometry.voxels.voxelising import finest_spacing, voxelise
from shapes import box

CELL, WIDTH, CELLS = 2.4, 0.8, 3
SPACING = 0.1
LENGTH = CELL * CELLS + WIDTH


@pytest.fixture(scope="module")
def image():
    """Square struts along all edges of cubes, from corner to corner of the outer shape."""
    struts = []
    for axis, i, j in product(range(3), range(CELLS + 1), range(CELLS + 1)):
        low = np.insert([CELL * i, CELL * j], axis, 0.0)
        high = np.insert([CELL * i + WIDTH, CELL * j + WIDTH], axis, LENGTH)
        struts.append(to_manifold(*box(tuple(low), tuple(high)), "strut"))
    solid = struts[0]
    for strut in struts[1:]:
        solid += strut
    return voxelise(from_manifold(solid), box((0.0, 0.0, 0.0), (LENGTH, LENGTH, LENGTH)), SPACING)


def test_its_porosity_is_that_of_its_cell(image):
    lines, nodes = 3 * (CELLS + 1) ** 2, (CELLS + 1) ** 3
    solid = lines * LENGTH * WIDTH**2 - 2 * nodes * WIDTH**3
    assert image.is_phase(STRUT).sum() * SPACING**3 == pytest.approx(solid, rel=1e-12)
    assert image.is_phase(PORE).sum() * SPACING**3 == pytest.approx(LENGTH**3 - solid, rel=1e-12)


def test_its_struts_are_as_thick_as_they_are_wide(image):
    found = distribution(image, STRUT, local_thickness(image.is_phase(STRUT), SPACING))
    assert found.median == pytest.approx(WIDTH, abs=SPACING)


def test_its_pores_let_in_what_passes_their_windows(image):
    window = CELL - WIDTH
    found = accessibility(image)
    assert reachable_share(found, [window - 2 * SPACING])[0] > 0.9
    assert reachable_share(found, [window + 2 * SPACING])[0] < 0.1
    assert [throat.diameter for throat in found.throats[:2]] == pytest.approx([window, window], abs=1.5 * SPACING)


def test_its_pores_are_wider_than_their_windows(image):
    found = distribution(image, PORE, local_thickness(image.is_phase(PORE), SPACING))
    assert found.median > CELL - WIDTH + SPACING


def test_the_finest_spacing_has_the_image_within_its_bound():
    bounds = np.array([(0.0, 0.0, 0.0), (LENGTH, LENGTH, LENGTH)])
    spacing = finest_spacing(bounds, 40**3)
    assert voxelise(box((0, 0, 0), (1, 1, 1)), box((0, 0, 0), (LENGTH,) * 3), spacing).phases.size <= 40**3
