from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, ClassVar

import pytest

from pipeline.workplace import Project, harm
from scaffold_pipeline.processes.threads import core_count, thread_count, threads_of_children
from scaffold_pipeline.runs.store import hash_file
from scaffold_pipeline.studies import memory_forecast, study, workers
from scaffold_pipeline.studies.schedule import Schedule, Task

BASE = """
    seed: 7
    stages:
      - use: make_points
      - use: scatter_points
      - use: write_points
      - use: count_points
        least: 3
    """
STUDY = """
    base: base.yaml
    vary:
      make_points.count: [3, 4]
      scatter_points.amount: [0.1, 0.2]
    """
NAMES = ["count-3_amount-0.1", "count-3_amount-0.2", "count-4_amount-0.1", "count-4_amount-0.2"]
OUT = Path("studies/study")
POINTS = OUT / "points"


class Inline(Executor):
    """Works at once, in this process."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> Future[Any]:  # noqa: ANN401
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the points be run in this process: for all that does not concern processes."""

    @contextmanager
    def executor(_: int) -> Iterator[Executor]:
        yield Inline()

    monkeypatch.setattr(workers, "local_workers", executor)


@pytest.fixture
def workplace(project: Project) -> Project:
    project.write(BASE, "base.yaml")
    project.write(STUDY, "study.yaml")
    return project


