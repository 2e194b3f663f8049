"""Studies on a Dask cluster: a real scheduler and two workers, started here."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest

from pipeline.test_study import OUT, outputs, rows
from pipeline.workplace import Project, wait_for
from scaffold_pipeline.studies.cluster import call_in_process

needs_dask = pytest.mark.skipif(find_spec("distributed") is None, reason="dask.distributed is not installed: [dask]")

BASE = """
    seed: 7
    stages:
      - use: make_points
      - use: scatter_points
      - use: cast_points
        as: work
        log: LOG
        seconds: 1.0
      - use: write_points
    """
STUDY = """
    base: base.yaml
    mode: zip
    vary:
      scatter_points.amount: [0.1, 0.2, 0.3]
      work.log: [FOLDER/1, FOLDER/2, FOLDER/3]
    """


@contextmanager
def process(*arguments: object, path: str = "") -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": path} if path else None
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment) as running:
        try:
            yield running
        finally:
            running.kill()


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a scheduler on loopback and give its address and its process."""
    told = folder / "scheduler.json"
    options = ("--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", told)
    with process("distributed.cli.dask_scheduler", *options) as running:
        wait_for(lambda: told.is_file() and told.read_text().endswith("}"))
        yield json.loads(told.read_text())["address"], running


@contextmanager
def worker(address: str, *options: object, path: str = "") -> Iterator[subprocess.Popen[bytes]]:
    options = ("--nthreads", 1, "--no-dashboard", *options)
    with process("distributed.cli.dask_worker", address, *options, path=path) as running:
        yield running


def wait_for_workers(address: str, count: int) -> None:
    code = (
        "import sys; from distributed import Client; Client(sys.argv[1]).wait_for_workers(int(sys.argv[2]), timeout=30)"
    )
    subprocess.run([sys.executable, "-c", code, address, str(count)], check=True, timeout=60)


@needs_dask
def test_a_worker_that_is_killed_costs_a_retry_and_not_the_study(project: Project):
    logs = project.folder / "logs"
    logs.mkdir()
    project.write(BASE.replace("LOG", str(logs / "0")), "base.yaml")
    project.write(STUDY.replace("FOLDER", str(logs)), "study.yaml")
    with (
        scheduler(project.folder) as (address, _),
        worker(address, "--no-nanny") as first,
        worker(address, "--no-nanny"),
    ):
        wait_for_workers(address, 2)
        lasting = ("--set", "work.seconds=5.0")  # so that both work when one is killed, however busy the machine is
        study = project.start("study", "study.yaml", "--scheduler", address, *lasting)
        wait_for(lambda: len(list(logs.iterdir())) == 2, study)
        os.kill(first.pid, signal.SIGKILL)
        err = study.communicate(timeout=90)[1]
        assert (study.returncode, "Traceback" in err) == (0, False), err
    assert [row["error"] for row in rows()] == ["", "", ""]
    assert sorted(log.read_text().count("called") for log in logs.iterdir()) == [1, 1, 2]
    assert json.loads((OUT / "study.json").read_text())["workers"] == 2
    local = project.command("study", "study.yaml", "--out", "local", "--workers", "1", "--set", "work.seconds=0.0")
    assert local.code == 0
    assert written() == written(Path("local"))


def written(out: Path = OUT) -> list[str]:
    return [stages["write_points"] for stages in outputs(out).values()]


@needs_dask
def test_a_scheduler_that_does_not_answer_is_told_within_seconds_and_nothing_is_written(project: Project):
    project.write(BASE, "base.yaml")
    project.write(STUDY, "study.yaml")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        study = project.start("study", "study.yaml", "--scheduler", address)
        _, err = study.communicate(timeout=25)
    assert study.returncode == 1
    assert err == f"{address}: no Dask scheduler answers within 5 s; give the address it printed\n"
    assert not (OUT / "study.json").exists()


@needs_dask
def test_a_worker_with_another_version_of_a_library_is_named_and_nothing_is_run(project: Project):
    other = project.folder / "other" / "scipy-0.0.1.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: scipy\nVersion: 0.0.1\n")
    project.write(BASE, "base.yaml")
    project.write("{base: base.yaml, repeats: 2}", "study.yaml")
    with scheduler(project.folder) as (address, _), worker(address, "--no-nanny", path=str(other.parent)):
        wait_for_workers(address, 1)
        study = project.start("study", "study.yaml", "--scheduler", address)
        _, err = study.communicate(timeout=30)
    assert study.returncode == 1
    assert re.fullmatch(rf"{address}: worker tcp://\S+ has scipy 0.0.1, here it is {version('scipy')}, so .*\n", err)
    assert not (OUT / "study.json").exists()


@needs_dask
def test_a_worker_without_this_package_is_named(project: Project):
    (project.folder / "other" / "scaffold_pipeline").mkdir(parents=True)
    (project.folder / "other" / "scaffold_pipeline" / "__init__.py").write_text("")
    project.write(BASE, "base.yaml")
    project.write("{base: base.yaml, repeats: 2}", "study.yaml")
    other = str(project.folder / "other")
    with scheduler(project.folder) as (address, _), worker(address, "--no-nanny", path=other):
        wait_for_workers(address, 1)
        study = project.start("study", "study.yaml", "--scheduler", address)
        _, err = study.communicate(timeout=30)
    assert study.returncode == 1
    assert re.fullmatch(rf"{address}: worker tcp://\S+ cannot be used \(.*\); install scaffold-pipeline there\n", err)


@needs_dask
def test_a_scheduler_without_workers_and_one_that_is_lost_are_told(project: Project):
    log = project.folder / "log"
    project.write(BASE.replace("LOG", str(log)).replace("1.0", "20.0"), "base.yaml")
    project.write("{base: base.yaml, repeats: 2}", "study.yaml")
    with scheduler(project.folder) as (address, running):
        study = project.start("study", "study.yaml", "--scheduler", address)
        _, err = study.communicate(timeout=30)
        assert study.returncode == 1
        assert err == f"{address}: the scheduler has no workers; start some with `dask worker {address}`\n"
        with worker(address, "--no-nanny"):
            wait_for_workers(address, 1)
            study = project.start("study", "study.yaml", "--scheduler", address)
            wait_for(log.is_file, study)
            running.kill()
            _, err = study.communicate(timeout=30)
    assert study.returncode == 1
    assert err == f"{address}: the scheduler was lost; finished points are kept: the same command continues\n"
    assert [row["error"] for row in rows()] == ["not run", "not run"]


def test_a_call_in_a_process_returns_what_it_does_and_raises_what_it_does_not():
    assert call_in_process(sorted, [3, 1]) == [1, 3]
    with pytest.raises(BrokenExecutor, match=r"exit code 1 .*ValueError"):
        call_in_process(int, "many")
    with pytest.raises(BrokenExecutor, match="exit code -9"):
        call_in_process(signal.raise_signal, signal.SIGKILL)
