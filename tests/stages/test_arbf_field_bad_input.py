"""Meshes and parameters that are odd or wrong: the field is right all the same, or one line says what is wrong."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from geometry.fields.oracle import HEXAHEDRON, Floats, Mesh, interpolant_of
from geometry.fields.shepard_oracle import extremes, jittered, net_of, oriented, shepard, tetrahedra
from scaffold_pipeline.artifacts import Certificate, OuterShape, ScalarField, VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from shapes import box, together

C, EXPONENT, SUPPORT = 0.002, 4, 1.0
BASES = ("gaussian", "multiquadric", "inverse_multiquadric")


def volume(mesh: Mesh) -> VolumeMesh:
    return VolumeMesh(mesh.vertices, **{CELL_TYPES[kind].plural: cells for kind, cells in mesh.cells.items()})


def box_around(vertices: Floats) -> OuterShape:
    return OuterShape(*box(tuple(vertices.min(axis=0)), tuple(vertices.max(axis=0))))


def field_of(mesh: Mesh, outer: OuterShape | None = None, **given: object) -> ScalarField:
    params = ArbfFieldParams.model_validate({"voxel_size": 0.13, **given})
    return arbf_field(volume(mesh), outer or box_around(mesh.vertices), params=params)


def told(mesh: Mesh, **given: object) -> tuple[ScalarField, list[str]]:
    """The field of `exact` and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        field = field_of(mesh, interpolation="exact", **given)
    assert all(warning.category is PipelineWarning for warning in caught)
    return field, [str(warning.message) for warning in caught]


def samples(field: ScalarField) -> tuple[Floats, Floats]:
    """The places (n, 3) and values (n,) of the samples that are void neither by order nor by lack of elements."""
    places = field.origin + field.spacing * np.argwhere(field.values > -1.0)
    return places, field.values[field.values > -1.0]


def require_oracle(mesh: Mesh, field: ScalarField) -> None:
    """Assert that the normalised field is that of the oracle, and certified."""
    places, values = samples(field)
    assert len(values) > 200
    np.testing.assert_allclose(values, shepard(net_of(mesh), places, C, EXPONENT, SUPPORT), rtol=0, atol=2e-5)
    assert certificate_of(field).channel_max <= 1.0


def certificate_of(field: ScalarField) -> Certificate:
    assert field.certificate is not None
    return field.certificate


def one_tetrahedron() -> Mesh:
    return oriented(Mesh(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)]), {"tetrahedron": np.arange(4)[None]}))


def apart(mesh: Mesh) -> Mesh:
    """The same cells, each with vertices of its own at the places of its neighbours'."""
    ((kind, cells),) = mesh.cells.items()
    return Mesh(mesh.vertices[cells].reshape(-1, 3), {kind: np.arange(cells.size).reshape(cells.shape)})


def beside(one: Mesh, other: Mesh) -> Mesh:
    ((kind, cells),) = one.cells.items()
    more = other.cells[kind] + len(one.vertices)
    return Mesh(np.concatenate([one.vertices, other.vertices]), {kind: np.concatenate([cells, more])})


def moved(mesh: Mesh, step: tuple[float, float, float], scale: float = 1.0) -> Mesh:
    return Mesh(scale * mesh.vertices + np.array(step), mesh.cells)


def sliver(height: float) -> Mesh:
    """Two tetrahedra on one face, one nearly flat: its centre, a vertex and the face's centre are almost one."""
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1 / 3, 1 / 3, height), (0.3, 0.3, -1.0)])
    return oriented(Mesh(vertices, {"tetrahedron": np.array([(0, 1, 2, 3), (0, 1, 2, 4)])}))


def folded_hexahedron() -> Mesh:
    """A hexahedron two edges of which have no length."""
    vertices = HEXAHEDRON.copy()
    vertices[[6, 7]] = vertices[[5, 4]]
    return Mesh(vertices, {"hexahedron": np.arange(8)[None]})


def hanging() -> Mesh:
    """A cube with four small ones on its top: a vertex of theirs lies on its face, and on the end of its channel."""
    corners = [0.5 * HEXAHEDRON + (x, y, 1.0) for x in (0, 0.5) for y in (0, 0.5)]
    small, cells = np.unique(np.concatenate([HEXAHEDRON, *corners]), axis=0, return_inverse=True)
    return Mesh(small, {"hexahedron": cells.reshape(-1, 8)})


