from __future__ import annotations

import signal
from pathlib import Path

import pytest

from pipeline.workplace import Project, wait_for
from scaffold_pipeline.runs import runner

SOUND = """
    stages:
      - use: make_points
      - use: scatter_points
      - use: write_points
      - use: count_points
    """
WRONG = """
    stages:
      - use: make_points
        count: 0
      - use: scater_points
    """
FAILING = """
    stages:
      - use: make_points
      - use: write_points
      - use: fail
        how: stage_error
    """


# run


def test_a_run_tells_each_stage_and_where_the_result_is(project: Project):
    answer = project.command("run", project.write(SOUND))
    assert answer.code == 0
    assert answer.out == "runs/config: porosity not measured, quality: pass; see runs/config/report.html\n"
    assert [line.partition(":")[0] for line in answer.err.splitlines()] == [
        "make_points",
        "scatter_points",
        "write_points",
        "count_points",
    ]
    assert (project.folder / "runs/config/points.txt").is_file()


def test_the_same_command_again_runs_nothing(project: Project):
    config = project.write(SOUND)
    project.command("run", config)
    answer = project.command("run", config)
    assert answer.code == 0
    assert all(line.endswith(": unchanged") for line in answer.err.splitlines())
    assert set(project.reused().values()) == {True}


def test_out_and_set_say_where_and_what(project: Project):
    answer = project.command(
        "run", project.write(SOUND), "--out", "here/deep", "--set", "make_points.count=9", "--set", "name=mine"
    )
    assert answer.code == 0
    record = project.record("here/deep")
    assert (record["name"], record["config"]["stages"][0]["count"]) == ("mine", 9)
    assert not Path("runs").exists()


def test_the_name_names_the_default_directory(project: Project):
    assert project.command("run", project.write(SOUND), "--set", "name=bone.v2").code == 0
    assert project.record("runs/bone.v2")["name"] == "bone.v2"


@pytest.mark.parametrize(
    ("force", "again"),
    [
        (["--force", "scatter_points"], ["scatter_points"]),
        (["--force", "scatter_points", "make_points"], ["make_points", "scatter_points"]),
        (["--force"], ["make_points", "scatter_points", "write_points", "count_points"]),
        ([], []),
    ],
)
def test_force_runs_all_stages_or_the_named_ones_again(project: Project, force: list[str], again: list[str]):
    config = project.write(SOUND)
    project.command("run", config)
    assert project.command("run", config, *force).code == 0
    assert [label for label, reused in project.reused().items() if not reused] == again


def test_until_stops_there_and_publishes_nothing(project: Project):
    config = project.write(SOUND)
    answer = project.command("run", config, "--until", "scatter_points")
    assert (answer.code, answer.out) == (0, "stopped after scatter_points\n")
    assert set(project.files()) <= {".lock"}
    assert project.command("run", config).code == 0
    assert project.reused() == {
        "make_points": True,
        "scatter_points": True,
        "write_points": False,
        "count_points": False,
    }


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["--until", "scater_points"], "--until scater_points: the config has no stage 'scater_points'; did you mean"),
        (["--force", "count_point"], "--force count_point: the config has no stage 'count_point'; did you mean"),
        (["--set", "scater.amount=1"], "--set scater.amount=1: the config has no stage 'scater'; did you mean"),
        (["--set", "scatter_points.amuont=1"], "--set scatter_points.amuont=1: stages.1 (scatter_points): unknown"),
    ],
)
def test_an_option_that_names_nothing_suggests_the_nearest(project: Project, options: list[str], fault: str):
    answer = project.command("run", project.write(SOUND), *options)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith(fault)
    assert "did you mean" in answer.err
    assert not Path("runs").exists()


@pytest.mark.parametrize("flag", ["-n", "--dry-run"])
def test_a_dry_run_tells_what_would_run_and_writes_nothing(project: Project, flag: str):
    config = project.write(SOUND)
    answer = project.command("run", config, flag)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.splitlines()[0] == "make_points: to run"
    assert list(project.folder.iterdir()) == [project.folder / config]
    project.command("run", config)
    before = project.files()
    options = ["--set", "scatter_points.amount=0.3", "--until", "write_points"]
    assert project.command("run", config, flag, *options).out.splitlines() == [
        "make_points: unchanged",
        "scatter_points: to run",
        "write_points: to run",
    ]
    forced = project.command("run", config, "--force", flag, "--json").json
    assert forced == {"stages": list(project.reused()), "unchanged": []}
    assert project.files() == before


def test_quiet_says_nothing(project: Project):
    answer = project.command("run", project.write(SOUND), "--quiet")
    assert (answer.code, answer.out, answer.err) == (0, "", "")


def test_warnings_are_told(project: Project):
    config = project.write("stages: [{use: make_points}, {use: grow_points, limit: 1.0}]")
    for _ in range(2):
        answer = project.command("run", config)
        assert answer.err.splitlines()[-1] == "grow_points: warning: the points reach beyond 1 mm"
        assert "divide by zero" not in answer.err


def test_damage_is_told_and_mended(project: Project):
    config = project.write(SOUND)
    project.command("run", config)
    for path in Path("runs/config/.store/results").iterdir():
        path.write_text("{")
    answer = project.command("run", config)
    assert answer.code == 0
    assert answer.err.startswith("warning: make_points: stored result ")
    assert project.command("run", config).err.count("unchanged") == 4


# Failures


