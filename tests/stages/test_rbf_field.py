"""The isotropic field against an oracle, the laws of its systems, and what it loses beside the anisotropic one."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from pydantic import ValidationError

from geometry.fields.oracle import (
    REFERENCE_MESHES,
    Floats,
    Mesh,
    eight_hexahedra,
    elements_of,
    icosahedron,
    one_hexahedron,
    phi,
    to_segment,
)
from scaffold_geometry.fields import interpolation, sampling
from scaffold_pipeline.artifacts import CellMesh, Certificate, OuterShape, PlanarMesh, ScalarField, VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from scaffold_stages.intersect_outer import IntersectOuterParams, intersect_outer
from scaffold_stages.isosurface import IsosurfaceParams, isosurface
from scaffold_stages.measure import MeasureParams, measure
from scaffold_stages.rbf_field import RbfFieldParams, rbf_field
from shapes import box

BASES = ("gaussian", "multiquadric", "inverse_multiquadric", "thin_plate_spline")
SQUARE = PlanarMesh(np.array([(-1, -1, 4), (1, -1, 4), (1, 1, 4), (-1, 1, 4.0)]), quadrangles=np.array([(0, 1, 2, 3)]))


class Oracle(NamedTuple):
    """The points of a mesh (n, 3), their values and the interpolant's weights (n,), by numpy alone."""

    points: Floats
    values: Floats
    weights: Floats

    def at(self, places: Floats, basis: str, c: float) -> Floats:
        return phi(basis, to_segment(places[:, None], self.points, self.points), c) @ self.weights


def oracle_of(mesh: Mesh, basis: str, c: float) -> Oracle:
    elements = elements_of(mesh)
    points, values = elements.starts[: -elements.channels], elements.values[: -elements.channels]
    matrix = phi(basis, to_segment(points[:, None], points, points), c)
    return Oracle(points, values, np.linalg.solve(matrix, values))


def volume(mesh: Mesh) -> VolumeMesh:
    return VolumeMesh(mesh.vertices, **{CELL_TYPES[kind].plural: cells for kind, cells in mesh.cells.items()})


def box_around(vertices: Floats) -> OuterShape:
    return OuterShape(*box(tuple(vertices.min(axis=0)), tuple(vertices.max(axis=0))))


def told(mesh: CellMesh, outer: OuterShape | None = None, **given: object) -> tuple[ScalarField, list[str]]:
    """The field and its warnings."""
    params = RbfFieldParams.model_validate({"voxel_size": 0.2, **given})
    outer = outer or (None if mesh.IS_PLANAR else box_around(mesh.vertices))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        field = rbf_field(mesh, outer, params=params)
    assert all(warning.category is PipelineWarning for warning in caught)
    return field, [str(warning.message) for warning in caught]


def at_points(mesh: CellMesh, places: Floats, path: Path, **given: object) -> Floats:
    """The field itself at places (n, 3) mm."""
    path.write_text("x,y,z\n" + "\n".join(",".join(map(repr, place)) for place in places.tolist()))
    return told(mesh, points=path, **given)[0].point_values


def window_of(field: ScalarField) -> Certificate:
    assert field.certificate is not None
    return field.certificate


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("rbf_field", rbf_field)
    assert (declared.writes, list(declared.reads)) == ("field", ["mesh", "outer"])