@pytest.mark.parametrize(
    "make",
    [
        one_tetrahedron,
        folded_hexahedron,
        lambda: sliver(1e-3),
        lambda: sliver(1e-14),
        lambda: apart(jittered(tetrahedra((1, 1, 1)))),
        lambda: beside(tetrahedra((1, 1, 1)), moved(tetrahedra((1, 1, 1)), (1.0, 1.0, 1.0))),
        lambda: beside(tetrahedra((1, 1, 1)), moved(tetrahedra((1, 1, 1)), (0.05, 0.1, 0.2), 0.7)),
        hanging,
    ],
    ids=[
        "no interior",
        "edges of no length",
        "flat cell",
        "channel of next to no length",
        "coincident vertices",
        "bodies that touch",
        "bodies on top of each other",
        "hanging nodes",
    ],
)
def test_an_odd_mesh_has_the_field_of_its_elements(make: Callable[[], Mesh]):
    mesh = make()
    require_oracle(mesh, field_of(mesh, support=SUPPORT))


@pytest.mark.parametrize("make", [lambda: sliver(1e-14), hanging], ids=["flat cell", "hanging node"])
def test_a_channel_that_ends_where_it_is_solid_is_counted_as_closed(make: Callable[[], Mesh]):
    mesh = make()
    certificate = certificate_of(field_of(mesh))
    greatest, _ = extremes(net_of(mesh), C, EXPONENT, SUPPORT, 257)
    assert certificate.channel_max == pytest.approx(greatest.max(), abs=1e-3)
    assert certificate.at(0.0)["channels_closed"] == (greatest >= 0.0).sum() > 0
    assert certificate.channel_maxima.min() < -0.9


def test_two_bodies_far_apart_have_each_its_own_field():
    one = tetrahedra((1, 1, 1))
    outer = OuterShape(*together(box((0, 0, 0), (1, 1, 1)), box((9.1, 0, 0), (10.1, 1, 1))))
    pair = field_of(beside(one, moved(one, (9.1, 0.0, 0.0))), outer)
    alone = field_of(one)
    np.testing.assert_allclose(pair.values[: len(alone.values)], alone.values, rtol=0, atol=1e-5)
    np.testing.assert_allclose(pair.values[-len(alone.values) :], alone.values, rtol=0, atol=1e-5)
    assert len(certificate_of(pair).channel_maxima) == 2 * len(certificate_of(alone).channel_maxima)


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e6), (1e-6, 1.0), (1e6, 1e12)])
def test_neither_tiny_nor_huge_units_nor_a_far_place_change_the_field(scale: float, offset: float):
    mesh = tetrahedra((2, 1, 1))  # its corners are exact wherever it lies, up to the last
    far = moved(mesh, (offset, -offset, offset), scale)
    one, other = field_of(mesh), field_of(far, voxel_size=0.13 * scale)
    inner = np.s_[4:-4, 4:-4, 4:-4]  # where a sample lies on the surface, its last digit decides
    np.testing.assert_allclose(other.values[inner], one.values[inner], rtol=0, atol=2e-5)
    for name in ("channel_max", "strut_min"):
        assert getattr(certificate_of(other), name) == pytest.approx(getattr(certificate_of(one), name), abs=1e-5)


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e6)])
def test_the_exact_field_is_the_same_far_away_and_in_other_units_where_c_goes_with_them(scale: float, offset: float):
    mesh = tetrahedra((1, 1, 1))
    one, said = told(mesh)
    other, said_too = told(moved(mesh, (offset, -offset, offset), scale), voxel_size=0.13 * scale, c=0.1 * scale)
    assert said == said_too == []
    inner = np.s_[4:-4, 4:-4, 4:-4]
    np.testing.assert_allclose(other.values[inner], one.values[inner], rtol=0, atol=1e-5)
    places, values = samples(one)
    expected = interpolant_of(mesh, "inverse_multiquadric", "endpoint-to-segment", 0.1).at(places)
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-6)


def test_exact_with_lengths_far_below_c_warns_that_the_field_is_not_to_be_trusted():
    _, said = told(moved(tetrahedra((1, 1, 1)), (0.0, 0.0, 0.0), 1e-6), voxel_size=0.13e-6)
    assert any("rank" in line for line in said)
    assert any("the field is not reliable" in line for line in said)


