"""The largest box in a shape, against every box there is, and where the shape is too large to try them all."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from scaffold_geometry.measures import inscribed_box as module
from scaffold_geometry.measures.cuboids import largest_cuboid
from scaffold_geometry.measures.inscribed_box import inscribed_box
from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT, VoxelImage


def image_of(inside: np.ndarray) -> VoxelImage:
    return VoxelImage(np.where(inside, PORE, OUTSIDE).astype(np.uint8), np.array([10.0, 0.0, 0.0]), 0.5)


def in_box(first: np.ndarray, end: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(*ends) for ends in zip(first, end, strict=True))


def most_voxels(inside: np.ndarray) -> int:
    ranges = [list(combinations(range(length + 1), 2)) for length in inside.shape]
    boxes = (tuple(slice(*ends) for ends in box) for box in product(*ranges))
    return max((inside[box].size for box in boxes if inside[box].all()), default=0)


@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
def test_no_box_is_larger_than_the_largest(share: float):
    rng = np.random.default_rng(5)
    for shape in ((4, 5, 3), (1, 6, 4), (3, 1, 5)):
        inside = rng.random(shape) < share
        first, end = largest_cuboid(inside)
        assert inside[in_box(first, end)].all()
        assert np.prod(end - first) == most_voxels(inside)


def test_a_box_in_the_shape_of_an_l_lies_along_the_longer_leg():
    inside = np.zeros((12, 12, 6), bool)
    inside[1:11, 1:4, 1:5] = True
    inside[1:4, 1:9, 1:5] = True
    box = inscribed_box(image_of(inside))
    np.testing.assert_array_equal(box.first, [1, 1, 1])
    np.testing.assert_array_equal(box.end, [11, 4, 5])
    assert box.share == pytest.approx(120 / inside.sum())


def test_bounds_are_the_outer_faces_of_the_outermost_voxels():
    inside = np.zeros((5, 5, 5), bool)
    inside[1:4, 1:4, 1:3] = True
    image = image_of(inside)
    np.testing.assert_allclose(inscribed_box(image).bounds(image), [[10.25, 0.25, 0.25], [11.75, 1.75, 1.25]])


def test_struts_are_inside_as_pores_are():
    phases = np.full((6, 6, 6), OUTSIDE, np.uint8)
    phases[1:5, 1:5, 1:5] = PORE
    phases[2, 1:5, 1:5] = STRUT
    np.testing.assert_array_equal(inscribed_box(VoxelImage(phases, np.zeros(3), 1.0)).sides, [4, 4, 4])


def test_the_box_in_a_ball_is_a_cube_and_blocks_cost_little(monkeypatch: pytest.MonkeyPatch):
    x = np.arange(62) - 30.5
    image = image_of(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2 < 30.0**2)
    exact = inscribed_box(image)
    monkeypatch.setattr(module, "_BLOCKS", 16)
    grown = inscribed_box(image)
    assert np.ptp(exact.sides) <= 2
    assert 0.9 * exact.share < grown.share <= exact.share
    assert (image.phases[in_box(grown.first, grown.end)] == PORE).all()
    for axis, side in product(range(3), (0, 1)):
        first, end = grown.first.copy(), grown.end.copy()
        (first if side == 0 else end)[axis] += 2 * side - 1
        assert (image.phases[in_box(first, end)] != PORE).any()


def test_a_shape_thinner_than_a_block_still_has_a_box(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "_BLOCKS", 4)
    inside = np.zeros((16, 16, 16), bool)
    inside[5, 2:14, 3:9] = True
    np.testing.assert_array_equal(inscribed_box(image_of(inside)).sides, [1, 12, 6])


def test_an_empty_image_has_no_box():
    assert inscribed_box(image_of(np.zeros((4, 4, 4), bool))) is None
