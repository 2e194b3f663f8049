"""The field's files: what others read from them is the field, in its place."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scaffold_pipeline.artifacts import OuterShape, ScalarField
from scaffold_pipeline.errors import StageError
from scaffold_stages import write_field as module
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from scaffold_stages.write_field import WriteFieldParams, write_field
from shapes import box, tetrahedra


@pytest.fixture
def field():
    values = np.random.default_rng(0).normal(size=(3, 4, 5)).astype(np.float32)
    return ScalarField(values, np.array([-1.5, 2.0, 1e3 / 3]), 0.1)


def test_all_formats_hold_the_values_the_origin_and_the_spacing(field, tmp_path):
    written = write_field(field, params=WriteFieldParams(), out=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"field.vti", "field.nrrd", "field.npy", "field.json"}
    assert written.summary()["npy_bytes"] == (tmp_path / "field.npy").stat().st_size
    np.testing.assert_array_equal(np.load(tmp_path / "field.npy"), field.values)
    place = json.loads((tmp_path / "field.json").read_text())
    assert place == {"origin": field.origin.tolist(), "spacing": 0.1, "shape": [3, 4, 5], "unit": "mm"}


def test_pyvista_reads_the_vti_in_its_place(field, tmp_path):
    import pyvista

    write_field(field, params=WriteFieldParams(formats=("vti",)), out=tmp_path)
    image = pyvista.read(tmp_path / "field.vti")
    assert image.origin == pytest.approx(field.origin, abs=0.0)
    assert image.spacing == (0.1, 0.1, 0.1)
    place = field.origin + 0.1 * np.array([2, 1, 3])
    assert image.point_data["s"][image.find_closest_point(place)] == field.values[2, 1, 3]


def test_the_nrrd_says_where_it_lies_in_its_header(field, tmp_path):
    write_field(field, params=WriteFieldParams(formats=("nrrd",)), out=tmp_path)
    header, _, data = (tmp_path / "field.nrrd").read_bytes().partition(b"\n\n")
    lines = header.decode().splitlines()
    assert lines[0] == "NRRD0004"
    assert "sizes: 3 4 5" in lines
    assert f"space origin: (-1.5,2,{1e3 / 3:.17g})" in lines
    assert np.frombuffer(data, "<f4").reshape((3, 4, 5), order="F").tolist() == field.values.tolist()


def test_the_same_field_gives_the_same_bytes(field, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_field(field, params=WriteFieldParams(), out=tmp_path / name)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_a_file_that_does_not_give_the_field_back_is_deleted(field, tmp_path, monkeypatch):
    monkeypatch.setitem(module._READERS, "npy", lambda path: np.load(path).ravel(order="F") + 1)
    with pytest.raises(StageError, match=r"field\.npy: differs from the field when read back"):
        write_field(field, params=WriteFieldParams(formats=("npy",)), out=tmp_path)
    assert not (tmp_path / "field.npy").exists()


def test_points_that_the_field_was_not_evaluated_at_are_an_error(field, tmp_path):
    points = tmp_path / "places.csv"
    points.write_text("0,0,0\n")
    with pytest.raises(StageError, match=r"not evaluated at places\.csv"):
        write_field(field, params=WriteFieldParams(points=points), out=tmp_path)


def test_points_are_evaluated_by_the_field_itself_and_written_with_their_values(tmp_path):
    mesh, outer = tetrahedra((1, 1, 1), edge=4.0), OuterShape(*box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)))
    path = tmp_path / "places.csv"
    path.write_text("x,y,z\n0,0,0\n2.0,0.0,0.0\n1e3,0,0\n")
    field = arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=0.5, points=path))
    write_field(field, params=WriteFieldParams(formats=("npy",), points=path), out=tmp_path)
    rows = np.loadtxt(tmp_path / "field_at_points.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, :3], [[0, 0, 0], [2, 0, 0], [1e3, 0, 0]])
    assert rows[:2, 3] == pytest.approx([1.0, 1.0], abs=1e-3)  # a vertex and the middle of a strut
    assert rows[2, 3] == -1.0  # nothing reaches so far


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "must hold rows"),
        ("1,2\n", r"got shape \(1, 2\)"),
        ("1,2,nan\n", "rows of finite"),
        ("x,y,z\n1,2,three\n", "not comma-separated numbers"),
        ("1,2,3\n1,2\n", "not comma-separated numbers"),
    ],
)
def test_points_that_are_no_points_are_an_error(tmp_path, text, said):
    mesh, outer = tetrahedra((1, 1, 1), edge=4.0), OuterShape(*box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)))
    path = tmp_path / "places.csv"
    path.write_text(text)
    with pytest.raises(StageError, match=said):
        arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=0.5, points=path))


def test_a_given_grid_takes_the_place_of_a_voxel_size():
    mesh, outer = tetrahedra((1, 1, 1), edge=4.0), OuterShape(*box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)))
    grid = {"origin": (-1.0, -1.0, -1.0), "spacing": 0.25, "shape": (25, 26, 27)}
    field = arbf_field(mesh, outer, params=ArbfFieldParams(grid=grid))
    assert field.values.shape == (25, 26, 27)
    assert field.origin.tolist() == [-1.0, -1.0, -1.0]
    finer = arbf_field(mesh, outer, params=ArbfFieldParams(grid={**grid, "spacing": 0.125, "shape": (49, 51, 53)}))
    np.testing.assert_allclose(finer.values[8:41:2, 8:41:2, 8:41:2], field.values[4:21, 4:21, 4:21], atol=1e-5)


def test_a_grid_that_does_not_cover_the_outer_shape_is_a_warning():
    mesh, outer = tetrahedra((1, 1, 1), edge=4.0), OuterShape(*box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)))
    grid = {"origin": (1.0, 1.0, 1.0), "spacing": 0.25, "shape": (4, 4, 4)}
    with pytest.warns(UserWarning, match="does not cover the outer shape"):
        arbf_field(mesh, outer, params=ArbfFieldParams(grid=grid))


@pytest.mark.parametrize(
    "given", [{}, {"voxel_size": 1.0, "grid": {"origin": (0, 0, 0), "spacing": 1, "shape": (2, 2, 2)}}]
)
def test_a_voxel_size_or_a_grid_is_asked_for(given):
    with pytest.raises(ValueError, match="give either voxel_size or grid"):
        ArbfFieldParams(**given)
