"""Voxels are of the phase in which their middles lie, also where surfaces pass through middles exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
import pyvista

from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT
from scaffold_geometry.voxels.voxelising import finest_spacing, voxelise
from scaffold_pipeline.errors import StageError
from shapes import Surface, ball, box, inverted, together, volume_of

ROOM = box((-6.0, -6.0, -6.0), (6.0, 6.0, 6.0))


def middles(image):
    return image.origin + image.spacing * np.moveaxis(np.indices(image.phases.shape), 0, -1)


def turned(surface: Surface, seed: int = 5) -> Surface:
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    rotation[:, 0] *= np.linalg.det(rotation)
    return surface[0] @ rotation.T, surface[1]


def inside_by_vtk(vertices, faces, origin, spacing: float, shape) -> np.ndarray:
    """Return which samples lie inside a closed surface, by VTK's scan-line stencil."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(pyvista.PolyData.from_regular_faces(vertices - origin, faces))
    stencil.SetOutputSpacing(spacing, spacing, spacing)
    stencil.SetOutputWholeExtent(0, shape[0] - 1, 0, shape[1] - 1, 0, shape[2] - 1)
    stencil.SetTolerance(0.0)
    image = vtkImageStencilToImage()
    image.SetInputConnection(stencil.GetOutputPort())
    image.SetOutputScalarTypeToUnsignedChar()
    image.SetInsideValue(1)
    image.SetOutsideValue(0)
    image.Update()
    return vtk_to_numpy(image.GetOutput().GetPointData().GetScalars()).reshape(shape, order="F") == 1


def strut_volume(solid: Surface, outer: Surface, spacing: float) -> float:
    return voxelise(solid, outer, spacing).is_phase(STRUT).sum() * spacing**3


def around_samples(spacing: float) -> Surface:
    """Return a box whose image has voxels with their middles at whole multiples of the spacing."""
    low, high = (6 + 0.5) * spacing, (9 + 0.5) * spacing
    return box((-low, -low, -low), (high, high, high))


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (20_000.0, -20_000.0, 5_000.0)], ids=["here", "20 m away"])
def test_a_box_off_the_grid_has_the_voxels_within_its_bounds_on_each_axis(offset):
    low, high = np.array([-1.01, -2.03, -4.11]), np.array([3.0, 2.2, 5.3])
    solid, outer = box(tuple(low), tuple(high)), ROOM
    image = voxelise((solid[0] + offset, solid[1]), (outer[0] + offset, outer[1]), 0.37)
    where = middles(image) - offset
    expected = ((where > low) & (where < high)).all(axis=-1)
    assert np.array_equal(image.is_phase(STRUT), expected)
    assert not np.array_equal(image.is_phase(STRUT), expected.transpose(1, 0, 2))  # mixed-up axes would show


def test_a_ball_has_the_voxels_nearer_than_its_radius():
    image = voxelise(ball(5.0, (0.3, -0.2, 0.1), 5), ROOM, 0.3)
    depth = 5.0 - np.linalg.norm(middles(image) - (0.3, -0.2, 0.1), axis=-1)
    is_clear = np.abs(depth) > 0.01  # the sagitta of its facets
    assert is_clear.mean() > 0.99
    assert np.array_equal(image.is_phase(STRUT)[is_clear], depth[is_clear] > 0.0)


def test_the_volume_of_a_ball_converges_with_the_voxels():
    solid = ball(5.0, (0.31, -0.17, 0.11), 5)
    errors = [abs(strut_volume(solid, ROOM, spacing) / volume_of(solid) - 1.0) for spacing in (1.0, 0.5, 0.1)]
    assert errors[0] > 1e-3  # what this would not do with voxels alone that do not sample the ball
    assert errors[2] < errors[0] / 10.0
    assert errors[2] < 1e-4


@pytest.mark.parametrize("spacing", [1.0, 0.5, 0.25])
def test_a_box_with_its_faces_through_the_middles_of_voxels_has_its_own_volume(spacing: float):
    solid, outer = box((0.0, 0.0, 0.0), (2.0, 3.0, 4.0)), around_samples(1.0)
    image = voxelise(solid, around_samples(spacing) if spacing == 1.0 else outer, spacing)
    where = middles(image)
    closed = ((where >= 0.0) & (where <= [2.0, 3.0, 4.0])).all(axis=-1).sum() * spacing**3
    assert image.is_phase(STRUT).sum() * spacing**3 == pytest.approx(24.0, rel=1e-12)
    if spacing == 1.0:
        assert closed == 60.0  # what a rule that takes both ends in makes of it


