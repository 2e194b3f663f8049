"""Hexahedra of a shape: whole cubes cover it, fitted ones end on it, and none is inverted."""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import cKDTree

from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.self_intersections import self_intersecting_faces
from scaffold_geometry.volumes import cells
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_geometry.volumes.hexahedra.quality import least_jacobians
from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import hexahedralise as module
from scaffold_stages.hexahedralise import HexahedraliseParams, hexahedralise
from scaffold_stages.load_surface import LoadSurfaceParams, load_surface
from scaffold_stages.make_shape import MakeShapeParams, make_shape
from shapes import ball, box, hexahedra, outer_of, together

BONES = Path(__file__).parents[3] / "shared" / "data" / "anatomy"
SHAPES = {
    "ball": ({"shape": "ball", "height": 10.0, "facet": 0.7}, 1.5, 0.96),
    "cylinder": ({"shape": "cylinder", "width": 8.0, "height": 10.0, "facet": 0.7}, 1.5, 0.96),
    "box": ({"shape": "box", "width": 10.0, "depth": 7.0, "height": 5.0, "facet": 2.0}, 1.0, 0.99),
    "femur": ({"shape": "femur", "height": 60.0, "facet": 2.0}, 3.0, 0.96),
}


def hexahedra_of(outer: OuterShape, cell_size: float, kind: str):
    return hexahedralise(outer, params=HexahedraliseParams.model_validate({"cell_size": cell_size, "kind": kind}))


def shape(name: str):
    return make_shape(params=MakeShapeParams.model_validate(SHAPES[name][0]))


@pytest.fixture(scope="module", params=SHAPES)
def fitted(request: pytest.FixtureRequest):
    given, size, least_share = SHAPES[request.param]
    outer = make_shape(params=MakeShapeParams.model_validate(given))
    return outer, size, least_share, hexahedra_of(outer, size, "fitted")


def distances(points: np.ndarray, outer: OuterShape):
    return np.sqrt(igl.point_mesh_squared_distance(np.ascontiguousarray(points), outer.vertices, outer.faces)[0])


def boundary_of(mesh: VolumeMesh):
    surface, _ = boundary_triangles(mesh.vertices, cells.faces(mesh.cells))
    return OuterShape(*triangles.drop_unreferenced(mesh.vertices, surface))


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("hexahedralise", hexahedralise)
    assert (declared.writes, list(declared.reads)) == ("mesh", ["outer"])
    assert "rng" not in declared.engine_arguments


def test_no_fitted_cell_is_inverted_and_its_quality_is_told(fitted):
    _, _, _, mesh = fitted
    quality = least_jacobians(mesh.vertices, mesh.hexahedra)
    assert quality.min() > 0.1
    assert quality.mean() > 0.7
    assert cells.count_folded_cells(mesh.vertices, mesh.cells) == 0
    assert mesh.facts["least_scaled_jacobian"] == pytest.approx(quality.min())
    assert mesh.facts["mean_scaled_jacobian"] == pytest.approx(quality.mean())


def test_the_boundary_of_fitted_cells_lies_on_the_surface_or_is_counted(fitted):
    outer, size, _, mesh = fitted
    off = distances(boundary_of(mesh).vertices, outer)
    assert mesh.facts["boundary_vertices"] == len(off)
    assert mesh.facts["vertices_off_surface"] == (off > 1e-6 * size).sum() == 0
    assert mesh.facts["farthest_off_surface"] == pytest.approx(off.max(), abs=1e-12)
    left_out = distances(outer.vertices, boundary_of(mesh))
    assert mesh.facts["farthest_left_out"] == pytest.approx(left_out.max(), abs=1e-9)
    assert left_out.max() < 0.5 * size


def test_fitted_cells_fill_the_shape_once_and_hang_together(fitted):
    outer, _, least_share, mesh = fitted
    surface = boundary_of(mesh)
    assert not any(triangles.edge_faults(surface.faces))
    assert triangles.touching_vertices(surface.faces) == 0
    assert triangles.euler_characteristic(surface.faces) == 2
    assert not self_intersecting_faces(surface.vertices, surface.faces).any()
    assert least_share < mesh.facts["volume_share"] < 1.0 + 1e-9
    assert mesh.facts["volume_share"] == pytest.approx(mesh.volume / outer.volume)
    assert mesh.facts["pieces"] == 1


