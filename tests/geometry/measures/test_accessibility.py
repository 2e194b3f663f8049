"""A ball from outside reaches what it covers on its way, and throats are where the widest way is narrowest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import label

from geometry.measures.voxel_images import access_oracle, blobs, gyroid, image_of, thickness_oracle
from scaffold_geometry.measures.accessibility import accessibility, reachable_share
from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT, VoxelImage

STRUTS = {"gyroid": gyroid(32, 0.3), "blobs": blobs(30, 0.45, seed=3), "dense blobs": blobs(30, 0.7, seed=4)}


def bottle(*necks: tuple[int, int, int], room: int = 20):
    """Return a block with a chamber of `room`^3 voxels and square channels to it: width, axis and side of each."""
    size = room + 20
    is_strut = np.ones((size,) * 3, bool)
    is_strut[10:-10, 10:-10, 10:-10] = False
    for width, axis, side in necks:
        low = (size - width) // 2
        along = [slice(low, low + width)] * 3
        along[axis] = slice(0, 10) if side == 0 else slice(size - 10, size)
        is_strut[tuple(along)] = False
    return is_strut


def shares_of(reached, diameters):
    return np.array([(reached >= (diameter / 2.0) ** 2 - 1e-6).mean() for diameter in diameters])


@pytest.mark.parametrize("is_strut", STRUTS.values(), ids=STRUTS)
def test_the_curve_is_that_of_openings_with_balls_of_every_size(is_strut):
    image = image_of(is_strut)
    found = accessibility(image)
    reached = access_oracle(image.phases)[image.is_phase(PORE)]
    assert found.shares == pytest.approx(shares_of(reached, found.diameters), abs=1e-12)
    assert found.diameters == pytest.approx(2.0 * np.sqrt(np.unique(reached[reached > 0])))
    assert (np.diff(found.shares) < 0.0).all()
    openings = thickness_oracle(image.phases != STRUT)[image.is_phase(PORE)]
    assert np.abs(found.shares - shares_of(openings, found.diameters)).max() > 0.05  # with any way in or none


@pytest.mark.parametrize("is_strut", STRUTS.values(), ids=STRUTS)
def test_that_oracle_is_porespys_porosimetry_where_radii_are_whole_and_ways_cross_faces(is_strut, porespy):
    reached = access_oracle(image_of(is_strut).phases, 1, whole_radii=True)[1:-1, 1:-1, 1:-1]
    theirs = porespy.filters.porosimetry(~is_strut, method="dt", smooth=True, sizes=np.arange(1, 20))
    theirs[theirs < 0] = 0
    assert np.array_equal(np.sqrt(reached[~is_strut]), theirs[~is_strut])


def test_a_chamber_is_reached_by_what_passes_its_channel_and_by_nothing_greater():
    image = image_of(bottle((6, 2, 0)), spacing=0.5)
    found = accessibility(image)
    chamber = 20**3 / (20**3 + 6 * 6 * 10)
    assert reachable_share(found, [2.9, 3.0]) == pytest.approx([0.99, 0.99], abs=0.01)
    assert reachable_share(found, [3.1]) == pytest.approx([0.0], abs=0.01)
    openings = thickness_oracle(image.phases == PORE)[image.is_phase(PORE)]
    assert shares_of(openings, [6.2])[0] > 0.95 * chamber  # what the same balls cover that do not come from outside
    half = found.throats[0]
    assert (half.share, half.diameter) == (0.5, pytest.approx(3.0))
    assert half.place == pytest.approx([10.25, 10.25, 2.75], abs=2.3)  # in the channel, 0.5 to 5 mm along z


def test_of_two_ways_in_the_wider_one_is_the_throat():
    found = accessibility(image_of(bottle((4, 0, 0), (8, 1, 1))))
    assert found.throats[0].diameter == pytest.approx(8.0)
    assert found.throats[0].place[1] > 30.0


def test_a_channel_askew_lets_a_ball_of_its_diameter_through_but_for_a_voxel():
    is_strut = bottle((0, 0, 0))
    along = np.array([0.6, 0.64, 0.48])
    where = np.moveaxis(np.indices(is_strut.shape), 0, -1) - (19.3, 19.6, 19.1)
    on_axis = where @ along
    is_strut &= ~((np.linalg.norm(where - on_axis[..., None] * along, axis=-1) < 4.5) & (on_axis > 0.0))
    assert accessibility(image_of(is_strut)).throats[0].diameter == pytest.approx(9.0, abs=1.0)


def test_the_axes_are_alike():
    is_strut = blobs(24, 0.5, seed=9)[:, :20, :16]
    found = accessibility(image_of(is_strut))
    turned = accessibility(image_of(is_strut.transpose(2, 0, 1)))
    assert np.array_equal(found.diameters, turned.diameters)
    assert np.array_equal(found.shares, turned.shares)


def test_the_least_ball_reaches_the_open_porosity():
    image = image_of(blobs(40, 0.82, seed=2))
    pieces, _ = label(~image.is_phase(STRUT))
    is_pore = image.is_phase(PORE)
    is_open = is_pore & (pieces == pieces[0, 0, 0])
    found = accessibility(image)
    assert 0.5 < is_open.sum() / is_pore.sum() < 1.0
    assert found.diameters[0] == 2.0
    assert found.shares[0] == pytest.approx(is_open.sum() / is_pore.sum(), rel=1e-12)


@pytest.mark.parametrize("reach", [0.5, 0.9, 0.99])
def test_a_skinned_solid_lets_nothing_in(reach: float):
    skinned = gyroid(20, 0.0)
    for axis in range(3):
        np.moveaxis(skinned, axis, 0)[[0, -1]] = True
    found = accessibility(image_of(skinned), [reach])
    assert len(found.diameters) == len(found.shares) == 0
    assert reachable_share(found, [0.1, 1.0]) == pytest.approx([0.0, 0.0])
    assert found.throats[0] == (reach, 0.0, None)


def test_a_body_without_struts_lets_anything_in_and_one_without_pores_nothing():
    found = accessibility(image_of(np.zeros((5, 5, 5), bool)))
    assert found.shares == pytest.approx([1.0])
    assert found.diameters[0] >= 2.0 * np.sqrt(3.0) * 7.0
    assert len(accessibility(image_of(np.ones((5, 5, 5), bool))).shares) == 0


def test_a_cavity_of_the_outer_shape_is_no_way_in():
    phases = image_of(bottle()).phases
    phases[18:22, 18:22, 18:22] = OUTSIDE
    found = accessibility(VoxelImage(phases, np.zeros(3), 1.0))
    assert len(found.shares) == 0


def test_a_great_ball_that_only_dips_into_a_mouth_reaches_nothing():
    groove = np.ones((30, 30, 30), bool)
    groove[:, 9:21, 28:] = False
    found = accessibility(image_of(groove))
    assert found.diameters[-1] <= 6.0
