from __future__ import annotations

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.studies.memory_forecast import USUAL, expected_peak, grids_of

SHAPE = {"volume_mm3": 1000.0, "size_x": 10.0, "size_y": 20.0, "size_z": 30.0}
CHAIN = """
    stages:
      - use: make_shape
      - {use: tetrahedralise, cells: 500}
      - {use: arbf_field, voxel_size: 0.5}
      - {use: isosurface, porosity: 0.6}
      - use: clean_surface
      - use: intersect_outer
      - {use: measure, morphometry: true, voxel_size: 0.25}
    """


def test_the_voxels_of_fields_and_of_all_grids_are_counted(project: Project):
    given = CHAIN.replace("voxel_size: 0.5", "grid: {origin: [0, 0, 0], spacing: 0.2, shape: [9, 9, 9]}")
    assert grids_of(project.plan(CHAIN)) == (8.0, 64.0)
    assert grids_of(project.plan(given)) == pytest.approx((125.0, 125.0))
    assert grids_of(project.plan("stages: [{use: make_points}]")) == (0.0, 0.0)


def test_memory_grows_with_the_box_and_with_what_lies_inside(project: Project):
    grids = grids_of(project.plan(CHAIN))
    least = expected_peak(grids, {**SHAPE, "volume_mm3": 0.0, "size_x": 0.0})
    box = expected_peak(grids, {**SHAPE, "volume_mm3": 0.0}) - least
    inside = expected_peak(grids, {**SHAPE, "size_x": 0.0}) - least
    assert (least > 2**28, box > 0, inside > 0) == (True, True, True)
    assert expected_peak(grids, SHAPE) == least + box + inside
    assert expected_peak(grids._replace(any=2 * grids.any), SHAPE) == least + 2 * box + inside
    assert expected_peak(grids._replace(field=2 * grids.field), SHAPE) == least + box + 2 * inside


def test_a_mesh_whose_sides_are_not_told_is_taken_to_fill_a_third_of_its_box(project: Project):
    grids = grids_of(project.plan(CHAIN))
    assert expected_peak(grids, {"volume_mm3": 2000.0}) == expected_peak(grids, {**SHAPE, "volume_mm3": 2000.0})


@pytest.mark.parametrize("shape", [{}, {"volume_mm3": "none"}])
def test_what_is_not_known_is_taken_to_be_usual(project: Project, shape: dict[str, str]):
    assert expected_peak(grids_of(project.plan(CHAIN)), shape) == USUAL
    assert expected_peak(grids_of(project.plan("stages: [{use: make_points}]")), SHAPE) == USUAL
