"""Regions of a plane: areas converge, pixels are those inside, prisms are closed."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import points_in_poly

from scaffold_geometry.planar import regions
from scaffold_pipeline.artifacts import Polygons
from shapes import ball, box, planar_field, require_closed, squares, volume_of


def star(count: int = 40, seed: int = 1, scale: float = 1.0):
    rng = np.random.default_rng(seed)
    angles, radii = np.sort(rng.uniform(0.0, 2.0 * np.pi, count)), scale * rng.uniform(0.4, 1.0, count)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])


def region_of(values, half: float, spacing: float, iso: float = 0.0):
    field = planar_field(values, half, spacing)
    return regions.region_above(field.values[:, :, 0], iso, field.origin[:2], spacing)


def disc(x, y):
    return 3.0 - np.hypot(x - 0.123, y + 0.321)


def test_the_area_of_a_disc_converges():
    errors = [abs(region_of(disc, 3.5, spacing).area() - 9.0 * np.pi) for spacing in (0.4, 0.2, 0.1)]
    assert errors[0] < 0.005 * 9.0 * np.pi
    assert errors[1] < errors[0] / 2.5
    assert errors[2] < errors[1] / 2.5


def test_the_area_of_a_half_plane_cut_by_the_grid_is_exact_where_the_field_is_linear():
    region = region_of(lambda x, _: x - 0.217, 3.0, 0.1) ^ regions.to_region(
        [np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)]
    )
    assert region.area() == pytest.approx(2.0 * (1.0 - 0.217), abs=1e-6)


def test_a_ring_keeps_its_shape_to_its_left():
    rings = regions.rings_of(region_of(lambda x, y: 1.0 - np.abs(np.hypot(x, y) - 2.0), 3.5, 0.1))
    areas = Polygons.of(rings).areas
    assert sorted(np.sign(areas)) == [-1.0, 1.0]
    assert areas.sum() == pytest.approx(np.pi * (9.0 - 1.0), rel=1e-3)


@pytest.mark.parametrize("iso", [0.0, 0.5, 1.0])
def test_samples_that_equal_the_iso_make_no_lines_that_touch(iso: float):
    checks = region_of(
        lambda x, y: np.where((np.round(x) + np.round(y)) % 2 > 0, 1.0, 0.5 * (x > 0)), 3.0, 1.0, iso - 1e-9
    )
    for ring in regions.rings_of(checks):
        assert len(np.unique(ring, axis=0)) == len(ring)


def test_at_a_saddle_the_void_is_connected():
    two = region_of(lambda x, y: np.where(((x == 0) & (y == 0)) | ((x == 1) & (y == 1)), 1.0, -1.0), 3.0, 1.0)
    assert len(regions.pieces_of(two)) == 2


def test_pixels_are_filled_where_their_centre_is_inside():
    outer, hole = 40.0 * star() + [45.3, 50.1], 12.0 * star(seed=2) + [44.9, 51.2]
    grid = np.stack(np.meshgrid(np.arange(90), np.arange(100), indexing="ij"), -1).reshape(-1, 2)
    expected = points_in_poly(grid, outer) ^ points_in_poly(grid, hole)
    assert np.array_equal(regions.rasterise([outer, hole[::-1]], (90, 100)), expected.reshape(90, 100))


def test_what_of_a_ring_lies_beyond_the_pixels_is_not_drawn():
    around = np.array([(-50.0, -50.0), (50.0, -50.0), (50.0, 4.5), (-50.0, 4.5)])
    filled = regions.rasterise([around], (8, 10))
    assert filled[:, :5].all()
    assert not filled[:, 5:].any()


def test_the_outline_of_tiles_is_one_ring_without_needless_points():
    (ring,) = regions.rings_of(regions.outline_of(squares((5, 3), 2.0).vertices, squares((5, 3), 2.0).cells))
    assert {tuple(point) for point in ring} == {(-5.0, -3.0), (5.0, -3.0), (5.0, 3.0), (-5.0, 3.0)}


def test_a_frame_of_tiles_has_a_hole():
    mesh = squares((3, 3))
    frame = {"quadrangle": np.delete(mesh.quadrangles, 4, axis=0)}
    rings = Polygons.of(regions.rings_of(regions.outline_of(mesh.vertices, frame)))
    assert sorted(rings.areas) == pytest.approx([-1.0, 9.0])


def test_the_section_of_a_body_is_that_of_its_facets():
    assert regions.section_at(*box((0.0, 0.0, 0.0), (2.0, 3.0, 4.0)), 1.7).area() == pytest.approx(6.0)
    assert regions.section_at(*ball(5.0, divisions=6), 3.0).area() == pytest.approx(16.0 * np.pi, rel=2e-3)
    assert regions.section_at(*ball(5.0), 6.0).is_empty()


@pytest.mark.parametrize("place", [0.0, 500.0])
def test_a_prism_is_closed_outward_and_has_a_handle_for_each_hole(place: float):
    holes = [(0.2 * star(seed=seed) + at)[::-1] for seed, at in ((3, (0.0, 0.0)), (4, (-2.0, 1.0)), (5, (2.0, 2.0)))]
    rings = [ring + place for ring in (np.array([(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)]), *holes)]
    vertices, faces = regions.prism(rings, 1.0, 3.5)
    require_closed(vertices, faces)
    assert np.array_equal(vertices, vertices.astype(np.float32))
    assert volume_of((vertices, faces)) == pytest.approx(2.5 * Polygons.of(rings).area, rel=1e-5)
    edges = 3 * len(faces) // 2
    assert len(vertices) - edges + len(faces) == 2 - 2 * len(holes)


def test_points_that_fall_together_in_single_precision_are_one_in_a_prism():
    ring = np.array([(1000.0, 0.0), (1000.0 + 1e-6, 0.0), (1001.0, 0.0), (1001.0, 1.0)])
    speck = 1e-6 * star(5) + 2000.0
    vertices, faces = regions.prism([ring, speck], 0.0, 1.0)
    require_closed(vertices, faces)
    assert len(vertices) == 6
