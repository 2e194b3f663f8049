"""Iso-surfaces are closed manifolds whatever the samples, outward on all axes, and converge to the shape."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from scaffold_geometry.surfaces import triangles
from scaffold_geometry.voxels import offset
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_geometry.voxels.offset import offset_inward
from shapes import ball, box, require_closed, samples_over, volume_of

ORIGIN = np.array([1.0, -2.0, 30.0])


def surface(values: np.ndarray, iso: float = 0.0, spacing: float = 0.4):
    return extract_iso_surface(np.asarray(values, np.float32), iso, ORIGIN, spacing)


def ellipsoid(spacing: float):
    """Samples of an ellipsoid about `ORIGIN + 5` whose half axes all differ."""
    places = spacing * np.moveaxis(np.indices([round(10.0 / spacing) + 1] * 3), 0, -1) - 5.0
    return 1.0 - np.linalg.norm(places / [2.0, 3.0, 4.5], axis=-1)


def test_the_check_fails_on_an_open_a_doubled_and_a_turned_surface():
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    turned = np.concatenate([faces[:1, ::-1], faces[1:]])
    for bad in (faces[1:], np.concatenate([faces, faces]), turned):
        with pytest.raises(AssertionError):
            require_closed(vertices, bad)
    for moved in (1, 2):  # two boxes that touch along an edge, and at a corner
        offset = np.array([1.0] * (moved + 1) + [0.0] * (2 - moved))
        both = np.concatenate([vertices, vertices + offset]), np.concatenate([faces, faces + 8])
        with pytest.raises(AssertionError):
            require_closed(*both)


def test_a_surface_has_its_extent_on_each_axis_and_points_outwards():
    vertices, faces = surface(ellipsoid(0.25), spacing=0.25)
    require_closed(vertices, faces)
    assert (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0 == pytest.approx(ORIGIN + 5.0, abs=1e-3)
    assert np.ptp(vertices, axis=0) == pytest.approx([4.0, 6.0, 9.0], abs=0.05)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), ((a + b + c) / 3.0 - ORIGIN - 5.0) / [4.0, 9.0, 20.25])
    assert (outward > 0.0).all()


def test_the_volume_converges_with_the_square_of_the_spacing():
    exact = 4.0 / 3.0 * np.pi * 2.0 * 3.0 * 4.5
    errors = [abs(volume_of(surface(ellipsoid(h), spacing=h)) / exact - 1.0) for h in (0.5, 0.25, 0.125)]
    assert errors[2] < 2e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.3)


def test_a_solid_that_reaches_the_end_of_the_grid_is_closed_there():
    values = np.full((4, 5, 6), 1.0) + 0.01 * np.random.default_rng(1).normal(size=(4, 5, 6))
    vertices, faces = surface(values, 0.5, 1.0)
    require_closed(vertices, faces)
    assert np.prod(np.array(values.shape) - 1) < volume_of((vertices, faces)) < np.prod(np.array(values.shape) + 1)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_cap_is_closed_whatever_the_scale_of_the_values(scale: float):
    values = scale * np.random.default_rng(2).normal(size=(6, 6, 6))
    require_closed(*surface(values))
    vertices, _ = surface(values)
    reference, _ = surface(values / scale)
    assert vertices == pytest.approx(reference, abs=1e-4)


def test_nothing_above_the_iso_has_no_surface():
    vertices, faces = surface(np.zeros((3, 4, 5)), 1.0)
    assert vertices.shape == faces.shape == (0, 3)


def test_what_equals_the_iso_is_void():
    vertices, faces = surface(np.ones((3, 3, 3)), 1.0)
    assert not len(faces)
    vertices, faces = surface(np.ones((3, 3, 3)), 0.999)
    require_closed(vertices, faces)


def planes(shape: tuple[int, int, int], _: np.random.Generator):
    return np.indices(shape)[1] % 3


def checkerboard(shape: tuple[int, int, int], _: np.random.Generator):
    return np.indices(shape).sum(axis=0) % 2


def integers(shape: tuple[int, int, int], rng: np.random.Generator):
    return rng.integers(0, 3, shape)


def noise(shape: tuple[int, int, int], rng: np.random.Generator):
    return 1.0 + rng.normal(size=shape)


@pytest.mark.parametrize("kind", [planes, checkerboard, integers, noise])
def test_every_edge_has_two_faces_however_many_samples_equal_the_iso(kind: object):
    for seed in range(150):
        rng = np.random.default_rng(seed)
        values = kind(tuple(rng.integers(2, 8, 3)), rng)
        for iso in (1.0, 0.5):
            vertices, faces = surface(values, iso)
            if (values > iso).any():
                require_closed(vertices, faces)
                assert not triangles.flat_faces(vertices, faces).any()
                assert volume_of((vertices, faces)) > 0.0
            else:
                assert not len(faces)


def test_the_nudge_moves_a_surface_by_less_than_a_hundredth_of_a_voxel():
    values = np.indices((6, 6, 6))[0].astype(float)
    vertices, _ = surface(values, 3.0, 1.0)
    inner = vertices[(np.abs(vertices - ORIGIN - 2.5) < 2.4).all(axis=1)]
    assert len(inner)
    assert np.abs(inner[:, 0] - ORIGIN[0] - 3.0).max() < 0.01


@pytest.mark.parametrize("depth", [0.2, 1.0, 2.5])
def test_the_inward_offset_of_a_ball_is_a_smaller_ball(depth: float):
    shape = ball(5.0, (20.0, 0.0, -3.0), 5)
    vertices, faces = offset_inward(*shape, depth)
    require_closed(vertices, faces)
    assert volume_of((vertices, faces)) == pytest.approx(4.0 / 3.0 * np.pi * (5.0 - depth) ** 3, rel=0.01)
    assert np.linalg.norm(vertices - [20.0, 0.0, -3.0], axis=1) == pytest.approx(5.0 - depth, abs=0.02)


def test_the_inward_offset_of_a_box_is_a_smaller_box():
    low, high = np.array([0.0, 1.0, 2.0]), np.array([6.0, 5.0, 10.0])
    shape = box(tuple(low), tuple(high))
    vertices, faces = offset_inward(*shape, 0.8)
    require_closed(vertices, faces)
    assert volume_of((vertices, faces)) == pytest.approx(np.prod(high - low - 1.6), rel=0.01)
    assert vertices.min(axis=0) == pytest.approx(low + 0.8, abs=0.01)
    assert vertices.max(axis=0) == pytest.approx(high - 0.8, abs=0.01)
    squared, _, _ = igl.point_mesh_squared_distance(vertices, *shape)
    assert np.sqrt(squared).min() > 0.79


def test_an_offset_of_less_than_a_voxel_lies_as_deep_as_asked(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(offset, "_FINEST", 60.0)
    monkeypatch.setattr(offset, "_COARSEST", 50.0)
    shape = ball(5.0, divisions=5)  # samples 0.29 apart
    vertices, _ = offset_inward(*shape, 0.05)
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(4.95, abs=0.01)


def test_an_offset_deeper_than_the_shape_leaves_nothing():
    vertices, faces = offset_inward(*box((0.0, 0.0, 0.0), (6.0, 4.0, 8.0)), 2.1)
    assert vertices.shape == faces.shape == (0, 3)
    assert len(offset_inward(*box((0.0, 0.0, 0.0), (6.0, 4.0, 8.0)), 1.9)[1])


def test_a_shape_with_a_notch_is_offset_from_the_notch_too():
    _, places = samples_over((0.0, 0.0, 0.0), (8.0, 8.0, 8.0), 0.5)
    solid = ((places > 0.2) & (places < 7.8)).all(axis=-1) & ~((places > 3.7).all(axis=-1))
    shape = surface(solid, 0.5, 0.5)
    vertices, faces = offset_inward(*shape, 1.0)
    require_closed(vertices, faces)
    squared, _, _ = igl.point_mesh_squared_distance(vertices, *shape)
    assert np.sqrt(squared) == pytest.approx(1.0, abs=0.1)
