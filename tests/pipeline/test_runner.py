from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.workplace import Project, harm, ran
from scaffold_pipeline.artifacts import Metrics
from scaffold_pipeline.config.plan import Plan
from scaffold_pipeline.errors import MemoryShortageError, PipelineError, StageDefinitionError, StageError
from scaffold_pipeline.runs import records, runner
from scaffold_pipeline.runs.measurements import merge_metrics
from scaffold_pipeline.runs.records import StepRecord
from scaffold_pipeline.runs.runner import Progress, RunResult, execute, unchanged_labels

CHAIN = """
    seed: 7
    stages:
      - use: make_points
        count: 3
      - use: scatter_points
      - use: grow_points
      - use: draw_points
      - use: count_points
    """
OUT = Path("out")


def record(result: RunResult, label: str) -> StepRecord:
    (found,) = (step for step in result.steps if step.label == label)
    return found


def test_each_step_is_recorded_with_all_that_made_it(project: Project):
    result = project.execute(CHAIN)
    assert result.is_complete
    step = record(result, "grow_points")
    assert (step.stage, step.version, step.slot, step.seed, step.reused) == ("grow_points", 1, "points", None, False)
    assert step.parameters == {"factor": 2.0, "limit": 50.0}
    assert step.inputs == {"points": record(result, "scatter_points").output}
    assert step.summary["points"] == 3
    assert step.peak_memory_bytes > 2**20
    assert 0.0 <= step.seconds <= result.seconds
    assert record(result, "scatter_points").seed == project.plan(CHAIN).steps[1].seed(7)


def test_the_metrics_of_the_one_that_measured_are_told(project: Project):
    result = project.execute(CHAIN)
    assert result.metrics is not None
    assert result.metrics.values == {"points": 3, "drawn": True}
    assert project.execute("stages: [{use: make_points}]").metrics is None


TWO = """
    stages:
      - use: make_points
        count: 3
      - use: count_points
        least: 4
      - use: span_points
        most: 1
    """


def test_what_two_stages_measured_adds_up(project: Project):
    for _ in ("measured", "reused"):
        metrics = project.execute(TWO).metrics
        assert metrics is not None
        assert metrics.values == {"points": 3, "drawn": False, "length": 2.0}
        assert metrics.failed_gates == (
            "points: must be 4 at least, got 3",
            "length: must be at most 1 mm, got 2",
        )
        assert [len(part) for part in (metrics.histograms, metrics.curves, metrics.findings)] == [1, 1, 1]
        assert metrics.strut_thickness.tolist() == [0.5] * 3


def test_a_run_is_judged_where_one_of_those_that_measured_judges(project: Project):
    with_none = Metrics({"a": 1}, has_gates=False)
    assert merge_metrics({}) is None
    assert merge_metrics({"one": with_none}) is with_none
    judged, unjudged = Metrics({"b": 1}), Metrics({"c": 1}, has_gates=False)
    assert [merge_metrics({"x": with_none, "y": other}).summary()["quality"] for other in (judged, unjudged)] == [  # type: ignore[union-attr]
        "pass",
        "not measured",
    ]
    assert project.execute(TWO, until="count_points").metrics.values == {"points": 3, "drawn": False}  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("second", "names"),
    [
        ("{use: span_points, key: points}", "span_points: measures points, which count_points also measures; remove"),
        ("{use: span_points, as: again, key: other}", "again: measures the histogram gaps, the curve order, the thick"),
        ("{use: span_points, as: again}", "again: measures length, the histogram gaps, the curve order, the thickness"),
    ],
)
def test_a_key_that_two_stages_give_is_an_error_as_soon_as_the_second_ends(project: Project, second: str, names: str):
    first = "" if "key: points" in second else "{use: span_points}, "
    text = f"stages: [{{use: make_points}}, {{use: count_points}}, {first}{second}, {{use: draw_points}}]"
    started: list[str] = []
    with pytest.raises(StageError) as caught:
        project.execute(text, progress=Progress(started=lambda step, _number, _count: started.append(step.label)))
    assert str(caught.value).startswith(names)
    assert "draw_points" not in started
    assert ran(project.execute(text.replace(f"{second}, ", ""))) == ["draw_points"]


