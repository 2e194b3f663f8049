"""What the README says is what the code does."""

import json
import webbrowser
from pathlib import Path

import pytest
import trimesh

from scaffold_pipeline.cli.app import app
from scaffold_pipeline.stages.catalogue import markdown_table, metrics_table

README = (Path(__file__).parents[2] / "README.md").read_text()


def block(mark, language="bash"):
    """Return the code block that follows a mark, as `.ci/run` reads it."""
    return README.partition(f"<!-- {mark} -->")[2].partition(f"```{language}\n")[2].partition("```")[0].strip()


def test_the_stage_table_is_the_one_that_the_code_prints():
    table = README.partition("`scaffold-pipeline stages --markdown` -->")[2].partition("<!-- end of stages -->")[0]
    assert table.strip() == markdown_table()


def test_the_table_of_what_is_measured_is_the_one_that_the_code_prints():
    table = README.partition("`scaffold-pipeline stages --metrics` -->")[2].partition("<!-- end of metrics -->")[0]
    assert table.strip() == metrics_table()


def test_the_two_commands_are_where_the_check_looks_for_them():
    assert block("main").endswith("scaffold-pipeline run configs/femoral_head.yaml")
    assert block("tests").endswith("&& pytest -n auto")


def test_every_command_is_in_the_readme():
    commands = [name for name in app if not name.startswith("-")]
    assert "run" in commands
    assert [name for name in commands if f"| `{name}" not in README] == []


def test_the_lines_of_python_do_what_they_say(tmp_path, monkeypatch, capsys):
    stages = [
        {"use": "make_mesh", "shape": "block", "cell": "tetrahedron", "counts": 1, "edge": 6.0},
        {"use": "extract_outer"},
        {"use": "arbf_field", "voxel_size": 0.5},
        {"use": "isosurface", "porosity": 0.6},
        {"use": "intersect_outer"},
        {"use": "measure", "morphometry": False, "gate_certificate": False, "gate_interrupted": False},
        {"use": "write_solid", "formats": ["stl"], "preview": False},
    ]
    (tmp_path / "heel.yaml").write_text(json.dumps({"name": "heel", "stages": stages}))
    (tmp_path / "porosity.yaml").write_text("base: heel.yaml\nvary: {isosurface.porosity: [0.5, 0.6]}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    names = {"mesh": trimesh.creation.icosphere(subdivisions=2, radius=9.0)}
    exec(block("python", "python"), names)  # noqa: S102 - the README's own lines
    assert names["bone"].is_watertight
    assert len(opened) == 1
    assert [row["isosurface.porosity"] for row in names["table"]] == [0.5, 0.6]
    assert float(capsys.readouterr().out.split()[0]) == pytest.approx(0.7, abs=0.01)
