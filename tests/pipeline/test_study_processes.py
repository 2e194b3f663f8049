"""Studies in processes: more than one at a time, killed and interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.test_study import BASE, NAMES, OUT, POINTS, STUDY, outputs, record, rows
from pipeline.workplace import Project, wait_for
from scaffold_pipeline.processes.threads import core_count


def unfinished() -> list[str]:
    """Return what is half-written in the study's folder."""
    names = [path.name for path in OUT.rglob("*") if path.name.startswith(".")]
    return [name for name in names if name not in {".store", ".lock"}]


def test_two_workers_give_what_one_gives(project: Project):
    project.write(BASE, "base.yaml")
    project.write(STUDY, "study.yaml")
    assert project.command("study", "study.yaml", "--workers", "2").code == 0
    assert project.command("study", "study.yaml", "--workers", "1", "--out", "one").code == 0
    assert outputs() == outputs(Path("one"))
    assert record(NAMES[0])["platform"]["threads"] == max(1, core_count() // 2)


def test_no_result_depends_on_the_threads_of_blas(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.write("stages: [{use: make_points}, {use: solve_points}]")
    for count in ("1", "2"):
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", count)
        process = project.start("run", "config.yaml", "--out", count)
        assert (process.wait(60), process.communicate()[1].count("solve_points")) == (0, 1)
    one, two = (project.record(count)["stages"][1]["output"] for count in ("1", "2"))
    assert one == two


def test_a_worker_that_dies_costs_a_retry_and_not_the_study(project: Project):
    log = project.folder / "log"
    project.write(f"stages: [{{use: make_points}}, {{use: die, log: '{log}', times: 1}}]", "base.yaml")
    project.write("base: base.yaml\nvary: {die.times: [0, 1], make_points.count: [1, 2]}\n", "study.yaml")
    answer = project.command("study", "study.yaml", "--workers", "2", "--keep-going")
    assert answer.code == 0
    assert [row["error"] for row in rows()] == [""] * 4
    assert log.read_text() == "died\n"


WAITING = """
    stages:
      - use: make_points
      - use: scatter_points
      - use: wait
        sign: SIGN
        seconds: 0
      - use: write_points
    """
TWO_WAIT = """
    mode: list
    base: base.yaml
    vary:
      - {scatter_points.amount: 0.1}
      - {scatter_points.amount: 0.2, wait.seconds: 60.0, wait.sign: OTHER}
      - {scatter_points.amount: 0.3}
    """


@pytest.mark.parametrize(
    ("send", "sign"),
    [(os.kill, signal.SIGINT), (os.killpg, signal.SIGINT), (os.kill, signal.SIGKILL)],
    ids=["interrupt", "interrupt_of_all_processes", "kill"],
)
def test_a_study_that_is_stopped_goes_on_where_it_was(
    project: Project, send: Callable[[int, int], None], sign: signal.Signals
):
    begun = project.folder / "begun"
    project.write(WAITING.replace("SIGN", str(project.folder / "sign")), "base.yaml")
    project.write(TWO_WAIT.replace("OTHER", str(begun)), "study.yaml")
    process = project.start("study", "study.yaml", "--workers", "1")
    wait_for(begun.exists, process)
    send(process.pid, sign)
    _, err = process.communicate(timeout=30)
    assert process.returncode == (130 if sign == signal.SIGINT else -signal.SIGKILL)
    assert "Traceback" not in err
    first = next(POINTS.glob("amount-0.1*"))
    kept = (first / "run.json").read_bytes()
    if sign == signal.SIGINT:
        assert err.splitlines()[-1].startswith("interrupted; finished stages are kept: the same command continues")
        assert [row["error"] for row in rows()] == ["", "not run", "not run"]
        assert unfinished() == []
    project.write(TWO_WAIT.replace("OTHER", str(begun)).replace("60.0", "0.0"), "study.yaml")
    again = project.command("study", "study.yaml", "--workers", "1")
    assert again.code == 0
    assert (first / "run.json").read_bytes() == kept
    assert [row["error"] for row in rows()] == ["", "", ""]
    assert unfinished() == [] or sign == signal.SIGKILL
