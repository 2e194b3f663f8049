"""The stage's field and certificate against oracles, in mm, and all that it refuses or warns of."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import Delaunay

from geometry.fields.oracle import (
    Elements,
    Floats,
    Mesh,
    between,
    eight_hexahedra,
    elements_of,
    hexahedra,
    icosahedron,
    interpolant_of,
    one_hexahedron,
    phi,
    to_segment,
)
from geometry.fields.shepard_oracle import extremes, graded, jittered, mixed, net_of, oriented, shepard, tetrahedra
from scaffold_geometry.fields import interpolation, sampling
from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_geometry.surfaces import booleans
from scaffold_pipeline.artifacts import OuterShape, ScalarField, VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from shapes import box

C, EXPONENT, SUPPORT = 0.002, 4, 1.0
BOX = [
    *((0, 1, 2), (1, 3, 2), (4, 6, 5), (5, 6, 7), (0, 4, 1), (1, 4, 5)),
    *((2, 3, 6), (3, 7, 6), (0, 2, 4), (2, 6, 4), (1, 5, 3), (3, 5, 7)),
]


def volume(mesh: Mesh) -> VolumeMesh:
    names = {kind: name for name, kind in VolumeMesh._kinds().items()}
    return VolumeMesh(mesh.vertices, **{names[kind]: cells for kind, cells in mesh.cells.items()})


def box_around(mesh: Mesh) -> OuterShape:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    corners = low + (high - low) * [(i >> 2 & 1, i >> 1 & 1, i & 1) for i in range(8)]
    return OuterShape(corners, np.array(BOX))


def boundary(mesh: Mesh) -> OuterShape:
    """The faces of only one cell, quadrangles cut in two."""
    faces = [
        tuple(cell[list(face)])
        for kind, cells in mesh.cells.items()
        for cell in cells
        for face in CELL_TYPES[kind].faces
    ]
    outer = [face for face in faces if sum(set(face) == set(other) for other in faces) == 1]
    return OuterShape(mesh.vertices, np.array([(face[0], *two) for face in outer for two in pairwise(face[1:])]))


def field_of(mesh: Mesh, outer: OuterShape | None = None, **given: object) -> ScalarField:
    return arbf_field(volume(mesh), outer or box_around(mesh), params=ArbfFieldParams.model_validate(given))


def places(field: ScalarField) -> Floats:
    """Where the samples lie, (n, 3) mm."""
    return field.origin + field.spacing * np.stack(
        np.meshgrid(*map(np.arange, field.values.shape), indexing="ij"), -1
    ).reshape(-1, 3)


def pinched() -> Mesh:
    """Two tetrahedra on one face; a corner of the first is pushed down upon the middle of an edge of that face."""
    vertices = np.array([(1, 0, 0), (-0.5, 0.866, 0), (-0.5, -0.866, 0), (-0.5, 0, 0.05), (0, 0, -1.2)])
    return oriented(Mesh(vertices, {"tetrahedron": np.array([(0, 1, 2, 3), (0, 1, 2, 4)])}))


def irregular() -> Mesh:
    points = np.random.default_rng(1).random((20, 3))
    return oriented(Mesh(points, {"tetrahedron": Delaunay(points).simplices.astype(np.int64)}))


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("arbf_field", arbf_field)
    assert (declared.writes, list(declared.reads)) == ("field", ["mesh", "outer"])


@pytest.mark.parametrize(
    ("make", "given"),
    [
        (lambda: jittered(tetrahedra((2, 2, 1))), {}),
        (lambda: jittered(tetrahedra((2, 2, 1))), {"solid": "vertices", "c": 0.05, "exponent": 6, "support": 1.6}),
        (lambda: jittered(hexahedra((2, 1, 1), 1.0, (0.0, 0.0, 0.0))), {"support": 1.0}),
        (mixed, {"c": 0.1, "exponent": 2}),
        (mixed, {"exponent": 8}),
    ],
)
def test_voxels_and_certificate_equal_the_oracle(make: Callable[[], Mesh], given: dict[str, float]):
    mesh = make()
    net = net_of(mesh, str(given.get("solid", "edges")))
    numbers = (given.get("c", C), given.get("exponent", EXPONENT), given.get("support", SUPPORT))
    field = field_of(mesh, boundary(mesh), voxel_size=0.17, **given)
    points, values = places(field), field.values.ravel()
    near = (points > mesh.vertices.min(axis=0)).all(axis=1) & (points < mesh.vertices.max(axis=0)).all(axis=1)
    near &= values > -1.0  # those beyond two voxels outside are void by order, not by the formula
    assert near.sum() > 300
    np.testing.assert_allclose(values[near], shepard(net, points[near], *numbers), rtol=0, atol=1e-5)
    greatest, least = extremes(net, *numbers, 65)
    assert field.certificate is not None
    assert field.certificate.channel_max == pytest.approx(greatest.max(), abs=2e-3)
    if given.get("solid") == "vertices":  # then the mesh edges, which the certificate judges, are no elements
        assert field.certificate.strut_min < 0.0
    else:
        assert field.certificate.strut_min == pytest.approx(least.min(), abs=2e-3)
    assert field.facts["elements"] == len(net.values)
    assert field.facts["local_support"] == pytest.approx(numbers[2] * net.sizes.max())


def test_a_graded_mesh_is_reached_everywhere_by_its_local_sizes():
    mesh = graded()
    field = field_of(mesh, boundary(mesh), voxel_size=0.8)
    assert net_of(mesh).sizes.max() > 10.0 * net_of(mesh).sizes.min()
    assert field.certificate is not None
    assert field.certificate.channel_max < -0.9
    assert field.certificate.strut_min > 0.9


@pytest.mark.parametrize(("c", "is_wide"), [(None, True), (0.01, False)])
def test_channels_of_flat_cells_leave_the_struts_beside_them_whole(c, is_wide):
    mesh = tetrahedra((2, 2, 2))
    mesh.vertices[(mesh.vertices == 1.0).all(axis=1)] = (1.0, 1.0, 0.03)  # the middle, down to the cells beneath
    certificate = field_of(oriented(mesh), voxel_size=0.25, c=c).certificate
    assert certificate is not None
    assert (certificate.channel_max < -0.9 < 0.9 < certificate.strut_min) == is_wide


def test_samples_more_than_two_voxels_outside_are_void():
    mesh = tetrahedra((2, 2, 1))
    for given in ({}, {"interpolation": "exact"}):
        field = field_of(mesh, voxel_size=0.15, **given)
        outside = np.maximum(mesh.vertices.min(axis=0) - places(field), places(field) - mesh.vertices.max(axis=0)).max(
            axis=1
        )
        assert (field.values.ravel()[outside > 2.0 * 0.15 + 1e-9] == -1.0).all()
        assert (field.values.ravel()[(outside > 0.15) & (outside < 0.29)] > -1.0).all()


def test_a_symmetric_mesh_gives_a_symmetric_field():
    values = field_of(eight_hexahedra(), voxel_size=0.03).values
    for mirrored in (np.flip(values, 0), np.flip(values, 1), np.flip(values, 2), values.transpose(1, 2, 0)):
        np.testing.assert_allclose(mirrored, values, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("scale", "offset"), [(1e3, 0.0), (1e-3, 0.0), (1.0, 20_000.0)])
def test_neither_the_unit_nor_the_place_changes_the_field(scale: float, offset: float):
    mesh = jittered(tetrahedra((2, 1, 1)))
    moved = Mesh(scale * mesh.vertices + offset, mesh.cells)
    one = field_of(mesh, boundary(mesh), voxel_size=0.13)
    other = field_of(moved, boundary(moved), voxel_size=0.13 * scale)
    assert one.certificate is not None
    assert other.certificate is not None
    assert other.certificate.channel_max == pytest.approx(one.certificate.channel_max, abs=1e-8)
    assert other.certificate.strut_min == pytest.approx(one.certificate.strut_min, abs=1e-8)
    inner = np.s_[4:-4, 4:-4, 4:-4]  # where a sample lies on the surface, its last digit decides
    np.testing.assert_allclose(other.values[inner], one.values[inner], rtol=0, atol=5e-6)


def test_a_cell_with_coincident_corners_gives_a_field():
    mesh = one_hexahedron()
    cells = mesh.cells["hexahedron"].copy()
    vertices = mesh.vertices.copy()
    vertices[cells[0, 6]] = vertices[cells[0, 5]]
    vertices[cells[0, 7]] = vertices[cells[0, 4]]
    folded = Mesh(vertices, {"hexahedron": cells})
    field = field_of(folded, voxel_size=0.2)
    assert np.isfinite(field.values).all()
    assert field.values.max() > 0.9


def test_a_closed_channel_and_a_broken_strut_are_counted():
    mesh, c = pinched(), 0.02
    certificate = field_of(mesh, voxel_size=0.2, c=c).certificate
    assert certificate is not None
    net = net_of(mesh)
    greatest, least = extremes(net, c, EXPONENT, SUPPORT, 1025)
    skeleton = skeleton_of(*mesh)
    sliver = np.linalg.norm(skeleton.channel_ends - mesh.vertices[[1, 2, 3]].mean(axis=0), axis=1) < 1e-9
    over_the_face = (skeleton.edges == (0, 3)).all(axis=1)
    assert (certificate.channel_maxima >= 0.0).tolist() == sliver.tolist()
    assert (certificate.strut_minima <= 0.0).tolist() == over_the_face.tolist()
    counts = ("channels", "channels_closed", "struts", "struts_broken")
    assert [certificate.at(0.0)[name] for name in counts] == [8, 1, 9, 1]
    for iso in (-0.9, -0.7, 0.2, 0.6, 0.95):
        told = certificate.at(iso)
        assert told["channels_closed"] == (greatest >= iso).sum()
        assert told["struts_broken"] == (least <= iso).sum()
    assert certificate.at(0.0)["channel_max"] == pytest.approx(greatest.max(), abs=3e-4)
    assert certificate.at(0.0)["strut_min"] == pytest.approx(least.min(), abs=3e-4)


def test_a_smaller_c_opens_the_pinched_window():
    windows = [field_of(pinched(), voxel_size=0.2, c=c).certificate for c in (0.02, 1e-3, 1e-7)]
    assert [window is not None and window.channel_max < window.strut_min for window in windows] == [False, True, True]
    assert windows[2] is not None
    assert windows[2].at(0.0)["struts_broken"] == 0
    assert (windows[2].channel_max, windows[2].strut_min) == pytest.approx((-1.0, 1.0), abs=1e-3)


def test_a_support_too_small_is_an_error_that_names_it():
    with pytest.raises(
        StageError, match=r"^support: \d+ of \d+ samples .* raise support \(now 0.2 local edge lengths\)"
    ):
        field_of(tetrahedra((1, 1, 1)), voxel_size=0.1, support=0.2)


def spiked(mesh: Mesh) -> OuterShape:
    """The box around a mesh with a thin spike on top, whose tip the mesh does not reach."""
    outer = box_around(mesh)
    (x, y, _), top = outer.vertices.mean(axis=0), outer.vertices[:, 2].max()
    spike = box((x - 0.06, y - 0.06, top - 0.5), (x + 0.06, y + 0.06, top + 1.6))
    body = booleans.to_manifold(outer.vertices, outer.faces, "box") + booleans.to_manifold(*spike, "spike")
    return OuterShape(*booleans.from_manifold(body))


def test_a_few_samples_that_only_struts_or_channels_reach_are_a_warning():
    mesh = tetrahedra((3, 3, 3))
    with pytest.warns(
        PipelineWarning,
        match=r"^support: \d of \d{5} samples .* samples reached by struts only are solid, all others void$",
    ):
        field_of(mesh, spiked(mesh), voxel_size=0.1)


def test_a_mesh_that_leaves_part_of_the_outer_shape_empty_is_an_error():
    with pytest.raises(StageError, match="check that the mesh fills the outer shape"):
        field_of(tetrahedra((1, 1, 1)), box_around(tetrahedra((4, 1, 1))), voxel_size=0.2)


def test_voxels_too_coarse_for_the_outer_shape_are_an_error():
    sheet = Mesh(tetrahedra((1, 1, 1)).vertices * (1.0, 1.0, 0.01) + (0.0, 0.0, 0.245), tetrahedra((1, 1, 1)).cells)
    with pytest.raises(
        StageError, match=r"voxel_size 0\.5 mm: no sample lies inside the outer shape; use a smaller voxel_size"
    ):
        field_of(sheet, box_around(sheet), voxel_size=0.5)


@pytest.mark.parametrize("voxel_size", [0.001, 1e-12, 1e-300])
def test_a_grid_beyond_the_memory_is_refused_with_a_size_that_fits(monkeypatch: pytest.MonkeyPatch, voxel_size: float):
    monkeypatch.setattr(sampling, "available_memory", lambda: 2_000_000)
    mesh = tetrahedra((1, 1, 1))
    with pytest.raises(StageError, match=rf"^voxel_size {voxel_size:g} mm: the grid needs") as refusal:
        field_of(mesh, voxel_size=voxel_size)
    fitting = float(re.findall(r"use ([\d.e-]+) mm or more", str(refusal.value))[0])
    field = field_of(mesh, voxel_size=fitting)
    assert 1_000_000 < sampling.BYTES_PER_VOXEL * field.values.size <= 2_000_000


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"basis": "gaussian"}, "basis: does not apply to interpolation: normalised"),
        ({"distance": "exact"}, "distance: does not apply to interpolation: normalised"),
        ({"interpolation": "exact", "exponent": 4}, "exponent: does not apply to interpolation: exact"),
        ({"interpolation": "exact", "support": 1.3}, "support: does not apply to interpolation: exact"),
        (
            {"interpolation": "exact", "basis": "thin_plate_spline", "c": 0.1},
            "c: does not apply to basis: thin_plate",
        ),
        ({"c": 0.0}, "greater than 0"),
        ({"interpolation": "exact", "c": -0.1}, "greater than 0"),
        ({"exponent": 3}, "exponent"),
        ({"support": 0.0}, "greater than 0"),
        ({"voxel_size": 0.0}, "greater than 0"),
    ],
)
def test_parameters_without_meaning_are_refused(given: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        ArbfFieldParams.model_validate({"voxel_size": 1.0, **given})


@pytest.mark.parametrize(("reading", "high"), [("endpoint", 1.75), ("endpoint-to-segment", 1.79)])
def test_exact_has_the_published_range_on_the_icosahedron(reading: str, high: float):
    mesh = icosahedron()
    side = float(np.ptp(mesh.vertices[:, 0]))
    field = field_of(mesh, voxel_size=side / 32, interpolation="exact", distance=reading)
    over_the_box = field.values[3:-3, 3:-3, 3:-3]
    assert over_the_box.shape == (33, 33, 33)
    assert (over_the_box.min(), over_the_box.max()) == pytest.approx((-1.02, high), abs=5e-3)
    expected = {"elements": 163, "unknowns": 163, "rank": 163}
    expected |= {"negative_eigenvalues": 80, "expected_negative_eigenvalues": 80}
    assert {name: field.facts[name] for name in expected} == expected
    assert float(field.facts["residual"] or 0.0) < 1e-12


def test_exact_on_voxels_equals_the_oracle_and_not_that_of_another_basis():
    mesh = icosahedron()
    field, _ = told(mesh, basis="multiquadric", c=0.2, distance="exact")
    inner = np.linalg.norm(places(field), axis=1) < 0.8
    points, values = places(field)[inner], field.values.ravel()[inner]
    np.testing.assert_allclose(values, interpolant_of(mesh, "multiquadric", "exact", 0.2).at(points), rtol=0, atol=1e-6)
    assert np.abs(values - interpolant_of(mesh, "inverse_multiquadric", "exact", 0.2).at(points)).max() > 0.01


def told(mesh: Mesh, **given: object) -> tuple[ScalarField, str]:
    """The field of `exact` and its warnings, one a line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        field = field_of(mesh, boundary(mesh), voxel_size=0.2, interpolation="exact", **given)
    assert all(warning.category is PipelineWarning for warning in caught)
    return field, "\n".join(str(warning.message) for warning in caught)


