from __future__ import annotations

import json
from pathlib import Path
from shutil import rmtree
from threading import Thread
from typing import Any

import pytest

from pipeline.workplace import Project, harm
from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import make_plan
from scaffold_pipeline.config.yaml_source import parse
from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.report import publish as publishing
from scaffold_pipeline.report.publish import publish, run_metrics
from scaffold_pipeline.runs.runner import execute, locked
from scaffold_pipeline.runs.store import hash_file

CHAIN = """
    name: points
    seed: 7
    stages:
      - use: make_points
      - use: scatter_points
      - use: grow_points
        limit: 1.0
      - use: write_points
        names: [points.txt, more.txt]
      - use: count_points
    """
OUT = Path("out")


def run(project: Project, text: str = CHAIN, *settings: str) -> dict[str, Any]:
    plan = make_plan(read_draft(project.write(text), settings))
    return publish(plan, execute(plan, OUT), OUT)


def visible() -> list[str]:
    return sorted(path.name for path in OUT.iterdir() if not path.name.startswith("."))


def test_a_run_leaves_its_files_and_nothing_else(project: Project):
    run(project)
    assert visible() == ["config.yaml", "metrics.json", "more.txt", "points.txt", "report.html", "run.json"]
    assert not list(OUT.glob(".publish-*"))


def test_the_record_names_the_hash_and_size_of_every_file(project: Project):
    record = run(project)
    assert json.loads((OUT / "run.json").read_text()) == json.loads(json.dumps(record))
    assert sorted(record["files"]) == [name for name in visible() if name != "run.json"]
    for name, facts in record["files"].items():
        assert facts == {"sha256": hash_file(OUT / name), "bytes": (OUT / name).stat().st_size}


def test_the_record_tells_config_versions_platform_and_stages(project: Project):
    record = run(project)
    assert (record["name"], record["seed"], record["quality"]) == ("points", 7, "pass")
    assert record["config"] == parse((OUT / "config.yaml").read_text(), "").values
    assert record["versions"]["scaffold-pipeline"] == "0.1.0"
    assert record["versions"]["fake-plugin"] == "1.0"
    assert {"numpy", "pydantic"} <= set(record["versions"])
    assert record["platform"]["cores"] >= 1
    assert [stage["label"] for stage in record["stages"]] == [entry["use"] for entry in record["config"]["stages"]]
    assert record["warnings"] == ["grow_points: the points reach beyond 1 mm"]
    for name in ("version", "parameters", "inputs", "output", "seconds", "peak_memory_bytes", "seed"):
        assert name in record["stages"][0]


def test_files_of_the_stages_name_the_config_they_come_from(project: Project):
    record = run(project)
    assert (OUT / "points.txt").read_text().splitlines()[0] == record["config_sha256"]


def test_the_config_hash_is_that_of_what_is_asked_not_of_where_it_stands(project: Project):
    project.write("1.0", "a/points.txt")
    project.write("1.0", "b/points.txt")
    text = "stages: [{use: read_points, path: points.txt}]"
    hashes = []
    for folder in ("a", "b"):
        plan = make_plan(read_draft(project.write(text, f"{folder}/config.yaml")))
        hashes.append(publish(plan, execute(plan, Path(folder, "out")), Path(folder, "out"))["config_sha256"])
    assert hashes[0] == hashes[1]


def test_the_resolved_config_runs_again_and_changes_nothing(project: Project):
    record = run(project)
    plan = make_plan(read_draft(OUT / "config.yaml"))
    again = publish(plan, execute(plan, OUT), OUT)
    assert all(stage["reused"] for stage in again["stages"])
    assert again["config_sha256"] == record["config_sha256"]
    same = {name: facts for name, facts in record["files"].items() if name != "report.html"}
    assert {name: again["files"][name] for name in same} == same


