"""The local thickness is the greatest ball over each voxel."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.measures.voxel_images import blobs, gyroid, image_of, places, squared, thickness_oracle
from scaffold_geometry.measures import balls
from scaffold_geometry.measures import local_thickness as measure
from scaffold_geometry.measures.local_thickness import local_thickness
from scaffold_geometry.voxels.image import PORE, STRUT, VoxelImage
from scaffold_geometry.voxels.voxelising import voxelise
from shapes import ball, box, together

SHAPES = {"gyroid": gyroid(32, 0.3), "blobs": blobs(28, 0.5, seed=3), "full": np.ones((9, 7, 8), bool)}


def round_about(shape, middle, radius: float):
    return np.linalg.norm(places(shape) - middle, axis=-1) < radius


@pytest.mark.parametrize("mask", SHAPES.values(), ids=SHAPES)
def test_the_map_is_that_of_openings_by_balls_of_every_size(mask):
    exact = 2.0 * np.sqrt(thickness_oracle(mask))
    assert local_thickness(mask, 1.0) == pytest.approx(exact, rel=1e-6)
    depth = 2.0 * np.sqrt(squared(np.pad(mask, 1))[1:-1, 1:-1, 1:-1])
    assert np.abs(depth - exact).max() > 2.0  # the distance alone is no thickness


@pytest.mark.parametrize("mask", [gyroid(40, 0.3), blobs(40, 0.6, seed=5)], ids=["gyroid", "blobs"])
def test_the_map_is_that_of_porespy_at_every_size(mask, porespy):
    depth = np.sqrt(squared(np.pad(mask, 1))[1:-1, 1:-1, 1:-1]).astype(np.float32)  # as its own distances are
    theirs = 2.0 * porespy.filters.local_thickness(mask, dt=depth, method="legacy", sizes=np.unique(depth[mask]))
    ours = local_thickness(mask, 1.0)
    assert np.abs(ours - theirs)[mask].max() < 1e-5
    few = 2.0 * porespy.filters.local_thickness(mask, dt=depth, method="legacy", sizes=10)
    assert np.abs(ours - few)[mask].max() > 0.5  # sizes tried from a list


@pytest.mark.parametrize(("voxels", "diameter"), [(3, 4.0), (4, 4.0), (7, 8.0), (10, 10.0)])
def test_a_wall_along_the_grid_is_as_thick_as_its_voxels_or_one_more(voxels: int, diameter: float):
    wall = np.zeros((30, 30, voxels + 4), bool)
    wall[:, :, 2:-2] = True
    assert local_thickness(wall, 0.25)[8:-8, 8:-8, 2:-2] == pytest.approx(0.25 * diameter)


@pytest.mark.parametrize("diameter", [6.0, 12.3, 18.0])
@pytest.mark.parametrize("count", [22, 23], ids=["about a corner of voxels", "about a middle"])
def test_a_ball_is_as_thick_as_its_diameter_but_for_what_the_docstring_says(diameter: float, count: int):
    mask = round_about((count,) * 3, (0.0, 0.0, 0.0), diameter / 2.0)
    thickness = local_thickness(mask, 1.0)[mask]
    assert -1.75 < thickness.mean() - diameter < 1.0
    assert np.median(thickness) - thickness.mean() < 0.1
    assert 2.0 * np.sqrt(squared(mask)[mask]).mean() < diameter - 1.75


@pytest.mark.parametrize(("shape", "low", "high"), [("plate", 0.0, 0.8), ("rod", -0.7, 0.1)])
def test_plates_and_rods_askew_are_as_thick_as_the_docstring_says(shape: str, low: float, high: float):
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(6):
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        where = places((30, 30, 30)) + rng.uniform(-0.5, 0.5, 3)
        height = where @ along
        off = np.abs(height) if shape == "plate" else np.linalg.norm(where - height[..., None] * along, axis=-1)
        is_middle = (np.abs(where) < 7.0).all(axis=-1) & (off < 4.0)
        errors.append(local_thickness(off < 4.0, 1.0)[is_middle].mean() - 8.0)
    assert low < np.mean(errors) < high
    assert np.abs(errors).max() < 1.0


@pytest.mark.parametrize("most", [3e5, 1e4])
def test_balls_on_larger_voxels_give_no_voxel_too_little_and_few_too_much(most: float, monkeypatch):
    mask = round_about((40, 40, 40), (-7.0, 0.0, 0.0), 12.0) | round_about((40, 40, 40), (9.0, 2.0, 1.0), 7.0)
    exact = local_thickness(mask, 1.0)
    monkeypatch.setattr(balls, "MOST_PAINTED", most)
    rough = local_thickness(mask, 1.0)
    assert (rough != exact).any()
    assert ((rough > 0.0) == mask).all()
    assert (rough >= exact - 1e-4)[mask].all()
    assert rough[mask].mean() == pytest.approx(exact[mask].mean(), rel=0.05)


def test_a_ball_is_held_by_a_neighbours_as_the_table_says():
    table = balls.containment_table(40)
    offsets = np.moveaxis(np.indices((19, 19, 19)), 0, -1).reshape(-1, 3) - 9
    reach = (offsets**2).sum(axis=1)
    for steps, shift in ((1, (1, 0, 0)), (2, (1, 1, 0)), (3, (1, 1, 1))):
        moved = ((offsets - shift) ** 2).sum(axis=1)
        for own in range(1, 41):
            assert table[steps, own] == moved[reach < own].max() + 1


def test_the_distribution_is_that_of_two_plates_by_their_volumes():
    mask = np.zeros((40, 40, 24), bool)
    mask[:, :, 2:6] = mask[:, :, 10:20] = True
    image = VoxelImage(np.where(mask, STRUT, PORE).astype(np.uint8), np.zeros(3), 0.5)
    thickness = np.where(mask, np.where(np.arange(24) < 8, 2.0, 5.0), 0.0).astype(np.float32)
    found = measure.distribution(image, STRUT, thickness)
    assert found.mean == pytest.approx((4 * 2.0 + 10 * 5.0) / 14)
    assert (found.median, found.deviation) == (pytest.approx(5.0), 0.0)
    assert found.percentiles == pytest.approx([2.0, 2.0, 5.0, 5.0])
    assert found.shares.sum() == pytest.approx(1.0)
    assert found.shares[found.shares > 0] == pytest.approx([4 / 14, 10 / 14])
    low = found.edges[np.flatnonzero(found.shares)]
    assert ((low <= [2.0, 5.0]) & (low + 0.5 + 1e-6 > [2.0, 5.0])).all()


def test_edges_have_at_most_forty_bars_and_none_narrower_than_a_voxel():
    for greatest in (0.3, 7.9, 8.0, 100.0):
        edges = measure.histogram_edges(greatest, 0.2)
        assert edges[0] == 0.0
        assert edges[-1] > greatest
        assert len(edges) <= 42
        assert np.diff(edges).min() >= 0.2 - 1e-12


def test_a_phase_without_voxels_has_no_distribution():
    image = image_of(np.ones((4, 4, 4), bool))
    assert measure.distribution(image, PORE, local_thickness(image.is_phase(PORE), 1.0)) is None


def test_pores_end_at_the_outer_shape():
    slot = np.ones((20, 20, 20), bool)
    slot[:, :, 7:13] = False
    image = image_of(slot)
    pores = local_thickness(image.is_phase(PORE), 1.0)
    assert pores.max() == 6.0
    room = np.pad(image.phases, 20)
    assert local_thickness(room != STRUT, 1.0).max() > 20.0  # the room around it, which goes on as far as the array


def test_vertices_have_the_thickness_of_the_strut_beneath_them():
    thick, thin = ball(3.0, (-4.0, 0.0, 0.0)), ball(1.0, (4.0, 0.0, 0.0))
    solid = together(thick, thin)
    image = voxelise(solid, box((-8.0, -4.0, -4.0), (8.0, 4.0, 4.0)), 0.2)
    thickness = local_thickness(image.is_phase(STRUT), 0.2)
    values = measure.thickness_at(image, thickness, solid[0])
    at_thick, at_thin = np.split(values, [len(thick[0])])
    assert (np.median(at_thick), np.median(at_thin)) == pytest.approx((6.0, 2.0), abs=0.4)
    assert (at_thick.min(), at_thin.min()) == pytest.approx((6.0, 2.0), abs=1.0)
    assert measure.thickness_at(image, thickness, np.array([(0.0, 0.0, 0.0), (99.0, 0.0, 0.0)])) == pytest.approx(0.0)


def test_walls_of_three_voxels_are_resolved_and_thinner_ones_are_not():
    assert measure.is_resolved(0.61, 0.2)
    assert not measure.is_resolved(0.59, 0.2)