def test_a_stage_that_writes_metrics_over_may_keep_their_keys(project: Project, install: Callable[..., None]):
    install(
        "judge_package",
        """
        from fake_stages import DrawPointsParams
        from scaffold_pipeline.artifacts import Metrics
        from scaffold_pipeline.stages.contract import stage

        @stage(writes="metrics", version=1)
        def judge(metrics: Metrics, *, params: DrawPointsParams) -> Metrics:
            "Judge what was measured."
            return Metrics({**metrics.values, "judged": True})
        """,
        "judge",
    )
    metrics = project.execute("stages: [{use: make_points}, {use: count_points}, {use: judge}]").metrics
    assert metrics is not None
    assert metrics.values == {"points": 4, "drawn": False, "judged": True}


def test_nothing_is_run_again_when_nothing_changed(project: Project):
    first, second = project.execute(CHAIN), project.execute(CHAIN)
    assert len(ran(first)) == 5
    assert ran(second) == []
    assert [step.output for step in first.steps] == [step.output for step in second.steps]
    assert second.metrics is not None


@pytest.mark.parametrize(
    ("setting", "again"),
    [
        ("make_points.count=4", ["make_points", "scatter_points", "grow_points", "draw_points", "count_points"]),
        ("scatter_points.amount=0.3", ["scatter_points", "grow_points", "draw_points", "count_points"]),
        ("seed=8", ["scatter_points", "grow_points", "draw_points", "count_points"]),
        ("grow_points.factor=3", ["grow_points", "draw_points", "count_points"]),
        ("count_points.least=2", ["count_points"]),
        ("count_points.limit=60", ["grow_points", "count_points"]),
        ("name=other", []),
    ],
)
def test_only_what_changed_and_what_follows_from_it_is_run_again(project: Project, setting: str, again: list[str]):
    project.execute(CHAIN)
    assert ran(project.execute(CHAIN, setting)) == again


def test_a_change_without_effect_ends_there(project: Project):
    project.execute(CHAIN)
    result = project.execute(CHAIN, "grow_points.limit=80")
    assert ran(result) == ["grow_points"]


def test_results_are_the_same_for_the_same_seed_and_others_for_another(project: Project):
    def outputs(seed: int, out: str) -> list[str]:
        return [step.output for step in project.execute(CHAIN, f"seed={seed}", out=out).steps]

    assert outputs(7, "a") == outputs(7, "b")
    assert outputs(8, "c")[1:3] != outputs(7, "b")[1:3]


def test_a_random_stage_gives_the_same_whatever_stands_around_it(project: Project):
    among = """
        seed: 7
        stages:
          - use: make_points
            as: others
          - use: scatter_points
            as: moved
            from: {points: others}
          - use: make_points
            count: 3
          - use: scatter_points
        """
    alone, other = project.execute(CHAIN), project.execute(among, out="other")
    assert record(alone, "scatter_points").output == record(other, "scatter_points").output
    assert record(other, "moved").seed != record(other, "scatter_points").seed


READ = """
    stages:
      - use: read_points
        path: points.txt
      - use: draw_points
    """


def test_changed_content_under_the_same_name_is_seen(project: Project):
    project.write("1.0", "points.txt")
    first = project.execute(READ)
    project.write("2.0", "points.txt")
    second = project.execute(READ)
    assert ran(second) == ["read_points", "draw_points"]
    assert record(first, "read_points").input_files != record(second, "read_points").input_files


def test_a_touched_file_of_the_same_content_is_not_read_again(project: Project):
    points = project.write("1.0", "points.txt")
    project.execute(READ)
    os.utime(points, (1.0, 1.0))
    assert ran(project.execute(READ)) == []


def test_a_moved_file_of_the_same_content_is_not_read_again_but_recorded(project: Project):
    points = project.write("1.0", "points.txt")
    project.execute(READ)
    points.rename("moved.txt")
    result = project.execute(READ.replace("points.txt", "moved.txt"))
    assert ran(result) == []
    assert record(result, "read_points").parameters["path"] == str(Path("moved.txt").resolve())