def test_the_resolved_config_of_a_file_is_found_from_anywhere(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.write("1.0", "sub/points.txt")
    plan = make_plan(read_draft(project.write("stages: [{use: read_points, path: points.txt}]", "sub/config.yaml")))
    publish(plan, execute(plan, OUT), OUT)
    config = (OUT / "config.yaml").resolve()
    monkeypatch.chdir("/")
    assert make_plan(read_draft(config)).resolved() == plan.resolved()


def test_metrics_are_flat_and_tell_time_and_memory(project: Project):
    record = run(project)
    metrics = json.loads((OUT / "metrics.json").read_text())
    assert {name: metrics[name] for name in ("points", "drawn", "quality")} == {
        "points": 4,
        "drawn": True,
        "quality": "pass",
    }
    assert metrics["seconds"] == pytest.approx(sum(stage["seconds"] for stage in record["stages"]), abs=1e-3)
    assert metrics["peak_memory_bytes"] == max(stage["peak_memory_bytes"] for stage in record["stages"])


def test_what_two_stages_measured_is_in_one_file_of_metrics(project: Project):
    run(project, "stages: [{use: make_points}, {use: count_points}, {use: span_points, most: 2}]")
    metrics = json.loads((OUT / "metrics.json").read_text())
    assert (metrics["points"], metrics["length"]) == (4, 3.0)
    assert metrics["quality"] == ["length: must be at most 2 mm, got 3"]
    measures = json.loads((OUT / "measures.json").read_text())
    assert [entry["name"] for entry in (*measures["histograms"], *measures["curves"])] == ["gaps", "order"]


def test_a_run_that_measures_nothing_says_so(project: Project):
    plan = make_plan(read_draft(project.write("stages: [{use: make_points}]")))
    assert run_metrics(execute(plan, OUT))["quality"] == "not measured"


def test_files_of_an_earlier_run_that_this_one_has_not_are_removed(project: Project):
    run(project)
    (OUT / "notes.txt").write_text("mine")
    run(project, CHAIN, "write_points.names=[points.txt]")
    assert visible() == ["config.yaml", "metrics.json", "notes.txt", "points.txt", "report.html", "run.json"]


@pytest.mark.parametrize(
    "record",
    ["", "[]", "3", '{"files": 3}', '{"files": {"../kept.txt": {}, "..": {}, ".": {}, ".store": {}, "gone.txt": {}}}'],
)
def test_a_record_that_is_none_removes_nothing(project: Project, record: str):
    run(project)
    Path("kept.txt").write_text("mine")
    (OUT / "run.json").write_text(record)
    run(project)
    assert Path("kept.txt").read_text() == "mine"
    assert "points.txt" in visible()


def test_a_failure_on_the_way_out_leaves_the_earlier_files_as_they_were(
    project: Project, monkeypatch: pytest.MonkeyPatch
):
    run(project)
    before = {name: (OUT / name).read_bytes() for name in visible()}

    def fail(*_: object) -> str:
        raise RuntimeError("no page")

    monkeypatch.setattr(publishing, "render_page", fail)
    with pytest.raises(RuntimeError, match="no page"):
        run(project, CHAIN, "seed=8")
    assert {name: (OUT / name).read_bytes() for name in visible()} == before
    assert not list(OUT.glob(".publish-*"))


def test_what_a_run_killed_on_the_way_out_left_is_removed(project: Project):
    run(project)
    (OUT / ".publish-123").mkdir()
    (OUT / ".publish-123" / "points.txt").write_text("half")
    run(project)
    assert not list(OUT.glob(".publish-*"))


def test_the_record_is_renamed_last(project: Project, monkeypatch: pytest.MonkeyPatch):
    order: list[str] = []
    original = Path.replace

    def replace(self: Path, target: Path) -> Path:
        if Path(target).parent == OUT:
            order.append(Path(target).name)
        return original(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    run(project)
    assert order[-1] == "run.json"
    assert len(order) == len(visible())


def test_warnings_of_the_run_itself_are_in_the_record(project: Project):
    run(project)
    for path in (OUT / ".store" / "results").iterdir():
        path.write_text("")
    record = run(project)
    assert sum("cannot be read; the stage is run again" in message for message in record["warnings"]) == 5


def test_nothing_is_put_into_a_directory_that_another_run_holds(project: Project):
    plan = project.plan(CHAIN)
    result = execute(plan, OUT)
    refused: list[Exception] = []

    def publish_too() -> None:
        with pytest.raises(PipelineError, match="another run is using this directory") as caught:
            publish(plan, result, OUT)
        refused.append(caught.value)

    with locked(OUT):
        thread = Thread(target=publish_too)
        thread.start()
        thread.join()
    assert len(refused) == 1
    assert visible() == []


# The page again


def test_the_page_is_made_again_to_the_bit_from_the_record_alone(project: Project):
    record = run(project)
    before = {name: (OUT / name).read_bytes() for name in visible()}
    rmtree(OUT / ".store")
    (OUT / "report.html").write_text("gone")
    assert project.command("report", OUT).out == f"wrote {OUT / 'report.html'}\n"
    assert {name: (OUT / name).read_bytes() for name in visible()} == before
    assert hash_file(OUT / "report.html") == record["files"]["report.html"]["sha256"]
    assert project.command("report", OUT, "--json").json == {"report": str(OUT / "report.html")}


def test_where_the_page_becomes_another_the_record_is_told(project: Project, monkeypatch: pytest.MonkeyPatch):
    run(project)
    monkeypatch.setattr(publishing, "render_page", lambda _: "as another version makes it")
    assert project.command("report", OUT).code == 0
    record = json.loads((OUT / "run.json").read_text())
    assert record["files"]["report.html"]["sha256"] == hash_file(OUT / "report.html")
    assert project.command("report", OUT).code == 0


@pytest.mark.parametrize(
    ("record", "told"),
    [
        (None, "there is no record of a finished run"),
        ("{", "cannot be read"),
        ("[]", "is not the record of a run"),
        ("{}", "is not the record of a run"),
        ('{"stages": 3, "files": {}, "versions": {}, "platform": {}}', "is not the record of a run"),
        ('{"stages": [], "files": {"a": 3}, "versions": {}, "platform": {}}', "is not the record of a run"),
        ('{"stages": [{"summary": 3}], "files": {}, "versions": {}, "platform": {}}', "no page can be made of it"),
    ],
)
def test_a_folder_without_a_sound_record_is_a_line_and_stays_as_it_is(project: Project, record: str | None, told: str):
    run(project)
    (OUT / "run.json").unlink()
    if record is not None:
        (OUT / "run.json").write_text(record)
    before = {name: (OUT / name).read_bytes() for name in visible()}
    answer = project.command("report", OUT)
    assert answer.code == 1
    assert answer.err.startswith(f"{OUT / 'run.json'}: {told}")
    assert len(answer.err.splitlines()) == 1
    assert {name: (OUT / name).read_bytes() for name in visible()} == before


@pytest.mark.parametrize("name", ["metrics.json", "config.yaml"])
@pytest.mark.parametrize("how", ["gone", "half", "bit"])
def test_results_that_are_not_those_of_the_record_give_no_page(project: Project, name: str, how: str):
    run(project)
    page = (OUT / "report.html").read_bytes()
    harm(OUT / name, how)
    answer = project.command("report", OUT)
    assert answer.err == f"{OUT / name}: is not the file that the run wrote; run the config again\n"
    assert answer.code == 1
    assert (OUT / "report.html").read_bytes() == page


@pytest.mark.parametrize("how", ["gone", "half", "bit"])
def test_a_picture_that_is_not_that_of_the_record_is_left_out_and_named(project: Project, how: str):
    run(project, CHAIN, "write_points.names=[preview.png, view.npz]")
    harm(OUT / "preview.png", how)
    assert project.command("report", OUT).code == 0
    text = (OUT / "report.html").read_text()
    assert "Left out, as these files have changed since the run: <ul><li>preview.png</li></ul>" in text


def test_a_page_that_is_made_again_is_not_put_into_a_directory_that_a_run_holds(project: Project):
    run(project)
    told: list[str] = []
    with locked(OUT):
        thread = Thread(target=lambda: told.append(project.command("report", OUT).err))
        thread.start()
        thread.join()
    assert "another run is using this directory" in told[0]
