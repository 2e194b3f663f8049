from __future__ import annotations

import json
import signal
from pathlib import Path
from threading import Thread

import pytest

from pipeline.workplace import Project, harm, ran, wait_for
from scaffold_pipeline.errors import PipelineError, StageError
from scaffold_pipeline.runs import records, store
from scaffold_pipeline.runs.records import StepRecord
from scaffold_pipeline.runs.runner import Progress, RunResult, locked

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


FILES = """
    stages:
      - use: make_points
      - use: scatter_points
      - use: write_points
      - use: count_points
    """


@pytest.mark.parametrize("how", ["gone", "half", "bit"])
@pytest.mark.parametrize("kind", ["arrays", "artifacts", "files", "results"])
def test_a_damaged_store_is_made_whole_again_with_a_warning(project: Project, kind: str, how: str):
    whole = project.execute(FILES)
    for path in (OUT / ".store" / kind).iterdir():
        harm(path, how)
    told: list[str] = []
    changes = [] if kind == "files" else ["count_points.least=0"]  # what is written is loaded by nobody
    result = project.execute(FILES, *changes, progress=Progress(warned=told.append))
    assert [step.output for step in result.steps][:3] == [step.output for step in whole.steps][:3]
    assert tuple(told) == result.warnings
    assert len(told) > 0 or (kind, how) == ("results", "gone")
    assert all("is run again" in message for message in told)
    repaired = project.execute(FILES, *changes)
    assert ran(repaired) == []
    assert repaired.warnings == ()
    copies = store.Store(OUT / ".store")
    for name, digest in repaired.files.items():
        copies.copy_file(digest, Path(name))


def test_only_the_stage_whose_result_is_damaged_is_run_again(project: Project):
    first = project.execute(CHAIN)
    digest = json.loads((OUT / ".store/artifacts" / f"{record(first, 'grow_points').output}.json").read_text())
    harm(OUT / ".store/arrays" / f"{digest['fields']['places']['array']}.npy", "bit")
    result = project.execute(CHAIN, "count_points.least=2")
    assert ran(result) == ["grow_points", "count_points"]
    assert len(result.warnings) == 1


def test_damaged_metrics_are_measured_again(project: Project):
    first = project.execute(CHAIN)
    harm(OUT / ".store/artifacts" / f"{record(first, 'count_points').output}.json", "half")
    result = project.execute(CHAIN)
    assert ran(result) == ["count_points"]
    assert result.metrics is not None


def test_a_forced_stage_is_run_once_though_another_is_damaged(project: Project):
    project.execute(CHAIN)
    for path in (OUT / ".store" / "arrays").iterdir():
        harm(path, "bit")
    started: list[str] = []
    stages = Progress(finished=lambda done: None if done.reused else started.append(done.label))
    result = project.execute(CHAIN, force=["make_points"], progress=stages)
    assert started.count("make_points") == 1
    assert result.is_complete


def test_a_disk_that_keeps_nothing_ends_the_run_with_a_line(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.execute(CHAIN)

    def fail_to_load(_store: store.Store, digest: str) -> None:
        raise store.DamagedStoreError(f"stored artifact {digest[:12]} cannot be read")

    monkeypatch.setattr(store.Store, "load", fail_to_load)
    told: list[str] = []
    with pytest.raises(PipelineError, match=r"^stored artifact \w{12} cannot be read$"):
        project.execute(CHAIN, progress=Progress(warned=told.append))
    assert len(told) == 5


def test_results_in_the_form_of_an_earlier_version_are_not_used(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.execute(CHAIN)
    original = records.fields
    monkeypatch.setattr(records, "fields", lambda kind: original(kind)[1:])
    assert len(ran(project.execute(CHAIN))) == 5


# One run at a time


def test_a_directory_in_use_is_refused(project: Project):
    refused: list[str] = []

    def second() -> None:
        with pytest.raises(PipelineError) as caught:
            project.execute(CHAIN)
        refused.append(str(caught.value))

    with locked(OUT):
        thread = Thread(target=second)
        thread.start()
        thread.join()
        project.execute(CHAIN)
    assert refused == ["out: another run is using this directory; wait for it or choose another --out"]
    project.execute(CHAIN)


def test_a_failed_run_frees_its_directory(project: Project):
    with pytest.raises(StageError):
        project.execute("stages: [{use: fail, how: error}]")
    assert project.execute(CHAIN).is_complete


# Killed


WAIT = """
    stages:
      - use: make_points
      - use: scatter_points
      - use: wait
        sign: SIGN
        seconds: SECONDS
      - use: write_points
    """


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="the system has no kill -9")
def test_a_killed_run_goes_on_where_it_was_and_leaves_nothing_behind(project: Project):
    sign = project.folder / "sign"
    text = WAIT.replace("SIGN", str(sign)).replace("SECONDS", "60")
    process = project.start("run", project.write(text), "--out", OUT)
    wait_for(sign.exists, process)
    process.kill()
    process.communicate()
    assert list(OUT.rglob("half_written.txt"))
    done = project.execute(text.replace("60", "0"))
    assert ran(done) == ["wait", "write_points"]
    left = [path.name for path in OUT.rglob("*") if path.name.startswith(".") or path.name == "half_written.txt"]
    assert sorted(left) in ([".lock", ".store"], [".store"])


def test_an_interrupt_is_told_with_its_exit_code_and_resumed(project: Project):
    sign = project.folder / "sign"
    text = WAIT.replace("SIGN", str(sign)).replace("SECONDS", "60")
    process = project.start("run", project.write(text), "--out", OUT)
    wait_for(sign.exists, process)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert out == ""
    assert err.splitlines()[-1].startswith("interrupted; finished stages are kept: the same command continues")
    assert "Traceback" not in err
    assert not list(OUT.rglob("half_written.txt"))
    assert ran(project.execute(text.replace("60", "0"))) == ["wait", "write_points"]
