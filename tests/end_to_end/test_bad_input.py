"""Bad input ends in one clear line with the right exit code, leaves nothing half-written and damages no result."""

import json

import numpy as np
import pytest

from scaffold_geometry.files.binary_stl import to_stl
from scaffold_pipeline.cli.app import main

CUBE = np.array([[x, y, z] for x in (0, 10) for y in (0, 10) for z in (0, 10)], float)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip

CONFIG = """\
name: bad
seed: 1
stages:
  - use: load_surface
    path: {path}
    units: mm
  - use: tetrahedralise
    edge_length: 5.0
  - use: arbf_field
    voxel_size: {voxel}
  - use: isosurface
    porosity: {porosity}
  - use: clean_surface
  - use: intersect_outer
  - use: measure
  - use: write_solid
    preview: false
"""


@pytest.fixture
def run(tmp_path, capsys):
    """Run the chain on a surface; return the exit code and the lines of standard error that are no progress."""

    def start(content=None, *, path="part.stl", voxel=1.0, porosity=0.5, text=None):
        if content is not None:
            (tmp_path / path).write_bytes(content)
        config = tmp_path / "config.yaml"
        config.write_text(text or CONFIG.format(path=path, voxel=voxel, porosity=porosity))
        code = main(["run", str(config), "--out", str(tmp_path / "out"), "--quiet"])
        return code, capsys.readouterr().err.splitlines()

    return start


def cube(vertices=CUBE, faces=FACES):
    return to_stl(vertices, faces, "cube")


def with_not_a_number():
    content = bytearray(cube())
    content[84 + 12 : 84 + 16] = np.float32(np.nan).tobytes()
    return bytes(content)


def two_cubes_through_each_other():
    return cube(np.concatenate([CUBE, CUBE + 5.0]), np.concatenate([FACES, FACES + 8]))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "empty"),
        (b"<html><body>not found</body></html>", "STL"),
        (cube()[:300], "STL"),
        (with_not_a_number(), "NaN"),
        (cube(faces=FACES[1:]), "hole"),
    ],
    ids=["empty", "of another kind", "truncated", "not a number", "open"],
)
def test_a_file_that_is_no_closed_surface_is_one_line_and_exit_code_1(run, tmp_path, content, said):
    code, lines = run(content)
    assert code == 1
    assert len(lines) == 1
    assert lines[0].startswith("load_surface: ")
    assert said in lines[0]
    assert {path.name for path in (tmp_path / "out").iterdir()} <= {".lock", ".store"}


def test_a_surface_that_passes_through_itself_is_refused(run, tmp_path):
    (tmp_path / "part.stl").write_bytes(two_cubes_through_each_other())
    text = CONFIG.format(path="part.stl", voxel=1.0, porosity=0.5).replace("units: mm", "units: mm\n    component: all")
    code, lines = run(text=text)
    assert code == 1
    assert len(lines) == 1
    assert "intersect" in lines[0]


def test_a_missing_file_and_a_directory_are_faults_of_the_config(run, tmp_path):
    fault = "stages.0 (load_surface): path: no such file:"
    remedy = "paths in a config are relative to the config"
    line = f"{tmp_path}/config.yaml:5:5: {fault} {tmp_path}/nowhere.stl; {remedy}"
    assert run(path="nowhere.stl") == (2, [line])
    (tmp_path / "folder.stl").mkdir()
    code, lines = run(path="folder.stl")
    assert (code, len(lines)) == (2, 1)
    assert "is a directory" in lines[0]


@pytest.mark.parametrize("porosity", [0.0, 1.0, 1.5, -0.2, ".nan"])
def test_a_porosity_outside_0_to_1_is_a_fault_of_the_config(run, tmp_path, porosity):
    code, lines = run(cube(), porosity=porosity)
    assert (code, len(lines)) == (2, 1)
    assert ":12:5: stages.3 (isosurface): porosity: must be" in lines[0]
    assert not (tmp_path / "out").exists()


def test_voxels_for_which_no_machine_has_memory_are_refused_with_a_size_that_fits(run):
    code, lines = run(cube(), voxel=0.0005)
    assert (code, len(lines)) == (1, 1)
    assert "GiB are free" in lines[0]
    assert "mm or more" in lines[0]


def test_all_faults_of_a_config_and_its_plan_come_at_once(run):
    text = """\
name: bad
sede: 3
stages:
  - use: load_surfaces
    path: part.stl
  - use: jitter
    amont: 0.2
  - use: tetrahedralise
    edge_length: -5
"""
    code, lines = run(text=text)
    assert code == 2
    places = [line.split(": ", 1) for line in lines]
    assert [place.rsplit("config.yaml", 1)[1] for place, _ in places] == [":2:1", ":4:5", ":7:5", ":9:5"]
    assert "did you mean 'seed'?" in lines[0]
    assert "did you mean 'load_surface'?" in lines[1]
    assert "did you mean 'amount'?" in lines[2]
    assert "greater than 0, got -5" in lines[3]


def test_a_stage_out_of_order_is_named_with_the_stage_that_it_waits_for(run):
    text = """\
stages:
  - use: make_shape
  - use: jitter
  - use: tetrahedralise
    cells: 100
"""
    code, lines = run(text=text)
    assert (code, len(lines)) == (2, 1)
    assert ":3:5: stages.1 (jitter): reads slot 'mesh', which stages.2 (tetrahedralise) writes only later" in lines[0]


def test_a_failed_run_leaves_an_earlier_result_as_it_was(run, tmp_path):
    code, _ = run(cube(), voxel=0.4)
    assert code == 0
    out = tmp_path / "out"
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    assert "solid.stl" in before
    assert json.loads(before["metrics.json"])["quality"] == "pass"
    code, _ = run(cube(faces=FACES[1:]))
    assert code == 1
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
