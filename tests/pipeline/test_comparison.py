from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.report.wording import NOTHING

CONFIG = """
    seed: 7
    stages:
      - use: make_points
      - use: scatter_points
        amount: 0.1
      - use: write_points
      - use: count_points
    """


@pytest.fixture
def runs(project: Project) -> Project:
    """Two runs, `a` and `b`, that differ in one parameter."""
    project.write(CONFIG)
    for name, amount in (("a", 0.1), ("b", 0.2)):
        assert project.command("run", "config.yaml", "--out", name, f"--set=scatter_points.amount={amount}").code == 0
    return project


def test_what_differs_is_shown_from_the_config_to_the_files(runs: Project):
    answer = runs.command("compare", "a", "b")
    assert answer.code == 0
    lines = answer.out.splitlines()
    assert lines[:2] == ["config:", "  scatter_points.amount: 0.1 | 0.2"]
    assert {"inputs: no difference", "metrics: no difference", "versions: no difference"} < set(lines)
    names = [line.split(":")[0].strip() for line in lines[lines.index("artifacts:") :] if line.startswith("  ")]
    assert names == ["scatter_points", "write_points", "points.txt"]


def test_a_run_and_its_repetition_differ_in_nothing(runs: Project):
    runs.command("run", "config.yaml", "--out", "again")
    compared = runs.command("compare", "a", "again", "--json").json
    assert {name: compared[name] for name in ("config", "metrics", "artifacts", "files", "versions")} == {
        "config": [], "metrics": [], "artifacts": [], "files": [], "versions": [],
    }  # fmt: skip


def test_all_shows_what_is_equal_too(runs: Project):
    compared = runs.command("compare", "a", "b", "--all", "--json").json
    assert {"name": "seed", "a": 7, "b": 7} in compared["config"]
    assert {"name": "points", "a": 4, "b": 4} in compared["metrics"]


def test_what_only_one_run_has_stands_against_a_dash(runs: Project):
    runs.write(CONFIG.replace("- use: scatter_points\n        amount: 0.1", "- use: grow_points"))
    runs.command("run", "config.yaml", "--out", "b")
    lines = runs.command("compare", "a", "b").out.splitlines()
    assert f"  scatter_points.use: scatter_points | {NOTHING}" in lines
    assert f"  grow_points.factor: {NOTHING} | 2.0" in lines


@pytest.mark.parametrize("harm", ["none", "text", "part"])
def test_a_folder_without_a_finished_run_is_refused(runs: Project, harm: str):
    shutil.rmtree("b")
    Path("b").mkdir()
    if harm != "none":
        Path("b/run.json").write_text("{" if harm == "text" else json.dumps({"stages": []}))
    answer = runs.command("compare", "a", "b")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == "b: contains no run.json of a finished run; give the directory of a run\n"
