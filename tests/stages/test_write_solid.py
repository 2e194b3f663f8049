from __future__ import annotations

import hashlib
import zipfile
from itertools import product
from pathlib import Path

import lib3mf
import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from scaffold_pipeline.artifacts import Solid
from scaffold_pipeline.contract import stage_from_function
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_stages import write_solid as module
from scaffold_stages.write_solid import WriteSolidParams, write_solid

HASH = "0123456789abcdef" * 4
CUBE = np.array(list(product((0.0, 1.0), repeat=3)))
CUBE_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def quiet(**parameters: object) -> WriteSolidParams:
    return WriteSolidParams.model_validate({"preview": False, **parameters})


def cubes(*placed: tuple[float, tuple[float, float, float], bool]) -> Solid:
    """Return cubes of given edge, corner and winding (True: outward)."""
    vertices = [edge * CUBE + np.array(corner) for edge, corner, _ in placed]
    faces = [(CUBE_FACES if outward else CUBE_FACES[:, ::-1]) + 8 * place for place, (*_, outward) in enumerate(placed)]
    return Solid(np.concatenate(vertices), np.concatenate(faces))


ONE = cubes((2.0, (0.0, 0.0, 0.0), True))


def write_bad(solid: Solid, out: Path, message: str, **parameters: object) -> None:
    with pytest.raises(StageError, match=message) as failure:
        write_solid(solid, params=quiet(**parameters), out=out)
    assert "\n" not in str(failure.value)
    assert list(out.iterdir()) == []


def read_model(path: Path) -> object:
    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))
    return model


def test_the_stage_keeps_the_contract():
    stage = stage_from_function("write_solid", write_solid)

    assert (stage.writes, list(stage.reads)) == ("written", ["solid"])
    assert stage.engine_arguments == {"params", "out", "config_hash"}


def test_facts_are_those_of_the_files(tmp_path: Path):
    facts = write_solid(ONE, params=quiet(), out=tmp_path).facts

    for kind in ("stl", "3mf"):
        content = (tmp_path / f"solid.{kind}").read_bytes()
        assert facts[f"{kind}_bytes"] == len(content)
        assert facts[f"{kind}_sha256"] == hashlib.sha256(content).hexdigest()
        assert facts[f"{kind}_triangles"] == 12
        assert facts[f"{kind}_volume_mm3"] == pytest.approx(8.0)
    assert facts["preview"] == "not asked for"


def test_only_the_formats_asked_for_are_written(tmp_path: Path):
    facts = write_solid(ONE, params=quiet(formats=("3mf",)), out=tmp_path).facts

    assert [path.name for path in tmp_path.iterdir()] == ["solid.3mf"]
    assert "stl_bytes" not in facts


def test_bytes_are_the_same_each_time(tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        write_solid(ONE, params=quiet(), out=folder, config_hash=HASH)

    for name in ("solid.stl", "solid.3mf"):
        assert len({(folder / name).read_bytes() for folder in folders}) == 1


def test_the_stl_names_project_and_unit(tmp_path: Path):
    write_solid(ONE, params=quiet(formats=("stl",)), out=tmp_path)
    header = (tmp_path / "solid.stl").read_bytes()[:80]

    assert header.startswith(b"scaffold-pipeline")
    assert b"mm" in header


def test_3mf_unit_and_metadata_are_read_back(tmp_path: Path):
    write_solid(ONE, params=quiet(name="Fersenbein <2> & Knöchel"), out=tmp_path, config_hash=HASH)
    model = read_model(tmp_path / "solid.3mf")
    group = model.GetMetaDataGroup()

    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    assert group.GetMetaDataByKey("", "Title").GetValue() == "Fersenbein <2> & Knöchel"
    assert group.GetMetaDataByKey("", "Application").GetValue().startswith("scaffold-pipeline ")
    assert group.GetMetaDataByKey("urn:scaffold-pipeline", "config_sha256").GetValue() == HASH


def test_without_a_hash_the_3mf_names_none(tmp_path: Path):
    write_solid(ONE, params=quiet(), out=tmp_path)

    assert read_model(tmp_path / "solid.3mf").GetMetaDataGroup().GetMetaDataCount() == 2


def test_3mf_keeps_every_float32_to_the_bit(tmp_path: Path):
    ball = trimesh.creation.icosphere(3)
    vertices = (np.asarray(ball.vertices) * [1e-3, 30.0, 700.0] + [0.0, 100.0, -1000.0]).astype(np.float32)
    write_solid(Solid(vertices, np.asarray(ball.faces)), params=quiet(), out=tmp_path)
    mesh = trimesh.load_mesh(tmp_path / "solid.3mf", process=False)

    assert np.array_equal(np.asarray(mesh.vertices).astype(np.float32), vertices)
    assert np.array_equal(mesh.faces, ball.faces)


def test_the_3mf_package_holds_what_the_standard_asks_for(tmp_path: Path):
    write_solid(ONE, params=quiet(), out=tmp_path)
    with zipfile.ZipFile(tmp_path / "solid.3mf") as package:
        assert package.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]


def test_a_closed_pore_is_accepted(tmp_path: Path):
    hollow = cubes((4.0, (0.0, 0.0, 0.0), True), (1.0, (1.0, 1.0, 1.0), False))

    assert write_solid(hollow, params=quiet(), out=tmp_path).facts["stl_volume_mm3"] == pytest.approx(63.0)