@pytest.mark.parametrize("name", ["ball", "cylinder", "box"])
@pytest.mark.parametrize("kind", ["grid", "fitted"])
def test_a_symmetric_shape_gives_a_symmetric_mesh(name: str, kind: str):
    outer = shape(name)
    mesh = hexahedra_of(outer, SHAPES[name][1], kind)
    centred = mesh.vertices - outer.bounds.mean(axis=0)
    for axis in range(3):
        mirrored = centred * np.where(np.arange(3) == axis, -1.0, 1.0)
        assert cKDTree(centred).query(mirrored)[0].max() < 1e-9


@pytest.mark.parametrize("kind", ["grid", "fitted"])
def test_the_same_shape_gives_the_same_mesh_to_the_bit(kind: str):
    one, other = (hexahedra_of(shape("femur"), 4.0, kind) for _ in range(2))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.hexahedra.tobytes() == other.hexahedra.tobytes()


def test_size_and_place_of_a_shape_change_its_mesh_in_nothing_else():
    outer = shape("ball")
    moved = OuterShape(4.0 * outer.vertices + [16.0, -8.0, 64.0], outer.faces)
    one, other = hexahedra_of(outer, 1.5, "fitted"), hexahedra_of(moved, 6.0, "fitted")
    np.testing.assert_array_equal(one.hexahedra, other.hexahedra)
    np.testing.assert_allclose(4.0 * one.vertices + [16.0, -8.0, 64.0], other.vertices, atol=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_cells_of_a_grid_all_meet_the_shape_and_cover_it(name: str):
    outer, size = shape(name), 2.0
    mesh = hexahedra_of(outer, size, "grid")
    low = mesh.vertices[mesh.hexahedra].min(axis=1)
    np.testing.assert_allclose(cell_volumes(mesh.vertices, mesh.hexahedra, "hexahedron"), size**3)

    rng = np.random.default_rng(3)
    samples = rng.uniform(*outer.bounds, (20_000, 3))
    inside = samples[igl.fast_winding_number(outer.vertices, outer.faces, samples) > 0.5]
    taken = {tuple(place) for place in np.rint((low - low.min(axis=0)) / size).astype(int).tolist()}
    assert {tuple(place) for place in np.floor((inside - low.min(axis=0)) / size).astype(int).tolist()} <= taken

    within = (low[:, None] + size * rng.uniform(size=(200, 3))).reshape(-1, 3)
    hits = igl.fast_winding_number(outer.vertices, outer.faces, within).reshape(len(low), -1) > 0.5
    nearest = distances(low + size / 2.0, outer)
    assert (hits.any(axis=1) | (nearest < size * np.sqrt(0.75))).all()
    assert hits.any(axis=1).mean() > 0.9


def test_a_grid_that_fits_a_box_fills_it_and_no_more():
    outer = outer_of(box((1.0, 2.0, 3.0), (7.0, 6.0, 5.0)))
    mesh = hexahedra_of(outer, 2.0, "grid")
    assert (len(mesh.hexahedra), mesh.facts["volume_share"]) == (6, pytest.approx(1.0))
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], outer.bounds)


def test_fitted_cells_reach_the_corners_of_a_box():
    outer = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)))
    mesh = hexahedra_of(outer, 2.0, "fitted")
    assert cKDTree(mesh.vertices).query(outer.vertices)[0].max() < 1e-6
    assert mesh.facts["volume_share"] == pytest.approx(1.0, abs=1e-6)


def test_bodies_apart_are_all_filled_and_a_cavity_is_left():
    outer = outer_of(together(ball(5.0), ball(4.0, (20.0, 0.0, 0.0))))
    mesh = hexahedra_of(outer, 1.5, "fitted")
    assert mesh.facts["pieces"] == 2

    hollow = outer_of(together(ball(8.0, divisions=4), (ball(4.0)[0], ball(4.0)[1][:, ::-1])))
    mesh = hexahedra_of(hollow, 1.5, "fitted")
    assert mesh.facts["pieces"] == 1
    assert triangles.face_pieces(boundary_of(mesh).faces).max() == 1
    assert mesh.facts["vertices_off_surface"] == 0
    assert 0.96 < mesh.facts["volume_share"] < 1.01


