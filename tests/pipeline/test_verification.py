from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pipeline.workplace import Project, harm
from scaffold_pipeline.runs.runner import STORE

RUN = Path("runs/config")
CONFIG = """
    seed: 7
    stages:
      - use: cast_points
        log: LOG
      - use: scatter_points
      - use: sway_points
      - use: write_points
        names: [a.txt, b.txt]
      - use: count_points
    """


@pytest.fixture
def finished(project: Project) -> Project:
    """A run whose first stage gives something else at each call."""
    assert project.command("run", project.write(CONFIG.replace("LOG", str(project.folder / "log")))).code == 0
    return project


def stored(kind: str, digest: str) -> Path:
    return next((RUN / STORE / kind).glob(f"{digest}*"))


def rewrite_stage(project: Project, label: str, key: str, value: object) -> None:
    """Have the record say something else of a stage."""
    record = project.record()
    next(stage for stage in record["stages"] if stage["label"] == label)[key] = value
    (RUN / "run.json").write_text(json.dumps(record))


def test_a_run_agrees_with_its_record_and_stays_as_it_was(finished: Project):
    before = {path: path.stat().st_mtime_ns for path in RUN.rglob("*")}
    answer = finished.command("verify", RUN)
    assert answer.code == 0
    assert answer.out == (
        "runs/config: 5 stages and 2 files agree with the record; "
        "not deterministic, so taken from the store: cast_points\n"
    )
    assert (finished.folder / "log").read_text() == "called\n"
    assert {path: path.stat().st_mtime_ns for path in RUN.rglob("*")} == before


def test_a_stage_that_gives_something_else_is_named_first(finished: Project, monkeypatch: pytest.MonkeyPatch):
    recorded = finished.record()["stages"][2]["output"]
    monkeypatch.setenv("SWAY", "0.5")
    answer = finished.command("verify", RUN)
    assert (answer.code, answer.out) == (1, "")
    last = answer.err.splitlines()[-1]
    assert last.startswith(f"runs/config: sway_points: output differs: recorded {recorded}, found ")
    assert last.endswith("; 2 stages before it agree")


def test_the_difference_is_told_as_json(finished: Project, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SWAY", "0.5")
    told = finished.command("verify", RUN, "--json").json
    assert (told["agrees"], told["difference"]["label"], told["stages"]) == (False, "sway_points", 2)
    assert told["difference"]["recorded"] != told["difference"]["found"]


def test_a_file_that_comes_out_otherwise_is_named(finished: Project):
    files = finished.record()["stages"][3]["files"]
    rewrite_stage(finished, "write_points", "files", {**files, "b.txt": "0" * 64})
    answer = finished.command("verify", RUN)
    assert answer.code == 1
    assert f"write_points: b.txt differs: recorded {'0' * 64}, found {files['b.txt']}; 3 stages" in answer.err


def test_other_versions_are_told_with_a_difference(finished: Project, monkeypatch: pytest.MonkeyPatch):
    record = finished.record()
    now = record["versions"]["numpy"]
    record["versions"]["numpy"] = "1.0"
    (RUN / "run.json").write_text(json.dumps(record))
    assert finished.command("verify", RUN).out.endswith(f"; different versions: numpy 1.0 then, {now} now\n")
    monkeypatch.setenv("SWAY", "0.5")
    assert finished.command("verify", RUN).err.endswith(f"; different versions: numpy 1.0 then, {now} now\n")


def test_what_cannot_be_repeated_serves_other_versions_of_its_stage(finished: Project):
    digest = finished.record()["stages"][0]["key"]
    other = "f" * 64
    stored("results", digest).rename(RUN / STORE / "results" / f"{other}.json")
    rewrite_stage(finished, "cast_points", "key", other)
    assert finished.command("verify", RUN).code == 0
    assert (finished.folder / "log").read_text() == "called\n"


@pytest.mark.parametrize(("how", "says"), [("bit", "is not what was stored"), ("gone", "is missing")])
def test_a_damaged_array_of_what_cannot_be_repeated_is_an_error(finished: Project, how: str, says: str):
    manifest = json.loads(stored("artifacts", finished.record()["stages"][0]["output"]).read_text())
    harm(stored("arrays", manifest["fields"]["places"]["array"]), how)
    answer = finished.command("verify", RUN)
    assert answer.code == 1
    assert answer.err.startswith("cast_points: is not deterministic, and its stored result is damaged: stored array ")
    assert says in answer.err


def test_a_tampered_hash_of_what_cannot_be_repeated_is_a_difference(finished: Project):
    rewrite_stage(finished, "cast_points", "output", "0" * 64)
    answer = finished.command("verify", RUN)
    assert answer.code == 1
    assert f"cast_points: output differs: recorded {'0' * 64}" in answer.err


def test_a_store_that_was_pruned_is_an_error_with_a_remedy(finished: Project):
    stored("results", finished.record()["stages"][0]["key"]).unlink()
    answer = finished.command("verify", RUN)
    assert answer.code == 1
    assert answer.err == (
        "cast_points: is not deterministic, and its result is no longer in runs/config/.store; "
        "run the config again and verify the new run\n"
    )


@pytest.mark.parametrize("how", ["bit", "gone"])
def test_a_file_that_was_changed_after_the_run_is_named(finished: Project, how: str):
    harm(RUN / "a.txt", how)
    answer = finished.command("verify", RUN)
    assert answer.code == 1
    assert answer.err.startswith("runs/config/a.txt: is not the file that the run wrote: recorded ")


def test_an_input_that_was_changed_or_lost_is_named(project: Project):
    project.write("1\n2\n", "points.txt")
    project.command("run", project.write("stages: [{use: read_points, path: points.txt}]"))
    assert project.command("verify", RUN).code == 0
    project.write("1\n3\n", "points.txt")
    changed = project.command("verify", RUN)
    assert changed.code == 1
    assert changed.err.startswith(f"read_points: path: {project.folder / 'points.txt'} was changed since the run: ")
    (project.folder / "points.txt").unlink()
    lost = project.command("verify", RUN)
    assert lost.code == 2
    assert "runs/config/config.yaml:5:3: stages.0 (read_points): path: no such file" in lost.err


def test_what_is_no_finished_run_is_told(project: Project):
    project.write("{}", "study/study.json")
    project.write("{}", "other/run.json")
    project.write("{", "half/run.json")
    for folder, says in [
        ("nowhere", "no record of a finished run; name the folder of a run"),
        ("study", "no record of a finished run; name one of its points"),
        ("other", "is not the record of a run"),
        ("half", "cannot be read"),
    ]:
        answer = project.command("verify", folder)
        assert answer.code == 1
        assert answer.err.startswith(f"{folder}/run.json: ")
        assert says in answer.err


def test_another_number_of_threads_may_be_asked_for(project: Project, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    project.command("run", project.write("stages: [{use: make_points}, {use: tell_threads}]"))
    assert project.command("verify", RUN).code == 0
    assert "tell_threads: output differs" in project.command("verify", RUN, "--threads", "2").err
    assert os.environ["OMP_NUM_THREADS"] == "1"
