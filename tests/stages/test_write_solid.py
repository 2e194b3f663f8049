from __future__ import annotations

import hashlib
import signal
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.drawing import renders
from scaffold_geometry.files.solids.formats import FORMATS, FileFormat
from scaffold_pipeline import stages
from scaffold_pipeline.artifacts import Solid
from scaffold_pipeline.errors import ConfigError, PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.write_solid import WriteSolidParams, write_solid

ALL = ("stl", "3mf", "obj", "ply", "glb")
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


def test_the_stage_keeps_the_contract():
    stage = stage_from_function("write_solid", write_solid)

    assert (stage.writes, list(stage.reads)) == ("written", ["solid", "outer"])
    assert [read.optional for read in stage.reads.values()] == [False, True]
    assert stage.engine_arguments == {"params", "out", "config_hash"}


def test_facts_are_those_of_the_files(tmp_path: Path):
    facts = write_solid(ONE, params=quiet(formats=ALL), out=tmp_path).facts

    for kind in ALL:
        content = (tmp_path / f"solid.{kind}").read_bytes()
        assert facts[f"{kind}_bytes"] == len(content)
        assert facts[f"{kind}_sha256"] == hashlib.sha256(content).hexdigest()
        assert facts[f"{kind}_triangles"] == 12
        assert facts[f"{kind}_volume_mm3"] == pytest.approx(8.0)
    assert facts["preview"] == "not asked for"


def test_facts_name_the_readers_of_each_file(tmp_path: Path):
    facts = write_solid(ONE, params=quiet(formats=ALL), out=tmp_path).facts

    assert facts["3mf_read_by"] == "lib3mf, expat, manifold3d"
    assert {facts[f"{kind}_read_by"] for kind in ALL if kind != "3mf"} == {"trimesh, VTK, manifold3d"}


def test_only_the_formats_asked_for_are_written(tmp_path: Path):
    facts = write_solid(ONE, params=quiet(formats=("3mf",)), out=tmp_path).facts

    assert [path.name for path in tmp_path.iterdir()] == ["solid.3mf"]
    assert "stl_bytes" not in facts