@pytest.mark.parametrize("kind", ["stl", "3mf"])
def test_an_open_solid_is_refused_and_leaves_no_file(tmp_path: Path, kind: str):
    message = "must be closed, but 3 edges have one triangle only" if kind == "stl" else "lib3mf says it is not"

    write_bad(Solid(ONE.vertices, ONE.faces[1:]), tmp_path, rf"^solid\.{kind}: .*{message}", formats=(kind,))


def test_a_solid_with_a_flipped_triangle_is_refused(tmp_path: Path):
    faces = ONE.faces.copy()
    faces[0] = faces[0, ::-1]

    write_bad(Solid(ONE.vertices, faces), tmp_path, "walked twice in one direction")


def test_a_piece_that_is_inside_out_is_refused(tmp_path: Path):
    stray = cubes((4.0, (0.0, 0.0, 0.0), True), (1.0, (6.0, 0.0, 0.0), False))

    write_bad(stray, tmp_path, "must be outward, but 1 of 2 pieces are inside out")


@pytest.mark.filterwarnings("ignore::scaffold_pipeline.errors.PipelineWarning")
@pytest.mark.parametrize(
    ("corner", "message"),
    [
        ((1.0 + 1e-9, 1.0 + 1e-9, 0.0), "must be manifold, but 2 edges have more than two triangles"),
        ((1.0 + 1e-9, 1.0 + 1e-9, 1.0 + 1e-9), "must be manifold, but surfaces touch at 1 vertices"),
    ],
    ids=["edge", "vertex"],
)
def test_a_solid_pinched_by_rounding_is_refused(tmp_path: Path, corner: tuple[float, float, float], message: str):
    write_bad(cubes((1.0, (0.0, 0.0, 0.0), True), (1.0, corner, True)), tmp_path, message)


@pytest.mark.filterwarnings("ignore::scaffold_pipeline.errors.PipelineWarning")
def test_a_solid_collapsed_by_rounding_is_refused(tmp_path: Path):
    far = Solid(1e-6 * CUBE + 1000.0, CUBE_FACES)

    write_bad(far, tmp_path, "must have no collapsed edge")


def test_rounding_that_does_no_harm_is_a_warning(tmp_path: Path):
    with pytest.warns(PipelineWarning, match=r"4 of 8 vertices are not exact in float32; .* up to .* mm off"):
        write_solid(Solid(ONE.vertices * [0.1, 1.0, 1.0], ONE.faces), params=quiet(), out=tmp_path)


def test_a_file_of_another_volume_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def write_larger(path: Path, vertices: np.ndarray, faces: np.ndarray, metadata: dict[str, str]) -> None:
        module._write_stl(path, vertices * np.float32(1.001), faces, metadata)

    monkeypatch.setitem(module._WRITERS, "stl", write_larger)

    write_bad(ONE, tmp_path, r"must keep the solid's volume to 0\.0001, but it is 8\.024")


def test_a_file_that_lost_triangles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(module._READERS, "stl", lambda _: np.zeros((3, 3, 3), np.float32))

    write_bad(ONE, tmp_path, "must hold 12 triangles, but 3 were read back")


def test_an_stl_that_was_cut_off_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = module.to_stl
    monkeypatch.setattr(module, "to_stl", lambda *given: whole(*given)[:-1])

    write_bad(ONE, tmp_path, "must be valid binary STL, but trimesh says")


def test_a_3mf_in_inches_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    model = module._model

    monkeypatch.setattr(module, "_model", lambda *given: (t.replace("millimeter", "inch") for t in model(*given)))

    write_bad(ONE, tmp_path, "must hold one object in mm, but holds 1 in Inch", formats=("3mf",))


def test_a_3mf_that_is_no_3mf_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    model = module._model

    monkeypatch.setattr(module, "_model", lambda *given: (t.replace("</mesh>", "") for t in model(*given)))

    write_bad(ONE, tmp_path, "must be valid 3MF, but lib3mf says", formats=("3mf",))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"formats": ("stl", "stl")}, "must name each format once"),
        ({"formats": ()}, "at least 1 item"),
        ({"formats": ("obj",)}, "'stl' or '3mf'"),
        ({"name": "two\nlines"}, "printable characters"),
        ({"name": ""}, "at least 1 character"),
    ],
)
def test_parameters_out_of_bounds_are_refused(parameters: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        WriteSolidParams.model_validate(parameters)


def test_a_picture_that_cannot_be_drawn_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def die(*_: object, **__: object) -> None:
        raise StageError("was ended by SIGSEGV")

    monkeypatch.setattr(module, "call_in_child", die)

    with pytest.warns(PipelineWarning, match=r"no preview\.png was drawn: .*SIGSEGV.*libegl1 and libgl1-mesa-dri"):
        facts = write_solid(ONE, params=WriteSolidParams(), out=tmp_path).facts

    assert str(facts["preview"]).startswith("none: was ended by SIGSEGV")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["solid.3mf", "solid.stl"]


def test_the_picture_is_what_was_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    drawn = {"png": np.frombuffer(b"\x89PNG", np.uint8)}
    monkeypatch.setattr(module, "call_in_child", lambda *_, **__: drawn)

    facts = write_solid(ONE, params=WriteSolidParams(), out=tmp_path).facts

    assert facts["preview"] == "preview.png"
    assert (tmp_path / "preview.png").read_bytes() == b"\x89PNG"