def test_exact_on_a_reference_mesh_warns_of_nothing():
    assert told(eight_hexahedra())[1] == ""


def test_exact_without_an_interpolant_says_so():
    field, warned = told(one_hexahedron(), basis="thin_plate_spline")
    assert "no interpolant exists (rank 18 of 21)" in warned
    assert (field.facts["rank"], field.facts["unknowns"]) == (18, 21)


def test_exact_on_an_irregular_mesh_warns_of_inertia_and_of_values_out_of_range():
    field, warned = told(irregular())
    assert field.facts["negative_eigenvalues"] == 211
    assert "has 211 negative eigenvalues, a regular one has 212" in warned
    assert re.search(r"\|s\| reaches [34]\.\d+, far from the values given", warned)


def test_exact_warns_of_values_out_of_range_off_the_skeleton():
    field, warned = told(hexahedra((4, 4, 4), 1.0, (0.0, 0.0, 0.0)))
    assert field.facts["negative_eigenvalues"] == field.facts["expected_negative_eigenvalues"]
    assert field.certificate is not None
    assert np.abs(field.certificate.strut_minima).max() < 1.01
    assert warned.startswith("exact: |s| reaches 3.7")


def test_exact_with_edges_takes_them_as_segments_at_one():
    mesh = one_hexahedron()
    field, warned = told(mesh, solid="edges")
    assert (field.facts["unknowns"], field.facts["expected_negative_eigenvalues"]) == (21 + 12, 6 + 12)
    assert warned == ""
    plain, net = elements_of(mesh), net_of(mesh)
    starts, ends = (
        np.concatenate([of_plain, of_net[:12]])
        for of_plain, of_net in ((plain.starts, net.starts), (plain.ends, net.ends))
    )
    widened = Elements(starts, ends, np.append(plain.values, np.ones(12)), plain.channels + 12)
    weights = np.linalg.solve(phi("inverse_multiquadric", between(widened, "endpoint-to-segment"), 0.1), widened.values)
    inner = (np.abs(places(field)) < 1.0).all(axis=1)
    squared = to_segment(places(field)[inner][:, None], starts, ends)
    expected = phi("inverse_multiquadric", squared, 0.1) @ weights
    np.testing.assert_allclose(field.values.ravel()[inner], expected, rtol=0, atol=1e-6)


def test_exact_beyond_its_bounds_is_refused_with_the_memory_it_needs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(interpolation, "MOST_UNKNOWNS", 162)
    with pytest.raises(StageError, match=r"exact has 163 unknowns here, which need \d\.\d GiB .* at most 162; use"):
        field_of(icosahedron(), voxel_size=0.3, interpolation="exact")
    monkeypatch.setattr(interpolation, "MOST_UNKNOWNS", 163)
    assert field_of(icosahedron(), voxel_size=0.3, interpolation="exact").facts["unknowns"] == 163
    monkeypatch.setattr(interpolation, "available_memory", lambda: 600_000)
    with pytest.raises(StageError, match="exact has 163 unknowns here"):
        field_of(icosahedron(), voxel_size=0.3, interpolation="exact")