def rows(out: Path = OUT) -> list[dict[str, str]]:
    with (out / "table.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def record(name: str) -> dict[str, Any]:
    value: dict[str, Any] = json.loads((POINTS / name / "run.json").read_text())
    return value


def outputs(out: Path = OUT) -> dict[str, dict[str, str]]:
    told = json.loads((out / "study.json").read_text())
    return {
        point["name"]: {label: stage["output"] for label, stage in point["stages"].items()} for point in told["points"]
    }


# The result


def test_a_study_is_one_run_a_point_and_one_table(workplace: Project):
    answer = workplace.command("study", "study.yaml")
    assert answer.code == 0
    assert answer.out.startswith("studies/study: 4 of 4 points done, ")
    assert sorted(line.split()[1] for line in answer.err.splitlines()) == [f"{name}:" for name in NAMES]
    assert [path.name for path in sorted(POINTS.iterdir())] == NAMES
    table = rows()
    assert [row["point"] for row in table] == NAMES
    assert [(row["make_points.count"], row["scatter_points.amount"]) for row in table] == [
        ("3", "0.1"),
        ("3", "0.2"),
        ("4", "0.1"),
        ("4", "0.2"),
    ]
    assert [(row["points"], row["drawn"], row["quality"], row["error"]) for row in table] == [
        (count, "true", "pass", "") for count in "3344"
    ]


def test_what_points_share_is_computed_once(workplace: Project):
    workplace.command("study", "study.yaml")
    made = [
        [stage["label"] for stage in record(name)["stages"] if not stage["reused"]].count("make_points")
        for name in NAMES
    ]
    assert made == [1, 0, 1, 0]


def test_a_stage_that_cannot_repeat_itself_gives_all_points_one_result(project: Project):
    log = project.folder / "log"
    project.write(f"stages: [{{use: cast_points, log: '{log}'}}, {{use: scatter_points}}]", "base.yaml")
    project.write("base: base.yaml\nrepeats: 3\n", "study.yaml")
    assert project.command("study", "study.yaml").code == 0
    assert log.read_text().count("called") == 1
    assert len({point["cast_points"] for point in outputs().values()}) == 1
    assert len({point["scatter_points"] for point in outputs().values()}) == 3
    shutil.rmtree(OUT / "cache")
    project.write("base: base.yaml\nrepeats: 4\n", "study.yaml")
    assert project.command("study", "study.yaml").code == 0
    assert log.read_text().count("called") == 1


def test_the_config_of_a_point_runs_alone_and_gives_the_same(workplace: Project):
    workplace.command("study", "study.yaml")
    config = POINTS / NAMES[2] / "config.yaml"
    assert workplace.command("run", config, "--out", "alone").code == 0
    alone = {stage["label"]: stage["output"] for stage in workplace.record("alone")["stages"]}
    assert alone == outputs()[NAMES[2]]
    assert workplace.record("alone")["files"]["points.txt"] == record(NAMES[2])["files"]["points.txt"]
    in_place = workplace.command("run", config, "--out", config.parent)
    assert in_place.err.count("unchanged") == 4


def test_the_record_names_all_that_the_result_comes_from(workplace: Project):
    workplace.command("study", "study.yaml", "--workers", "1")
    told = json.loads((OUT / "study.json").read_text())
    assert (told["name"], told["workers"]) == ("study", 1)
    assert told["versions"]["numpy"]
    assert told["platform"]["cores"] >= 1
    point = told["points"][3]
    assert point["varied"] == {"make_points.count": 4, "scatter_points.amount": 0.2}
    assert (point["seed"], point["config"]["stages"][0]["count"], point["status"]) == (7, 4, "done")
    for name, facts in point["files"].items():
        assert facts["sha256"] == hash_file(POINTS / NAMES[3] / name)
    assert point["threads"] >= 1


def test_set_changes_all_points_and_out_says_where(workplace: Project):
    answer = workplace.command("study", "study.yaml", "--set", "seed=9", "--out", "there", "--json")
    assert answer.json["out"] == "there"
    assert {point["status"] for point in answer.json["points"]} == {"done"}
    assert {point["seed"] for point in json.loads(Path("there/study.json").read_text())["points"]} == {9}


def test_points_share_with_other_studies_in_a_cache_that_is_named(workplace: Project):
    workplace.command("study", "study.yaml", "--cache", "shared")
    assert not (OUT / "cache").exists()
    workplace.command("study", "study.yaml", "--cache", "shared", "--out", "there")
    stages = [
        stage
        for point in json.loads(Path("there/study.json").read_text())["points"]
        for stage in point["stages"].values()
    ]
    assert all(stage["reused"] for stage in stages)


def test_a_gate_that_fails_is_exit_code_3(workplace: Project):
    answer = workplace.command("study", "study.yaml", "--set", "count_points.least=4")
    assert answer.code == 3
    assert answer.err.splitlines()[-1] == f"{NAMES[1]}: quality gate failed: points: must be 4 at least, got 3"
    assert [row["quality"] for row in rows()] == ["points: must be 4 at least, got 3"] * 2 + ["pass"] * 2


def test_warnings_of_the_cache_are_told_once(workplace: Project):
    Path("shared").write_text("a file")
    answer = workplace.command("study", "study.yaml", "--cache", "shared")
    assert answer.code == 0
    assert answer.err.count("warning: cache ") == 1


# Stop and go


def test_the_same_command_again_runs_nothing(workplace: Project):
    workplace.command("study", "study.yaml")
    before = {path: path.stat().st_mtime_ns for path in POINTS.rglob("*")}
    answer = workplace.command("study", "study.yaml")
    assert (answer.code, answer.err) == (0, "")
    assert {path: path.stat().st_mtime_ns for path in POINTS.rglob("*")} == before
    assert len(rows()) == 4


def test_a_longer_list_runs_only_what_is_new(workplace: Project):
    workplace.command("study", "study.yaml")
    workplace.write(STUDY.replace("[0.1, 0.2]", "[0.05, 0.1, 0.2]"), "study.yaml")
    answer = workplace.command("study", "study.yaml")
    told = sorted(line.split()[1] for line in answer.err.splitlines())
    assert told == ["count-3_amount-0.05:", "count-4_amount-0.05:"]
    assert len(rows()) == 6


@pytest.mark.parametrize("what", ["run.json", "points.txt", "metrics.json", ".store/results"])
def test_a_point_that_has_lost_something_is_made_whole(workplace: Project, what: str):
    workplace.command("study", "study.yaml")
    before = rows()
    path = POINTS / NAMES[1] / what
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    shutil.rmtree(OUT / "cache")
    answer = workplace.command("study", "study.yaml")
    assert [line.split()[1] for line in answer.err.splitlines()] == [f"{NAMES[1]}:"]
    assert [row["points"] for row in rows()] == [row["points"] for row in before]
    assert (POINTS / NAMES[1] / "points.txt").is_file()


def test_a_damaged_entry_of_the_cache_is_made_again(workplace: Project):
    workplace.command("study", "study.yaml", "--cache", "shared")
    for path in Path("shared/arrays").iterdir():
        harm(path, "bit")
    answer = workplace.command("study", "study.yaml", "--cache", "shared", "--out", "there")
    assert answer.code == 0
    assert "is run again" in answer.err
    assert outputs(Path("there")) == outputs()


FAILING = """
    mode: list
    base: base.yaml
    vary:
      - {fail.how: nothing, make_points.count: 2}
      - {fail.how: stage_error}
      - {fail.how: nothing, make_points.count: 3}
    """


@pytest.mark.parametrize(
    ("options", "errors"),
    [([], ["", "too few", "not run"]), (["--keep-going"], ["", "too few", ""])],
)
def test_a_failing_point_is_recorded(project: Project, inline: None, options: list[str], errors: list[str]):  # noqa: ARG001
    project.write("stages: [{use: make_points}, {use: fail, how: nothing}]", "base.yaml")
    project.write(FAILING, "study.yaml")
    answer = project.command("study", "study.yaml", *options)
    assert answer.code == 1
    assert answer.err.splitlines()[-1] == "how-stage_error: fail: the points are too few, 4; give more"
    told = [row["error"] for row in rows()]
    assert all(part in text for part, text in zip(errors, told, strict=True))
    assert [text == "" for text in told] == [part == "" for part in errors]
    project.write(FAILING.replace("stage_error", "interrupt"), "study.yaml")


def test_a_point_that_failed_is_tried_again_and_its_error_forgotten(project: Project):
    project.write("1.0 x", "points.txt")
    project.write("stages: [{use: read_points, path: points.txt}]", "base.yaml")
    project.write("base: base.yaml\nrepeats: 1\nvary: {seed: [1]}\n", "study.yaml")
    assert project.command("study", "study.yaml").code == 1
    assert "could not convert" in rows()[0]["error"]
    project.write("1.0 2.0", "points.txt")
    assert project.command("study", "study.yaml").code == 0
    assert rows()[0]["error"] == ""
    assert not list(OUT.rglob("failure.json"))


# Before it runs


def test_a_dry_run_tells_points_and_work_and_writes_nothing(workplace: Project):
    answer = workplace.command("study", "study.yaml", "-n")
    assert (answer.code, answer.err) == (0, "")
    lines = answer.out.splitlines()
    assert lines[0] == f"{NAMES[0]}: to run: make_points, scatter_points, write_points, count_points"
    assert lines[-1] == "4 points, 0 done; 14 results to compute, shared ones once"
    assert not Path("studies").exists()
    workplace.command("study", "study.yaml")
    workplace.write(STUDY.replace("[0.1, 0.2]", "[0.1, 0.2, 0.3]"), "study.yaml")
    told = workplace.command("study", "study.yaml", "-n", "--json").json
    assert [point["done"] for point in told["points"]] == [True, True, False] * 2
    assert told["points"][2]["unchanged"] == ["make_points"]
    assert told["results_to_compute"] == 6


def test_faults_are_told_and_nothing_is_run(workplace: Project):
    workplace.write(STUDY.replace("amount", "amuont"), "study.yaml")
    answer = workplace.command("study", "study.yaml")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("study.yaml:4:3: scatter_points.amuont: unknown parameter 'amuont'; did you mean")
    assert not Path("studies").exists()
    assert workplace.command("validate", "study.yaml").err == answer.err


def test_validate_takes_a_study(workplace: Project):
    assert workplace.command("validate", "study.yaml").out == "study.yaml: ok, 4 points\n"
    assert workplace.command("validate", "study.yaml", "--json").json == {"valid": True, "points": NAMES}


def test_run_says_how_to_start_a_study(workplace: Project):
    answer = workplace.command("run", "study.yaml")
    assert answer.code == 2
    assert (
        "study.yaml:1:1: this is a study; run it with `scaffold-pipeline study study.yaml`" in answer.err.splitlines()
    )


@pytest.mark.parametrize("workers", ["0", "-1", "many"])
def test_a_number_of_workers_that_cannot_be_is_a_line(workplace: Project, workers: str):
    answer = workplace.command("study", "study.yaml", "--workers", workers)
    assert answer.code == 2
    assert "--workers" in answer.err


def test_children_share_the_cores(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert thread_count() == core_count()
    with threads_of_children(3):
        assert thread_count() == 3
    assert thread_count() == core_count()
    monkeypatch.setenv("OMP_NUM_THREADS", "none")
    assert thread_count() == core_count()


BLOCKS = """
    stages:
      - {use: make_block, side: 10.0, log: log}
      - {use: cast_points, log: others, voxel_size: 0.1}
      - use: write_points
    """


class Spy(Schedule):
    """Remembers the memory that the tasks of each schedule are expected to need, and the factor it begins with."""

    given: ClassVar[list[tuple[list[int], float]]] = []

    def run(self, tasks: Iterable[Task], start: Callable[[], AbstractContextManager[Executor]]) -> None:
        todo = list(tasks)
        self.given.append(([task.memory for task in todo], self._factor))
        super().run(todo, start)


@pytest.fixture
def spy(project: Project, monkeypatch: pytest.MonkeyPatch) -> list[tuple[list[int], float]]:
    """Return what the schedules of a study of blocks are given: two shapes, each in voxels of two sizes."""
    project.write(BLOCKS, "base.yaml")
    project.write(
        "{base: base.yaml, vary: {make_block.side: [10, 20], cast_points.voxel_size: [0.1, 0.2]}}", "study.yaml"
    )
    monkeypatch.setattr(Spy, "given", [])
    monkeypatch.setattr(study, "Schedule", Spy)
    return Spy.given


def test_a_first_study_loads_its_shapes_and_then_knows_how_much_memory_each_point_may_need(project: Project, spy: Any):  # noqa: ANN401
    assert project.command("study", "study.yaml", "--workers", "2").code == 0
    (shapes, _), (points, factor) = spy
    assert (len(shapes), factor) == (2, 0.0)
    assert Path("log").read_text() == "called\n" * 2  # once for all points that share it
    small, small_coarse, large, large_coarse = points
    assert small == large_coarse == pytest.approx(small_coarse + (large - small_coarse) / 9.0)  # 2^3 and 4^3 as many


def test_points_that_were_done_before_tell_how_far_off_that_is(project: Project, spy: Any):  # noqa: ANN401
    assert project.command("study", "study.yaml", "--workers", "2").code == 0
    shutil.rmtree(min(POINTS.iterdir()))
    assert project.command("study", "study.yaml", "--workers", "2").code == 0
    (first, _), (again, factor) = spy[1], spy[-1]
    assert again == first[:1]
    records = [json.loads((folder / "run.json").read_text()) for folder in sorted(POINTS.iterdir())[1:]]
    peaks = [record["peak_memory_bytes"] for record in records]
    assert factor == max(peak / memory for peak, memory in zip(peaks, first[1:], strict=True))


def test_where_points_follow_each_other_no_memory_is_foretold(project: Project, spy: Any):  # noqa: ANN401
    assert project.command("study", "study.yaml", "--workers", "1").code == 0
    assert len(spy) == 1


def test_a_shape_that_cannot_be_loaded_is_the_failure_of_its_points_alone(project: Project, spy: Any):  # noqa: ANN401
    answer = project.command("study", "study.yaml", "--workers", "2", "--keep-going", "--set", "make_block.log=/")
    assert (answer.code, len(spy[1][0]), set(spy[1][0])) == (1, 4, {memory_forecast.USUAL})
