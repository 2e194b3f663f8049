"""The whole chain as a user starts it: configs in, judged solids out."""

import json
import shutil
from pathlib import Path

import pytest

from end_to_end.solid_judge import faults_of
from scaffold_pipeline.cli.app import main

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
BONES = ROOT.parent / "shared" / "data" / "anatomy"
FILES = {"config.yaml", "measures.json", "metrics.json", "report.html", "run.json", "solid.stl"}


@pytest.fixture(scope="module")
def minimal(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "minimal"
    assert main(["run", str(CONFIGS / "minimal.yaml"), "--out", str(out), "--quiet"]) == 0
    return out


def hashes(out):
    record = json.loads((out / "run.json").read_text())
    return {stage["label"]: stage["output"] for stage in record["stages"]}


def test_the_minimal_config_makes_a_printable_solid(minimal):
    metrics = json.loads((minimal / "metrics.json").read_text())
    assert faults_of(minimal / "solid.stl", metrics["outer_volume_mm3"], 0.6) == []
    assert metrics["quality"] == "pass"
    assert metrics["channel_max"] < metrics["iso"] < metrics["strut_min"]
    assert {path.name for path in minimal.iterdir() if not path.name.startswith(".")} == FILES


def test_the_judge_refuses_another_porosity_and_an_open_file(minimal, tmp_path):
    volume = json.loads((minimal / "metrics.json").read_text())["outer_volume_mm3"]
    assert faults_of(minimal / "solid.stl", volume, 0.5) != []
    content = bytearray((minimal / "solid.stl").read_bytes())
    count = int.from_bytes(content[80:84], "little") - 1
    content[80:84] = count.to_bytes(4, "little")
    broken = tmp_path / "broken.stl"
    broken.write_bytes(content[: 84 + 50 * count])
    assert any("closed" in fault for fault in faults_of(broken, volume, 0.6))


def test_a_second_run_changes_nothing(minimal, capsys):
    before = (minimal / "solid.stl").read_bytes()
    assert main(["run", str(minimal / "config.yaml"), "--out", str(minimal)]) == 0
    assert (minimal / "solid.stl").read_bytes() == before
    lines = [line for line in capsys.readouterr().err.splitlines() if ": warning: " not in line]
    assert len(lines) == 9
    assert all("unchanged" in line for line in lines)


def test_everything_after_the_stored_mesh_is_repeated_to_the_bit(minimal, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(minimal, copy)
    later = ["jitter", "arbf_field", "isosurface", "clean_surface", "intersect_outer", "measure", "write_solid"]
    config = str(CONFIGS / "minimal.yaml")
    assert main(["run", config, "--out", str(copy), "--quiet", "--force", *later]) == 0
    assert hashes(copy) == hashes(minimal)
    assert (copy / "solid.stl").read_bytes() == (minimal / "solid.stl").read_bytes()


def test_a_skin_closes_the_surface_and_the_porosity_is_met_with_it(minimal, tmp_path):
    copy = tmp_path / "skin"
    shutil.copytree(minimal, copy)
    changes = ["--set", "intersect_outer.skin=0.5", "--set", "isosurface.porosity=0.45"]
    assert main(["run", str(CONFIGS / "minimal.yaml"), "--out", str(copy), "--quiet", *changes]) == 0
    metrics = json.loads((copy / "metrics.json").read_text())
    assert metrics["porosity"] == pytest.approx(0.45, abs=0.005)
    assert metrics["closed_pores"] == metrics["solid_pieces"] == 1


def test_a_mesh_of_the_solid_that_fails_does_not_cost_the_solid(minimal, tmp_path, capsys):
    out, config = tmp_path / "out", tmp_path / "meshed.yaml"
    shutil.copytree(minimal, out)
    original = (CONFIGS / "minimal.yaml").read_text()
    config.write_text(original + "  - use: mesh_solid\n    time_limit: 0.01\n")
    assert main(["run", str(config), "--out", str(out), "--quiet"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("mesh_solid: gave no result within 0 s; ")
    assert "without mesh_solid in the config, the same command writes its files" in line
    config.write_text(original.replace("name: minimal", "name: unmeshed"))
    assert main(["run", str(config), "--out", str(out)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if ": warning: " not in line]
    assert all("unchanged" in line for line in lines), lines
    assert (out / "solid.stl").read_bytes() == (minimal / "solid.stl").read_bytes()


@pytest.mark.parametrize("path", sorted(CONFIGS.rglob("*.yaml")), ids=lambda path: path.stem)
def test_every_config_has_a_plan(path, tmp_path):
    arguments = ["validate", str(path)]
    if path.stem == "heel":  # a template: its user names the bone
        bone = tmp_path / "heel.stl"
        bone.write_bytes(b"only its name matters here")
        arguments += ["--set", f"load_surface.path={bone}"]
    assert main(arguments) == 0


@pytest.mark.parametrize(("bone", "unit", "edge", "voxel"), [("bmf_CalcaneusR.obj", "m", 9, 0.33)])
def test_a_real_bone_becomes_a_printable_solid(bone, unit, edge, voxel, tmp_path):
    if not BONES.is_dir():
        pytest.skip("the real bones are not beside this checkout")
    sizes = [f"load_surface.path={BONES / bone}", f"load_surface.units={unit}"]
    sizes += [f"tetrahedralise.edge_length={edge}", f"arbf_field.voxel_size={voxel}", "write_solid.preview=false"]
    settings = [word for size in sizes for word in ("--set", size)]
    assert main(["run", str(CONFIGS / "heel.yaml"), "--out", str(tmp_path / "out"), "--quiet", *settings]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    for name in ("solid.stl", "solid.3mf"):
        assert faults_of(tmp_path / "out" / name, metrics["outer_volume_mm3"], 0.65) == []