def test_exact_with_coincident_elements_has_the_field_of_the_merged_mesh_and_a_warning():
    mesh = tetrahedra((1, 1, 1))
    merged, none = told(mesh)
    field, said = told(apart(mesh))
    assert none == []
    assert field.facts["unknowns"] == 24 + 24 + 6 + 24
    assert field.facts["rank"] == merged.facts["unknowns"] == 8 + 18 + 6 + 24
    assert float(field.facts["residual"] or 0.0) < 1e-12
    np.testing.assert_allclose(field.values, merged.values, rtol=0, atol=1e-5)
    assert len(said) == 1
    assert said[0].startswith("exact: several interpolants exist, as elements coincide (rank 56 of 78)")


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, {"tetrahedron": mesh.cells["tetrahedron"][:, [1, 0, 2, 3]]})


def with_vertex(mesh: Mesh, place: float) -> Mesh:
    vertices = mesh.vertices.copy()
    vertices[0, 0] = place
    return Mesh(vertices, mesh.cells)


def with_cell(mesh: Mesh, corners: list[int]) -> Mesh:
    return Mesh(mesh.vertices, {"tetrahedron": np.vstack([mesh.cells["tetrahedron"], corners])})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (inside_out, "VolumeMesh.tetrahedra: every cell must have a positive volume, but 6 of 6 do not"),
        (lambda mesh: with_vertex(mesh, np.nan), "VolumeMesh.vertices: must be finite, but 1 values are NaN"),
        (lambda mesh: with_vertex(mesh, -np.inf), "VolumeMesh.vertices: must be finite"),
        (lambda mesh: with_cell(mesh, [0, 1, 2, 2]), "every cell must have distinct corners, but 1 of 7 do not"),
        (lambda mesh: with_cell(mesh, [0, 1, 2, 3]), "must have a positive volume, but 1 of 7 do not"),  # one square
        (
            lambda mesh: with_cell(mesh, mesh.cells["tetrahedron"][3].tolist()),
            "VolumeMesh: a face must have one cell on each side at most, but 4 have more",
        ),
        (
            lambda mesh: Mesh(np.vstack([mesh.vertices, (9, 9, 9)]), mesh.cells),
            "VolumeMesh.vertices: every vertex must belong to a cell, 1 do not",
        ),
    ],
    ids=["inverted", "not a number", "infinite", "repeated corner", "flat", "cell given twice", "unused vertex"],
)
def test_a_mesh_that_is_none_is_refused_before_any_field(change: Callable[[Mesh], Mesh], said: str):
    mesh = tetrahedra((1, 1, 1))
    with pytest.raises(StageError, match=said):
        field_of(change(mesh), box_around(mesh.vertices))


@pytest.mark.parametrize("c", [0.0, -1e-300, float("nan"), float("inf")])
@pytest.mark.parametrize("basis", [*BASES, None])
def test_a_shape_parameter_that_is_no_positive_number_is_refused(basis: str | None, c: float):
    given = {"interpolation": "exact", "basis": basis} if basis else {}
    with pytest.raises(ValidationError, match=r"^1 validation error for ArbfFieldParams\nc\n.*(greater than 0|finite)"):
        ArbfFieldParams.model_validate({"voxel_size": 1.0, "c": c, **given})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"c": 1.01}, "c: must be from 0 to 1 with interpolation: normalised, got 1.01"),
        ({"c": 1e300}, "c: must be from 0 to 1 with"),
        ({"interpolation": "exact", "c": 1e-10}, "c: must be from 1e-09 to 1e.06 with interpolation: exact, got 1e-10"),
        ({"interpolation": "exact", "c": 1e160, "basis": "gaussian"}, "c: must be from 1e-09 to 1e.06"),
        ({"support": 10.1}, "support\n  Input should be less than or equal to 10"),
    ],
)
def test_a_parameter_with_which_the_field_would_lose_its_digits_or_reach_all_elements_is_refused(
    given: dict[str, object], said: str
):
    with pytest.raises(ValidationError, match=said):
        ArbfFieldParams.model_validate({"voxel_size": 1.0, **given})