@pytest.mark.parametrize("basis", BASES)
def test_voxels_and_points_equal_the_oracle(basis: str, tmp_path: Path):
    mesh, c = icosahedron(), 1.0
    given = {"basis": basis} if basis == "thin_plate_spline" else {"basis": basis, "c": c}
    oracle = oracle_of(mesh, basis, c)
    places = np.random.default_rng(1).uniform(-0.8, 0.8, (40, 3))
    values = at_points(volume(mesh), places, tmp_path / "points.csv", **given)
    np.testing.assert_allclose(values, oracle.at(places, basis, c), rtol=0, atol=1e-7)
    field, _ = told(volume(mesh), **given)
    nodes = np.argwhere(field.values)[::7]
    sampled = field.origin + field.spacing * nodes
    inner = np.linalg.norm(sampled, axis=1) < 0.8
    expected = oracle.at(sampled[inner], basis, c)
    np.testing.assert_allclose(field.values[tuple(nodes[inner].T)], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", REFERENCE_MESHES)
@pytest.mark.parametrize("basis", BASES)
def test_it_takes_the_values_given_at_its_points_where_rank_is_full(name: str, basis: str, tmp_path: Path):
    mesh = REFERENCE_MESHES[name]()
    c = {"thin_plate_spline": None, "gaussian": 2.0}.get(basis, 1.0)  # with 1/mm, weights of 4e7 leave 1e-7
    elements = elements_of(mesh)
    values = at_points(volume(mesh), elements.starts[: -elements.channels], tmp_path / "points.csv", basis=basis, c=c)
    np.testing.assert_allclose(values, elements.values[: -elements.channels], rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["eight_hexahedra", "icosahedron"])
def test_the_systems_of_distinct_points_have_the_inertia_of_their_laws(name: str):
    mesh = REFERENCE_MESHES[name]()
    count = len(oracle_of(mesh, "gaussian", 1.0).points)
    for basis, negative in (("gaussian", 0), ("inverse_multiquadric", 0), ("multiquadric", count - 1)):
        field, _ = told(volume(mesh), basis=basis, c=1.0)
        facts = {name: field.facts[name] for name in ("elements", "rank", "negative_eigenvalues")}
        assert facts == {"elements": count, "rank": count, "negative_eigenvalues": negative}
        assert field.facts["expected_negative_eigenvalues"] == negative
    assert told(volume(mesh), basis="thin_plate_spline")[0].facts["expected_negative_eigenvalues"] is None


def test_a_symmetric_mesh_gives_a_symmetric_field():
    values = told(volume(one_hexahedron()), voxel_size=0.07)[0].values
    for mirrored in (np.flip(values, 0), np.flip(values, 1), np.flip(values, 2), values.transpose(1, 2, 0)):
        np.testing.assert_allclose(mirrored, values, rtol=0, atol=1e-5)


def test_without_channels_the_window_is_narrower_than_with_them():
    for make in REFERENCE_MESHES.values():
        mesh = volume(make())
        isotropic = window_of(told(mesh)[0])
        anisotropic = arbf_field(
            mesh, box_around(mesh.vertices), params=ArbfFieldParams(voxel_size=0.2, interpolation="exact")
        )
        assert isotropic.channel_max > window_of(anisotropic).channel_max
        assert isotropic.strut_min < window_of(anisotropic).strut_min - 0.1


def test_measure_shows_what_isotropy_breaks_and_pores_grow_with_the_iso():
    mesh = volume(eight_hexahedra())
    outer = box_around(mesh.vertices)
    field, _ = told(mesh, voxel_size=0.04)
    found = []
    for iso in (-0.8, -0.6, -0.3):
        porous = isosurface(field, outer, params=IsosurfaceParams(iso=iso))
        solid = intersect_outer(porous, outer, params=IntersectOuterParams())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PipelineWarning)  # that struts are thin
            found.append(measure(solid, outer, porous, field, mesh, params=MeasureParams()))
    porosities = np.array([metrics.values["porosity"] for metrics in found])
    assert (np.diff(porosities) > 0.05).all()
    assert [metrics.values["struts_broken"] for metrics in found[:2]] == [0, 0]
    assert window_of(field).strut_min < -0.3
    broken = found[2]
    assert broken.values["struts_broken"] == (window_of(field).strut_minima <= -0.3).sum() > 0
    assert any("above strut_min" in gate for gate in broken.failed_gates)
    assert broken.values["gates_not_applied"] == []


