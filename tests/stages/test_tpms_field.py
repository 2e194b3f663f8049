"""The stage's field in mm, and through the later stages to a solid: no mesh, no certificate."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.fields import sampling
from scaffold_geometry.fields.tpms import SURFACES
from scaffold_pipeline.artifacts import Metrics, OuterShape, ScalarField, Solid
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.intersect_outer import IntersectOuterParams, intersect_outer
from scaffold_stages.isosurface import IsosurfaceParams, isosurface
from scaffold_stages.measure import MeasureParams, measure
from scaffold_stages.tpms_field import TpmsFieldParams, tpms_field
from shapes import ball, box

CELL = 3.0
CUBE = OuterShape(*box((2.0, -1.0, 10.0), (8.0, 5.0, 16.0)))
"""Two cells along each axis."""


def params_of(**given: object) -> TpmsFieldParams:
    return TpmsFieldParams.model_validate({"surface": "gyroid", "cell_size": CELL, "voxel_size": 0.15, **given})


def field_of(outer: OuterShape = CUBE, **given: object) -> ScalarField:
    return tpms_field(outer, params=params_of(**given))


def values_at(tmp_path: Path, places: np.ndarray, outer: OuterShape = CUBE, **given: object) -> np.ndarray:
    """The field itself at places (n, 3) mm."""
    path = tmp_path / "points.csv"
    path.write_text("x,y,z\n" + "\n".join(",".join(map(repr, place)) for place in np.asarray(places).tolist()))
    return field_of(outer, points=path, **given).point_values


def solid_of(field: ScalarField, outer: OuterShape = CUBE, **given: object) -> tuple[Solid, Metrics]:
    """What the later stages make of a field, and what is measured on it."""
    porous = isosurface(field, outer, params=IsosurfaceParams.model_validate(given))
    solid = intersect_outer(porous, outer, params=IntersectOuterParams())
    return solid, measure(solid, outer, porous, field, params=MeasureParams())


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("tpms_field", tpms_field)
    assert declared.writes == "field"
    assert {name: read.optional for name, read in declared.reads.items()} == {"outer": False}


@pytest.mark.parametrize("surface", SURFACES)
def test_the_cell_size_is_the_period_of_the_field_in_mm(surface: str):
    field = field_of(surface=surface)
    step = round(CELL / field.spacing)
    inner = field.values[4:-4, 4:-4, 4:-4]
    for axis in range(3):
        line = np.moveaxis(inner, axis, 0)
        np.testing.assert_allclose(line[step:], line[:-step], rtol=0, atol=1e-5)
        assert np.abs(line[step // 2 :] - line[: -(step // 2)]).max() > 0.5
    assert field.certificate is None
    assert (field.facts["tpms"], field.facts["cell_size"]) == (f"{surface}, skeletal", CELL)


@pytest.mark.parametrize("surface", SURFACES)
def test_voxels_and_points_hold_the_formula_with_a_cell_at_the_corner_of_the_shape(surface: str, tmp_path: Path):
    places = np.random.default_rng(1).uniform((2, -1, 10), (8, 5, 16), (50, 3))
    phases = 2.0 * np.pi / CELL * (places - (2.0, -1.0, 10.0)).T
    np.testing.assert_allclose(values_at(tmp_path, places, surface=surface), SURFACES[surface](*phases), atol=1e-12)
    field = field_of(surface=surface)
    nodes = np.argwhere(np.ones_like(field.values))[::97]
    sampled = field.origin + field.spacing * nodes
    is_inside = ((sampled > CUBE.bounds[0]) & (sampled < CUBE.bounds[1])).all(axis=1)
    at_nodes = values_at(tmp_path, sampled[is_inside], surface=surface)
    np.testing.assert_allclose(field.values[tuple(nodes[is_inside].T)], at_nodes, rtol=0, atol=1e-6)


def test_an_origin_moves_the_cells_and_nothing_else():
    default, moved = field_of(), field_of(origin=(2.0 + 0.3, -1.0, 10.0 - CELL))
    inner = np.s_[4:-4, 4:-4, 4:-4]
    np.testing.assert_allclose(moved.values[inner][2:], default.values[inner][:-2], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(moved.origin, default.origin)


def test_samples_more_than_two_voxels_outside_are_void():
    outer = OuterShape(*ball(3.0))
    field = field_of(outer)
    distance = np.linalg.norm(field.origin + field.spacing * np.argwhere(np.ones_like(field.values)), axis=1) - 3.0
    values = field.values.ravel()
    assert (values[distance > 2.0 * np.sqrt(3.0) * field.spacing] == values.min()).all()
    assert len(np.unique(values[(distance > 0.0) & (distance < field.spacing)])) > 100


@pytest.mark.parametrize(
    ("surface", "porosity"), [("schwarz_p", 0.5), ("schwarz_d", 0.5), ("gyroid", 0.5), ("iwp", 0.4691)]
)
def test_whole_cells_at_iso_zero_are_half_pores_in_the_solid_but_for_iwp(surface: str, porosity: float):
    field = field_of(surface=surface, voxel_size=0.2)
    solid, metrics = solid_of(field, iso=0.0)
    assert 1.0 - solid.volume / CUBE.volume == pytest.approx(porosity, abs=2e-3)
    assert metrics.values["solid_pieces"] == 1
    assert metrics.values["pore_largest_fraction"] > 0.99 or surface == "schwarz_p"  # whose corners are cut off


def test_porosity_and_the_width_of_the_pores_grow_with_the_iso():
    field = field_of(surface="schwarz_p", voxel_size=0.3, origin=(2.0 + CELL / 2, -1.0 + CELL / 2, 10.0 + CELL / 2))
    porosities = [1.0 - solid_of(field, iso=iso)[0].volume / CUBE.volume for iso in (-0.6, -0.2, 0.2, 0.6)]
    assert (np.diff(porosities) > 0.05).all()


@pytest.mark.parametrize("level", [0.1, 0.5, 0.9])
def test_a_sheet_has_the_thickness_that_its_level_gives(level: float, tmp_path: Path):
    """Through a point of P, straight across: 3 sin(2 pi s / (sqrt(3) a)) = t at both faces of the sheet."""
    middle = CUBE.bounds[0] + CELL / 4.0
    half = np.sqrt(3.0) * CELL / (2.0 * np.pi) * np.arcsin(level / 3.0)
    places = middle + np.array([-1.0, -0.5, 0.0, 0.5, 1.0])[:, None] * half / np.sqrt(3.0)
    values = values_at(tmp_path, places, surface="schwarz_p", kind="sheet")
    np.testing.assert_allclose(values[[0, 4]], -level, atol=1e-12)
    assert values[2] == pytest.approx(0.0, abs=1e-12)
    assert (values[[1, 3]] > -level).all()


def test_a_sheet_parts_the_pores_into_two_networks_and_passes_the_gates_that_there_are():
    field = field_of(kind="sheet", voxel_size=0.2)
    _, metrics = solid_of(field, porosity=0.6)
    assert metrics.values["pore_largest_fraction"] == pytest.approx(0.5, abs=0.02)
    assert metrics.values["pore_networks_fraction"] > 0.99
    assert metrics.values["porosity"] == pytest.approx(0.6, abs=2e-3)
    assert metrics.failed_gates == ()
    assert [line.partition(":")[0] for line in metrics.values["gates_not_applied"]] == ["certificate", "interrupted"]


def test_a_sheet_thinner_than_the_voxels_show_fails_the_gate_of_its_networks():
    _, metrics = solid_of(field_of(kind="sheet", voxel_size=0.3), iso=-0.1)
    assert any("the sheet between them has holes" in gate for gate in metrics.failed_gates)


@pytest.mark.parametrize("kind", ["skeletal", "sheet"])
@pytest.mark.parametrize("surface", SURFACES)
def test_a_grading_gives_each_layer_of_cells_its_porosity_at_iso_zero(surface: str, kind: str):
    """Porosity is linear along the axis, so a layer as thick as a cell has about that of its middle."""
    tall = OuterShape(*box((0.0, 0.0, 5.0), (CELL, CELL, 5.0 + 8 * CELL)))
    field = field_of(tall, surface=surface, kind=kind, voxel_size=0.1, grading={"porosity": (0.5, 0.74)})
    inner = field.values[3:-4, 3:-4, 3:-4]  # whole periods along x and y
    void = (inner <= 0.0).mean(axis=(0, 1))
    step = round(CELL / field.spacing)
    for layer in range(8):
        porosity = void[layer * step : (layer + 1) * step].mean()
        assert porosity == pytest.approx(0.5 + 0.24 * (layer + 0.5) / 8, abs=0.015)


def test_a_grading_between_two_places_stays_as_it_is_beyond_them(tmp_path: Path):
    grading = {"axis": "x", "porosity": (0.7, 0.3), "between": (3.0, 6.0)}
    places = np.column_stack([np.linspace(2.0, 8.0, 61), np.full(61, 1.0), np.full(61, 12.0)])
    shift = values_at(tmp_path, places) - values_at(tmp_path, places, grading=grading)
    x = places[:, 0]
    assert max(np.ptp(shift[x <= 3.0]), np.ptp(shift[x >= 6.0])) < 1e-12
    assert (np.diff(shift[(x >= 3.0) & (x <= 6.0)]) < 0.0).all()
    assert shift[0] == pytest.approx(-shift[-1], abs=0.01)
    assert shift[np.isclose(x, 4.5)] == pytest.approx(0.0, abs=0.01)


def test_a_section_is_a_layer_of_the_field():
    grid = {"origin": (1.5, -1.5, 9.5), "spacing": 0.25, "shape": (29, 29, 29)}
    whole = field_of(grid=grid, voxel_size=None)
    with pytest.warns(UserWarning, match="does not cover"):
        section = field_of(grid={**grid, "origin": (1.5, -1.5, 12.0), "shape": (29, 29, 1)}, voxel_size=None)
    inner = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(section.values[inner][..., 0], whole.values[inner][..., 10], rtol=0, atol=1e-6)


def test_a_cell_larger_than_the_shape_is_refused_with_both_lengths():
    flat = OuterShape(*box((0.0, 0.0, 0.0), (20.0, 4.0, 20.0)))
    said = "cell_size 5 mm: must be at most the size of the outer shape, 4 mm along y; choose a third of that or less"
    with pytest.raises(StageError, match=f"^{re.escape(said)}$"):
        field_of(flat, cell_size=5.0)
    assert field_of(flat, cell_size=4.0).facts["cell_size"] == 4.0


def test_a_grid_beyond_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sampling, "available_memory", lambda: 100_000)
    with pytest.raises(StageError, match=r"^voxel_size 0\.15 mm: the grid needs"):
        field_of()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"surface": "schwarz_q"}, "surface\n.*'schwarz_p', 'schwarz_d', 'gyroid' or 'iwp'"),
        ({"kind": "solid"}, "kind\n.*'skeletal' or 'sheet'"),
        ({"cell_size": 0.0}, "cell_size\n.*greater than 0"),
        (
            {"voxel_size": 0.4},
            r"voxel_size: must be at most an eighth of cell_size \(0.375 mm\) to resolve the surface, got 0.4",
        ),
        (
            {"voxel_size": None, "grid": {"origin": (0, 0, 0), "spacing": 0.5, "shape": (9, 9, 9)}},
            "grid.spacing: must be at most an eighth of cell_size",
        ),
        ({"voxel_size": None}, "give either voxel_size or grid"),
        ({"grading": {"porosity": (0.5, 1.0)}}, "porosity.1\n.*less than 1"),
        ({"grading": {"porosity": (0.5, 0.6), "axis": "w"}}, "axis\n.*'x', 'y' or 'z'"),
        (
            {"grading": {"porosity": (0.5, 0.6), "between": (4.0, 4.0)}},
            r"between: must be \[low end, high end\] in ascending",
        ),
        ({"mesh": 1}, "mesh\n.*not permitted"),
    ],
)
def test_parameters_without_meaning_are_refused(given: dict[str, object], said: str):
    with pytest.raises(ValidationError, match=said):
        params_of(**given)