def test_a_file_that_changes_while_it_is_read_stores_nothing(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.write("1.0", "points.txt")
    contents = iter(["a", "a", "b"])
    for module in (records, runner):
        monkeypatch.setattr(
            module, "input_files", lambda step: {"path": next(contents)} if "path" in vars(step.params) else {}
        )
    with pytest.raises(StageError, match="read_points: an input file was changed during the run; run again"):
        project.execute(READ)
    assert not list((OUT / ".store" / "results").iterdir())


def test_a_new_version_of_a_stage_is_run(project: Project, install: Callable[..., None]):
    text = """
        from fake_stages import MakePointsParams, Points
        from scaffold_pipeline.stages.contract import stage
        import numpy as np

        @stage(writes="points", version={version})
        def versioned(*, params: MakePointsParams) -> Points:
            "Make points."
            return Points(np.full((1, 3), {version}.0))
        """
    config = "stages: [{use: versioned}, {use: draw_points}]"
    install("versioned_package", text.format(version=1), "versioned")
    assert ran(project.execute(config)) == ["versioned", "draw_points"]
    assert ran(project.execute(config)) == []
    install("versioned_package", text.format(version=10), "versioned")
    assert ran(project.execute(config)) == ["versioned", "draw_points"]


def test_a_forced_stage_is_run_and_what_follows_only_if_it_changed(project: Project):
    project.execute(CHAIN)
    assert ran(project.execute(CHAIN, force=["scatter_points"])) == ["scatter_points"]


def test_a_run_until_a_stage_stops_there_and_goes_on_later(project: Project):
    part = project.execute(CHAIN, until="scatter_points")
    assert [step.label for step in part.steps] == ["make_points", "scatter_points"]
    assert not part.is_complete
    assert ran(project.execute(CHAIN)) == ["grow_points", "draw_points", "count_points"]


def test_a_run_until_a_stage_keeps_what_comes_after(project: Project):
    project.execute(CHAIN)
    project.execute(CHAIN, until="scatter_points")
    assert ran(project.execute(CHAIN)) == []


def test_only_the_last_run_is_kept_in_store(project: Project):
    project.execute(CHAIN)
    sizes = {path.name for path in (OUT / ".store").rglob("*") if path.is_file()}
    project.execute(CHAIN, "seed=8")
    assert ran(project.execute(CHAIN)) == ["scatter_points", "grow_points", "draw_points", "count_points"]
    assert {path.name for path in (OUT / ".store").rglob("*") if path.is_file()} == sizes


def test_two_steps_of_the_same_key_share_a_result_and_keep_their_names(project: Project):
    text = "stages: [{use: make_points}, {use: make_points, as: others}, {use: draw_points, from: {points: others}}]"
    result = project.execute(text)
    other = record(result, "others")
    assert (other.reused, other.slot, other.stage) == (True, "others", "make_points")
    assert ran(project.execute(text)) == []


def test_warnings_of_a_stage_are_kept_and_told_again_when_it_is_reused(project: Project):
    told = [record(project.execute(CHAIN, "grow_points.limit=1"), "grow_points").warnings for _ in range(2)]
    assert told == [("the points reach beyond 1 mm",)] * 2


@pytest.mark.parametrize(
    ("how", "kind", "message"),
    [
        ("stage_error", StageError, "fail: the points are too few, 4; give more"),
        ("error", StageError, "fail: failed unexpectedly: ValueError: two lines; --debug shows where"),
        ("memory", MemoryShortageError, "fail: ran out of memory; use larger voxels or cells"),
        ("other_type", StageDefinitionError, "fail: returned a Metrics, but its annotation is Points"),
        ("nan", StageDefinitionError, "fail: the facts of its Odd cannot be stored as JSON: Out of range float values"),
        ("int64", StageDefinitionError, "fail: the facts of its Odd cannot be stored as JSON: Object of type int64"),
        ("folder", StageDefinitionError, "fail: `out` may hold only plain files, not named config.yaml, measures.json"),
    ],
)
def test_a_failure_is_one_line_that_names_the_stage(
    project: Project, how: str, kind: type[PipelineError], message: str
):
    with pytest.raises(kind) as caught:
        project.execute(f"stages: [{{use: make_points}}, {{use: fail, how: {how}}}]")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_what_was_finished_before_a_failure_is_not_run_again(project: Project):
    text = "stages: [{use: make_points}, {use: scatter_points}, {use: fail, how: HOW}]"
    with pytest.raises(StageError):
        project.execute(text.replace("HOW", "error"))
    assert ran(project.execute(text.replace("HOW", "nothing"))) == ["fail"]


@pytest.mark.parametrize("name", ["run.json", "metrics.json", "measures.json", "config.yaml", "report.html", ".hidden"])
def test_a_stage_may_not_write_the_engine_s_own_files(project: Project, name: str):
    with pytest.raises(StageDefinitionError, match=f"write_points: `out` may hold .*, got {name}"):
        project.execute(f"stages: [{{use: make_points}}, {{use: write_points, names: [{name}]}}]")


def test_two_stages_may_not_write_the_same_file(project: Project):
    text = "stages: [{use: make_points}, {use: write_points}, {use: write_points, as: other}]"
    for _ in range(2):
        with pytest.raises(StageError, match=r"other: writes points.txt, which write_points also writes"):
            project.execute(text)


def test_values_that_no_later_stage_reads_are_freed(project: Project):
    held: list[list[str]] = []
    plan = project.plan(CHAIN)
    original = runner._drop_unread

    def spy(plan: Plan, number: int, state: runner._State) -> None:
        original(plan, number, state)
        held.append(sorted(state.values))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_drop_unread", spy)
        execute(plan, OUT)
    assert held == [["points"], ["points"], ["points"], ["picture", "points"], []]


# What would run


def test_what_is_unchanged_is_told_without_writing(project: Project):
    plan = project.plan(CHAIN)
    assert unchanged_labels(plan, OUT) == []
    assert not OUT.exists()
    execute(plan, OUT)
    before = {path: path.stat().st_mtime_ns for path in OUT.rglob("*")}
    assert unchanged_labels(plan, OUT) == plan.labels
    assert unchanged_labels(plan, OUT, force=["scatter_points"]) == ["make_points"]
    changed = project.plan(CHAIN, "grow_points.factor=3")
    assert unchanged_labels(changed, OUT) == ["make_points", "scatter_points"]
    assert {path: path.stat().st_mtime_ns for path in OUT.rglob("*")} == before


def test_a_stage_beside_the_changed_one_is_told_to_be_unchanged(project: Project):
    text = "stages: [{use: make_points}, {use: count_points}, {use: draw_points}]"
    project.execute(text)
    plan = project.plan(text, "count_points.least=2")
    assert unchanged_labels(plan, OUT) == ["make_points", "draw_points"]


def test_a_damaged_result_is_told_to_be_run(project: Project):
    project.execute(CHAIN)
    for path in (OUT / ".store" / "results").iterdir():
        harm(path, "half")
    assert unchanged_labels(project.plan(CHAIN), OUT) == []


def test_an_array_that_a_stage_was_given_cannot_be_changed_by_it(project: Project, install: Callable[..., None]):
    install(
        "rude_package",
        """
        from fake_stages import DrawPointsParams, Points
        from scaffold_pipeline.stages.contract import stage

        @stage(writes="points", version=1)
        def rude(points: Points, *, params: DrawPointsParams) -> Points:
            "Change what is not its own."
            points.places[0] = 9.0
            return points
        """,
        "rude",
    )
    for text in ("stages: [{use: make_points}, {use: rude}]",) * 2:
        with pytest.raises(StageError, match=r"rude: failed unexpectedly: ValueError: .*read-only"):
            project.execute(text)
    assert np.load(next((OUT / ".store/arrays").iterdir())).tolist()[0] == [0.0, 0.0, 0.0]