def test_a_fault_of_the_config_is_a_line_and_exit_code_2(project: Project):
    answer = project.command("run", project.write(WRONG))
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.splitlines() == [
        "config.yaml:3:5: stages.0 (make_points): count: must be greater than or equal to 1, got 0",
        "config.yaml:4:5: stages.1 (scater_points): no stage is called 'scater_points'; did you mean 'scatter_points'?",
    ]
    assert not Path("runs").exists()


def test_a_failing_stage_is_a_line_and_exit_code_1(project: Project):
    answer = project.command("run", project.write(FAILING), "--quiet")
    assert (answer.code, answer.out) == (1, "")
    assert answer.err == "fail: the points are too few, 4; give more\n"


@pytest.mark.parametrize(("how", "cause"), [("stage_error", "StageError"), ("error", "ValueError")])
def test_debug_shows_a_traceback_and_keeps_the_exit_code(project: Project, how: str, cause: str):
    config = project.write(FAILING)
    answer = project.command("run", config, "--debug", "--set", f"fail.how={how}")
    assert answer.code == 1
    assert "Traceback (most recent call last)" in answer.err
    assert cause in answer.err
    assert project.command("--debug", "run", project.write(WRONG)).code == 2


def test_a_failing_run_leaves_the_files_of_an_earlier_one_as_they_were(project: Project):
    config = project.write(FAILING.replace("stage_error", "nothing"))
    assert project.command("run", config).code == 0
    before = project.files()
    answer = project.command("run", config, "--set", "fail.how=error", "--set", "make_points.count=9")
    assert answer.code == 1
    assert project.files() == before


def test_a_failed_gate_is_exit_code_3_and_keeps_the_files(project: Project):
    config = project.write(SOUND + "    least: 5\n")
    for _ in range(2):
        answer = project.command("run", config)
        assert answer.code == 3
        assert answer.err.splitlines()[-1] == "runs/config: quality gate failed: points: must be 5 at least, got 4"
        assert "quality: FAILED" in answer.out
    assert (Path("runs/config") / "points.txt").is_file()
    assert project.record()["quality"] == ["points: must be 5 at least, got 4"]


def test_an_interrupt_is_exit_code_130(project: Project):
    answer = project.command("run", project.write(FAILING), "--set", "fail.how=interrupt", "--quiet")
    assert (answer.code, answer.out) == (130, "")
    assert answer.err == "interrupted; finished stages are kept: the same command continues\n"
    assert set(project.files()) <= {".lock"}


@pytest.mark.parametrize("out", ["file", "file/deep"])
def test_a_directory_that_cannot_be_made_is_a_line(project: Project, out: str):
    Path("file").write_text("mine")
    answer = project.command("run", project.write(SOUND), "--out", out)
    assert answer.code == 1
    assert len(answer.err.splitlines()) == 1
    assert answer.err.startswith("file")
    assert Path("file").read_text() == "mine"


def test_a_directory_that_may_not_be_written_is_a_line(project: Project, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "runs/config/.store")

    monkeypatch.setattr(runner.Store, "prepare", refuse)
    answer = project.command("run", project.write(SOUND))
    assert (answer.code, answer.err) == (1, "runs/config/.store: Permission denied\n")


def test_a_mistake_of_ours_is_a_line_too(project: Project, monkeypatch: pytest.MonkeyPatch):
    def stumble(*_: object, **__: object) -> None:
        raise KeyError("nowhere")

    monkeypatch.setattr(runner, "execute", stumble)
    answer = project.command("run", project.write(SOUND))
    assert (answer.code, answer.err) == (1, "unexpected KeyError: 'nowhere'; --debug shows where\n")


def test_a_second_run_in_the_same_directory_is_refused_with_a_line(project: Project):
    sign = project.folder / "sign"
    config = project.write(f"stages: [{{use: make_points}}, {{use: wait, seconds: 60, sign: '{sign}'}}]")
    first = project.start("run", config)
    wait_for(sign.exists, first)
    other = project.command("run", config)
    dry = project.command("run", config, "-n")
    first.send_signal(signal.SIGINT)
    _, err = first.communicate(timeout=30)
    assert (first.returncode, err.splitlines()[-1].partition(";")[0]) == (130, "interrupted")
    assert (other.code, other.out) == (1, "")
    assert other.err == "runs/config: another run is using this directory; wait for it or choose another --out\n"
    assert dry.out.splitlines() == ["make_points: unchanged", "wait: to run"]


# --json


@pytest.mark.parametrize(
    ("text", "options", "code"),
    [
        (SOUND, [], 0),
        (SOUND, ["--until", "make_points"], 0),
        (SOUND, ["-n"], 0),
        (SOUND, ["--set", "count_points.least=9"], 3),
        (WRONG, [], 2),
        (SOUND, ["--until", "nowhere"], 2),
        (SOUND, ["--nonsense"], 2),
        (FAILING, [], 1),
        (FAILING, ["--set", "fail.how=interrupt"], 130),
    ],
)
def test_json_prints_one_object_and_nothing_else(project: Project, text: str, options: list[str], code: int):
    answer = project.command("run", project.write(text), "--json", *options)
    assert answer.code == code
    assert isinstance(answer.json, dict)
    if code not in {0, 3}:
        assert answer.json == {"error": answer.err.splitlines(), "exit_code": code}


def test_json_of_a_run_tells_metrics_and_files(project: Project):
    answer = project.command("run", project.write(SOUND), "--json").json
    assert answer["out"] == "runs/config"
    assert answer["metrics"]["quality"] == "pass"
    assert list(answer["files"]) == ["points.txt"]