def test_a_planar_mesh_has_one_layer_and_needs_no_outer_shape(tmp_path: Path):
    field, _ = told(SQUARE)
    assert field.values.shape[2] == 1
    assert field.facts["elements"] == 4 + 4 + 1
    assert len(window_of(field).channel_maxima) == len(window_of(field).strut_minima) == 4
    points = np.array([(-1, -1, 4), (1, 1, 4), (0, -1, 4), (1, 0, 4), (0, 0, 4.0)])
    values = at_points(SQUARE, points, tmp_path / "points.csv")
    np.testing.assert_allclose(values, (1, 1, -1, -1, -1), rtol=0, atol=1e-8)


def test_without_an_interpolant_it_says_so():
    field, said = told(volume(eight_hexahedra()), basis="gaussian")
    rank, count = field.facts["rank"], field.facts["unknowns"]
    assert (isinstance(rank, int) and rank < 71, count) == (True, 71)
    assert said[0].startswith(f"rbf: no interpolant exists (rank {rank} of 71); this is the least-squares")


def test_coincident_points_are_told_and_change_nothing():
    mesh = eight_hexahedra()
    corners = mesh.cells["hexahedron"]
    apart = VolumeMesh(mesh.vertices[corners].reshape(-1, 3), hexahedra=np.arange(64).reshape(8, 8))
    field, said = told(apart)
    assert len(said) == 1
    assert said[0].startswith(f"rbf: several interpolants exist, as elements coincide (rank 71 of {64 + 48 + 8})")
    np.testing.assert_allclose(field.values, told(volume(mesh))[0].values, rtol=0, atol=1e-5)


def test_values_far_from_those_given_are_warned_of_with_what_to_use():
    _, said = told(volume(icosahedron()), basis="gaussian", c=1.0)
    assert [line.partition("|s| reaches")[0] for line in said] == ["rbf: "]
    assert said[0].endswith("far from the values given on the skeleton (-1 and 1); use arbf_field")


def test_a_system_or_grid_beyond_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch):
    mesh = volume(eight_hexahedra())
    monkeypatch.setattr(interpolation, "MOST_UNKNOWNS", 70)
    with pytest.raises(
        StageError, match=r"^rbf has 71 unknowns here, .* at most 70; use arbf_field, or a coarser mesh$"
    ):
        told(mesh)
    monkeypatch.setattr(interpolation, "MOST_UNKNOWNS", 71)
    monkeypatch.setattr(interpolation, "available_memory", lambda: 50_000)
    with pytest.raises(StageError, match=r"^rbf has 71 unknowns here, which need 0\.0 GiB"):
        told(mesh)
    monkeypatch.setattr(sampling, "available_memory", lambda: 5_000)
    with pytest.raises(StageError, match=r"^voxel_size 0\.2 mm: the grid needs"):
        told(mesh)


def test_a_mesh_of_solid_cells_needs_its_outer_shape():
    with pytest.raises(StageError, match="outer: is required unless the mesh is planar"):
        rbf_field(volume(one_hexahedron()), params=RbfFieldParams(voxel_size=0.2))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"basis": "thin_plate_spline", "c": 0.1}, "c: does not apply to basis: thin_plate_spline; leave it out"),
        ({"basis": "cubic"}, "basis\n.*'gaussian', 'multiquadric', 'inverse_multiquadric' or 'thin_plate_spline'"),
        ({"c": 0.0}, "c\n.*greater than or equal to 0.000000001"),
        ({"c": 1e7}, "c\n.*less than or equal to 1000000"),
        ({"distance": "exact"}, "distance\n.*not permitted"),
        ({"voxel_size": None}, "give either voxel_size or grid"),
    ],
)
def test_parameters_without_meaning_are_refused(given: dict[str, object], said: str):
    with pytest.raises(ValidationError, match=said):
        RbfFieldParams.model_validate({"voxel_size": 0.2, **given})