def test_bytes_are_the_same_each_time(tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        write_solid(ONE, params=quiet(formats=ALL), out=folder, config_hash=HASH)

    for kind in ALL:
        assert len({(folder / f"solid.{kind}").read_bytes() for folder in folders}) == 1


def test_a_closed_pore_is_accepted(tmp_path: Path):
    hollow = cubes((4.0, (0.0, 0.0, 0.0), True), (1.0, (1.0, 1.0, 1.0), False))

    assert write_solid(hollow, params=quiet(), out=tmp_path).facts["stl_volume_mm3"] == pytest.approx(63.0)


@pytest.mark.parametrize("kind", ALL)
def test_an_open_solid_is_refused_and_leaves_no_file(tmp_path: Path, kind: str):
    message = "must be closed, but 3 edges have one triangle only" if kind != "3mf" else "lib3mf says it is not"

    write_bad(Solid(ONE.vertices, ONE.faces[1:]), tmp_path, rf"^solid\.{kind}: .*{message}", formats=(kind,))


def test_a_solid_with_a_flipped_triangle_is_refused(tmp_path: Path):
    faces = ONE.faces.copy()
    faces[0] = faces[0, ::-1]

    write_bad(Solid(ONE.vertices, faces), tmp_path, "two of the same direction")


def test_a_piece_that_is_inside_out_is_refused(tmp_path: Path):
    stray = cubes((4.0, (0.0, 0.0, 0.0), True), (1.0, (6.0, 0.0, 0.0), False))

    write_bad(stray, tmp_path, "must be outward, but 1 of 2 shells are inverted")


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
    with pytest.warns(PipelineWarning, match=r"4 of 8 vertices are not exact in float32; .* moved by up to .* mm"):
        write_solid(Solid(ONE.vertices * [0.1, 1.0, 1.0], ONE.faces), params=quiet(), out=tmp_path)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"formats": ("stl", "stl")}, "must name each format once"),
        ({"formats": ()}, "at least 1 item"),
        ({"formats": ("step",)}, "'stl', '3mf', 'obj', 'ply' or 'glb'"),
        ({"colour": "bone"}, "should match pattern"),
        ({"colour": None}, "valid string"),
        ({"name": "two\nlines"}, "printable characters"),
        ({"name": ""}, "at least 1 character"),
    ],
)
def test_parameters_out_of_bounds_are_refused(parameters: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        WriteSolidParams.model_validate(parameters)


@pytest.mark.parametrize(
    ("formats", "message"),
    [
        (["stp"], "write_solid: formats.0: must be 'stl', '3mf', 'obj', 'ply' or 'glb', got 'stp'"),
        ("stl", "write_solid: formats: must be a list, got 'stl'"),
        ([], "write_solid: formats: must have at least 1 item, got []"),
    ],
)
def test_a_fault_of_the_formats_is_one_line_in_words_of_yaml(tmp_path: Path, formats: object, message: str):
    with pytest.raises(ConfigError) as caught:
        stages.write_solid(ONE, formats=formats, out=tmp_path)
    assert str(caught.value) == message


def test_a_picture_that_cannot_be_drawn_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def die(*_: object, **__: object) -> None:
        raise StageError("was ended by SIGSEGV")

    monkeypatch.setattr(renders, "call_in_child", die)

    with pytest.warns(PipelineWarning, match=r"no preview\.png was drawn: .*SIGSEGV.*libegl1 and libgl1-mesa-dri"):
        facts = write_solid(ONE, params=WriteSolidParams(), out=tmp_path).facts

    assert str(facts["preview"]).startswith("none: was ended by SIGSEGV")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["solid.3mf", "solid.stl"]


def test_the_picture_is_what_was_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    drawn = {"png": np.frombuffer(b"\x89PNG", np.uint8)}
    monkeypatch.setattr(renders, "call_in_child", lambda *_, **__: drawn)

    facts = write_solid(ONE, params=WriteSolidParams(), out=tmp_path).facts

    assert facts["preview"] == "preview.png"
    assert (tmp_path / "preview.png").read_bytes() == b"\x89PNG"


def test_a_piece_in_another_piece_is_refused(tmp_path: Path):
    nested = cubes((4.0, (0.0, 0.0, 0.0), True), (1.0, (1.0, 1.0, 1.0), True))

    write_bad(nested, tmp_path, "1 of 2 shells are inverted or inside another's solid")


def test_a_piece_in_a_closed_pore_is_accepted(tmp_path: Path):
    loose = cubes((9.0, (0.0, 0.0, 0.0), True), (5.0, (2.0, 2.0, 2.0), False), (1.0, (4.0, 4.0, 4.0), True))

    assert write_solid(loose, params=quiet(), out=tmp_path).facts["stl_volume_mm3"] == pytest.approx(605.0)


def test_closed_pores_other_than_promised_are_refused(tmp_path: Path):
    promising = Solid(ONE.vertices, ONE.faces, facts={"closed_pores": 2})

    write_bad(promising, tmp_path, "must have the solid's pieces and closed pores, 1 and 2, but has 1 and 0")


def test_a_solid_that_intersects_itself_is_refused(tmp_path: Path):
    crossing = cubes((2.0, (0.0, 0.0, 0.0), True), (2.0, (1.0, 1.25, 1.5), True))

    write_bad(
        crossing, tmp_path, r"must not intersect itself, but \d+ triangles cross or touch another, the first at \("
    )


def test_a_solid_far_from_the_origin_is_told_of_its_coarse_coordinates(tmp_path: Path):
    far = Solid(ONE.vertices + 20_000.0, ONE.faces)

    with pytest.warns(PipelineWarning, match="20002 mm from the origin, where .* are 0.002 mm apart"):
        facts = write_solid(far, params=quiet(formats=ALL), out=tmp_path).facts

    assert facts["coordinate_step"] == 2.0**-9
    assert {facts[f"{kind}_volume_mm3"] for kind in ALL} == {8.0}


def test_a_failing_file_takes_the_good_ones_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise StageError("disk trouble")

    monkeypatch.setitem(FORMATS, "3mf", FileFormat(fail, FORMATS["3mf"].readers))

    write_bad(ONE, tmp_path, r"^solid\.3mf: disk trouble; no file was kept$")


def test_a_killed_process_leaves_no_file_under_its_name(tmp_path: Path):
    code = (
        "import os, signal, sys; from pathlib import Path; import numpy as np\n"
        "from scaffold_stages import write_solid as module; from scaffold_pipeline.artifacts import Solid\n"
        "def die(path, _):\n    path.write_bytes(b'half'); os.kill(os.getpid(), signal.SIGKILL)\n"
        "module.FORMATS['3mf'] = module.FORMATS['3mf'].__class__(die, {})\n"
        f"solid = Solid(np.array({ONE.vertices.tolist()}), np.array({ONE.faces.tolist()}))\n"
        "params = module.WriteSolidParams(formats=('stl', '3mf'), preview=False)\n"
        "module.write_solid(solid, params=params, out=Path(sys.argv[1]))"
    )

    died = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False, timeout=120)

    assert died.returncode == -signal.SIGKILL
    assert all(path.name.startswith(".partial-") for path in tmp_path.iterdir())