def test_a_mesh_that_misses_parts_of_the_shape_warns():
    with pytest.warns(
        PipelineWarning, match=r"hexahedra fill \d\d\.\d% of the outer .*; lower cell_size, or set `kind: grid`"
    ):
        hexahedra_of(outer_of(ball(6.0)), 5.0, "fitted")


def test_a_mesh_that_comes_apart_where_the_shape_does_not_warns():
    whole = hexahedra((3, 3, 3))
    places = whole.vertices.astype(int)
    vertices = np.stack([np.take(x, places[:, i]) for i, x in enumerate(([0, 6, 9, 15], *[[0, 3.8, 4.2, 8]] * 2))], 1)
    middle = whole.vertices[whole.hexahedra].mean(axis=1)
    is_kept = (middle[:, 0] != 1.5) | (middle[:, 1:] == 1.5).all(axis=1)  # two plates, and a thin bar between them
    used, compact = np.unique(whole.hexahedra[is_kept], return_inverse=True)
    dumbbell = boundary_of(VolumeMesh(vertices[used], hexahedra=compact.reshape(-1, 8)))
    with pytest.warns(PipelineWarning, match="are in 2 pieces"):
        mesh = hexahedra_of(dumbbell, 1.0, "fitted")
    assert mesh.facts["pieces"] == 2


@pytest.mark.parametrize("kind", ["grid", "fitted"])
def test_cells_larger_than_the_shape_are_refused_with_both_sizes(kind: str):
    with pytest.raises(StageError, match="cell_size 12 mm: larger than the outer shape of 10 x 8 x 4 mm; lower it"):
        hexahedra_of(outer_of(box((0.0, 0.0, 0.0), (10.0, 8.0, 4.0))), 12.0, kind)


def test_a_shape_thinner_than_its_cells_is_refused_where_they_are_to_fit():
    plate = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 1.0)))
    with pytest.raises(StageError, match="cell_size 2 mm: no cell fits into the outer shape of 10 x 10 x 1 mm"):
        hexahedra_of(plate, 2.0, "fitted")
    assert len(hexahedra_of(plate, 2.0, "grid").hexahedra) == 25


@pytest.mark.parametrize("size", [0.01, 1e-9])
def test_cells_too_small_for_memory_are_refused_with_the_size_that_fits(size: float, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "available_memory", lambda: 2**30)
    outer = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)))
    with pytest.raises(
        StageError, match=r"the cells need .* GiB, but 1\.0 GiB are free; use ([\d.]+) mm or more"
    ) as told:
        hexahedra_of(outer, size, "fitted")
    fitting = float(str(told.value).rsplit(maxsplit=4)[1])
    assert module._estimate_memory(outer, fitting) <= 2**30 < module._estimate_memory(outer, fitting / 1.3)


@pytest.mark.parametrize("given", [{}, {"cell_size": 0.0}, {"cell_size": 1.0, "kind": "hex"}])
def test_parameters_are_checked(given: dict[str, object]):
    with pytest.raises(ValidationError):
        HexahedraliseParams.model_validate(given)


def test_a_real_bone_is_filled_by_sound_cells():
    path = BONES / "bmf_CalcaneusR.obj"
    if not path.is_file():
        pytest.skip("the real bones are not beside this checkout")
    outer = load_surface(params=LoadSurfaceParams.model_validate({"path": path, "units": "m"}))
    mesh = hexahedra_of(outer, 4.0, "fitted")
    assert mesh.facts["least_scaled_jacobian"] >= 0.1
    assert mesh.facts["mean_scaled_jacobian"] > 0.8
    assert mesh.facts["volume_share"] == pytest.approx(0.99, abs=0.01)
    assert mesh.facts["vertices_off_surface"] <= 0.002 * mesh.facts["boundary_vertices"]