def parts_of_room(solid: Surface, room: Surface, spacing: float):
    """Return how often each voxel of a room is in the solid or in what is left of the room without it."""
    image = voxelise(solid, room, spacing)
    rest = voxelise(together(room, inverted(solid)), room, spacing)
    return image.is_phase(STRUT).astype(int) + rest.is_phase(STRUT), image


@pytest.mark.parametrize("divisions", [0, 1, 3])
@pytest.mark.parametrize("make", [lambda surface: surface, turned], ids=["corners on voxels", "turned"])
def test_a_body_and_what_surrounds_it_share_no_voxel_and_miss_none(divisions: int, make):
    counts, image = parts_of_room(make(ball(3.0, divisions=divisions)), around_samples(1.0), 1.0)
    assert (counts[image.phases != OUTSIDE] == 1).all()


def test_that_check_finds_a_rule_that_takes_corners_on_voxels_twice():
    _, image = parts_of_room(ball(3.0, divisions=0), around_samples(1.0), 1.0)
    reach = np.abs(middles(image)).sum(axis=-1)
    counts = (reach <= 3.0).astype(int) + (reach >= 3.0)
    assert (counts[image.phases != OUTSIDE] != 1).any()


def test_the_stencil_of_vtk_finds_the_same_but_for_middles_on_the_surface():
    solid = turned(ball(4.0, (0.2, 0.1, -0.3), 4))
    image = voxelise(solid, ROOM, 0.4)
    assert np.array_equal(inside_by_vtk(*solid, image.origin, 0.4, image.phases.shape), image.is_phase(STRUT))


def test_a_solid_is_cut_to_its_outer_shape_and_the_rest_of_that_is_pore():
    image = voxelise(box((-9.0, -1.0, -1.0), (9.0, 1.0, 1.0)), ball(4.0), 0.5)
    radius = np.linalg.norm(middles(image), axis=-1)
    assert (image.phases[radius > 4.01] == OUTSIDE).all()
    assert set(np.unique(image.phases[radius < 3.9])) == {PORE, STRUT}
    assert (image.phases[radius < 0.9] == STRUT).all()


def test_the_outermost_layer_is_outside_also_where_the_shape_is_whole_voxels_long():
    for size in (2.0, 2.2):
        image = voxelise(ball(0.7), box((0.0, 0.0, 0.0), (size, size, size)), 0.5)
        is_within = image.phases != OUTSIDE
        assert is_within.sum() == is_within[1:-1, 1:-1, 1:-1].sum() == round(size / 0.5 + 0.4) ** 3


def test_the_hole_of_a_shell_is_pore_and_overlapping_bodies_are_united():
    shell = together(ball(5.0), inverted(ball(3.0)))
    radius = np.linalg.norm(middles(image := voxelise(shell, ROOM, 0.5)), axis=-1)
    assert (image.phases[radius < 2.8] == PORE).all()
    assert (image.phases[(radius > 3.1) & (radius < 4.8)] == STRUT).all()
    twice = together(box((-2.0, -1.0, -1.0), (1.0, 1.0, 1.0)), box((-1.0, -1.0, -1.0), (2.0, 1.0, 1.0)))
    assert strut_volume(twice, ROOM, 0.2) == pytest.approx(strut_volume(box((-2, -1, -1), (2, 1, 1)), ROOM, 0.2))


def test_an_open_surface_is_refused_by_name_and_place():
    vertices, faces = ball(5.0)
    faces = faces[vertices[faces][:, :, 2].max(axis=1) < 4.9]
    with pytest.raises(StageError, match=r"surface of the solid is not closed: the line at x .* repair it"):
        voxelise((vertices, faces), ROOM, 0.1)
    with pytest.raises(StageError, match="surface of the outer shape is not closed"):
        voxelise(ball(1.0), (vertices, faces), 0.1)


@pytest.mark.parametrize("spacing", [0.0, -1.0, math.nan])
def test_voxels_without_an_edge_are_refused(spacing: float):
    with pytest.raises(StageError, match="must be above 0"):
        voxelise(ball(1.0), ROOM, spacing)


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (40.0, 20.0, 60.0), (100.0, 100.0, 0.5), (1e-3, 2e-3, 1e-3)])
def test_the_finest_spacing_makes_as_many_voxels_as_are_allowed_and_few_less(size):
    bounds = np.array([(0.0, 0.0, 0.0), size])
    spacing = finest_spacing(bounds, 1e6)
    image = voxelise(box((0.0, 0.0, 0.0), size), box((0.0, 0.0, 0.0), size), spacing)
    assert 0.9e6 < image.phases.size <= 1e6
