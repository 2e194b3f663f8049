from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread

import pytest

from pipeline.workplace import Project, harm, ran, wait_for
from scaffold_pipeline.errors import ConfigError
from scaffold_pipeline.runs import cache as cache_module
from scaffold_pipeline.runs import store as store_module
from scaffold_pipeline.runs.cache import Cache, parse_size
from scaffold_pipeline.runs.runner import Progress, execute, unchanged_labels
from scaffold_pipeline.runs.store import Store, hash_input

CHAIN = """
    seed: 7
    stages:
      - use: make_points
        count: 3
      - use: scatter_points
      - use: write_points
      - use: count_points
    """
LABELS = ["make_points", "scatter_points", "write_points", "count_points"]
CAST = """
    stages:
      - use: cast_points
        log: LOG
        seconds: SECONDS
      - use: write_points
    """


@pytest.fixture
def cache(project: Project) -> Cache:
    return Cache(project.folder / "cache")


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# What is shared


def test_a_second_run_takes_what_the_first_one_made(project: Project, cache: Cache):
    first = project.execute(CHAIN, out="a", cache=cache)
    second = project.execute(CHAIN, out="b", cache=cache)
    assert ran(first) == LABELS
    assert ran(second) == []
    assert [step.output for step in second.steps] == [step.output for step in first.steps]
    assert second.files == first.files


def test_a_run_that_differs_takes_what_is_common(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    assert ran(project.execute(CHAIN, "scatter_points.amount=0.3", out="b", cache=cache)) == LABELS[1:]


def test_a_run_holds_all_that_it_needs_without_the_cache(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    project.execute(CHAIN, out="b", cache=cache)
    shutil.rmtree(cache.root)
    assert ran(project.execute(CHAIN, out="b")) == []


def test_what_is_shared_lies_on_the_disk_once(project: Project, cache: Cache):
    result = project.execute(CHAIN, out="a", cache=cache)
    digest = result.files["points.txt"]
    assert Store(Path("a/.store")).path("files", digest).samefile(cache.store.path("files", digest))


def test_on_two_disks_what_is_shared_is_copied(project: Project, cache: Cache, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(store_module.os, "link", refuse)
    project.execute(CHAIN, out="a", cache=cache)
    assert ran(project.execute(CHAIN, out="b", cache=cache)) == []
    assert not list(project.folder.rglob(".partial-*"))


def test_a_stage_that_cannot_repeat_itself_gives_all_runs_one_result(project: Project, cache: Cache):
    text = CAST.replace("LOG", "log").replace("SECONDS", "0")
    outputs = {project.execute(text, out=out, cache=cache).steps[0].output for out in "abc"}
    assert len(outputs) == 1
    assert project.execute(text, out="alone").steps[0].output not in outputs


def test_a_forced_stage_is_run_though_the_cache_has_it(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    assert ran(project.execute(CHAIN, out="b", force=["scatter_points"], cache=cache)) == ["scatter_points"]


def test_another_version_of_a_library_is_another_result(
    project: Project, cache: Cache, install: Callable[..., None], monkeypatch: pytest.MonkeyPatch
):
    text = """
        from fake_stages import MakePointsParams, Points
        from scaffold_pipeline.stages.contract import stage
        import numpy as np

        @stage(writes="points", version=1, libraries=("library",))
        def leaning(*, params: MakePointsParams) -> Points:
            "Make points."
            return Points(np.zeros((1, 3)))
        """
    config = "stages: [{use: leaning}, {use: draw_points}]"
    versions = {"library": "1.0", "numpy": "2.0"}
    monkeypatch.setattr("scaffold_pipeline.stages.contract.version_of", versions.__getitem__)
    install("leaning_package", text, "leaning")
    result = project.execute(config, cache=cache)
    assert result.steps[0].libraries == {"library": "1.0", "numpy": "2.0"}
    assert ran(project.execute(config, out="b", cache=cache)) == []
    versions["library"] = "1.1"
    install("leaning_package", text, "leaning")
    assert ran(project.execute(config, out="c", cache=cache)) == ["leaning"]


def test_what_the_cache_holds_is_told_before_a_run(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    before = files(cache.root)
    plan = project.plan(CHAIN, "scatter_points.amount=0.2")
    assert unchanged_labels(plan, Path("b")) == []
    assert unchanged_labels(plan, Path("b"), cache=cache) == ["make_points"]
    assert files(cache.root) == before
    assert not Path("b").exists()


def test_inputs_are_hashed_again_when_they_change(tmp_path: Path):
    path = tmp_path / "points.txt"
    hashes = []
    for text, age in (("1.0", 60.0), ("1.0", 60.0), ("2.0", 30.0), ("3.0", 0.0), ("4.0", 0.0)):
        path.write_text(text)
        os.utime(path, (time.time() - age,) * 2)
        hashes.append(hash_input(path))
    assert len(set(hashes)) == 4
    assert hashes[0] == hashes[1]


# Damage


@pytest.mark.parametrize("how", ["gone", "half", "bit", "empty"])
@pytest.mark.parametrize("kind", ["arrays", "artifacts", "files", "results"])
def test_what_is_damaged_is_made_again_and_the_cache_is_whole(project: Project, cache: Cache, kind: str, how: str):
    whole = project.execute(CHAIN, out="a", cache=cache)
    shutil.rmtree("a")
    for path in (cache.root / kind).iterdir():
        harm(path, how)
    told: list[str] = []
    again = project.execute(CHAIN, out="b", cache=cache, progress=Progress(warned=told.append))
    assert [step.output for step in again.steps] == [step.output for step in whole.steps]
    assert ran(again) != []
    assert (told == []) == ((kind, how) == ("results", "gone"))
    assert all(message.startswith(f"cache {cache.root}: stored ") for message in told)
    shutil.rmtree("b")
    third = project.execute(CHAIN, out="c", cache=cache)
    assert (ran(third), third.warnings) == ([], ())


# A cache that cannot be written


@pytest.mark.parametrize("place", ["cache", "cache/locks", "cache/results", "cache/arrays"])
def test_a_cache_that_cannot_be_made_loses_nothing_and_is_told_once(project: Project, cache: Cache, place: str):
    blocked = project.folder / place
    blocked.parent.mkdir(exist_ok=True)
    blocked.write_text("a file where a folder should be")
    result = project.execute(CHAIN, out="a", cache=cache)
    assert (ran(result), result.is_complete) == (LABELS, True)
    (message,) = result.warnings
    assert message.startswith(f"cache {cache.root}: cannot be written (")
    assert message.endswith("; results stay in the run's own folder")
    assert ran(project.execute(CHAIN, out="a")) == []


@pytest.mark.parametrize(("number", "reason"), [(28, "No space left on device"), (30, "Read-only file system")])
def test_a_full_or_read_only_disk_loses_nothing(
    project: Project, cache: Cache, monkeypatch: pytest.MonkeyPatch, number: int, reason: str
):
    original = store_module._link

    def refuse(source: Path, target: Path) -> None:
        if target.is_relative_to(cache.root):
            raise OSError(number, reason, str(target))
        original(source, target)

    monkeypatch.setattr(store_module, "_link", refuse)
    result = project.execute(CHAIN, out="a", cache=cache)
    assert result.is_complete
    assert [message for message in result.warnings if reason in message] == list(result.warnings)
    assert len(result.warnings) == 1


def test_a_read_only_cache_is_read(project: Project, cache: Cache, monkeypatch: pytest.MonkeyPatch):
    project.execute(CHAIN, out="a", cache=cache)

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(cache_module, "FileLock", refuse)
    result = project.execute(CHAIN, "scatter_points.amount=0.2", out="b", cache=cache)
    assert ran(result) == LABELS[1:]
    assert len(result.warnings) == 1


# Many at a time


def test_two_runs_at_one_key_compute_it_once(project: Project, cache: Cache):
    text = CAST.replace("LOG", str(project.folder / "log")).replace("SECONDS", "0.5")
    plan = project.plan(text)
    outputs = []

    def work(out: str) -> None:
        outputs.append(execute(plan, Path(out), cache=cache).steps[0].output)

    threads = [Thread(target=work, args=(out,)) for out in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(outputs)) == 1
    assert Path("log").read_text().count("called") == 1


def test_a_killed_process_does_not_hold_its_key(project: Project, cache: Cache):
    text = CAST.replace("LOG", str(project.folder / "log")).replace("SECONDS", "60")
    process = project.start("run", project.write(text), "--out", "a", "--cache", cache.root)
    wait_for(Path("log").exists, process)
    process.kill()
    process.communicate()
    (lock,) = (cache.root / "locks").iterdir()
    cache.lock(lock.stem).release()
    assert ran(project.execute(text.replace("60", "0"), out="a", cache=cache)) == ["cast_points", "write_points"]


# Size


def test_sizes_are_read_from_text():
    assert parse_size("1.5 MB", "--keep") == 1_500_000
    for text in ("", "5", "GB", "-1 GB", "five GB"):
        with pytest.raises(ConfigError, match="--keep: must be a size such as 500 MB or 20 GB, got"):
            parse_size(text, "--keep")


def test_what_was_used_last_is_kept(project: Project, cache: Cache):
    for number, out in enumerate("abcd"):
        project.execute(CHAIN, f"seed={number}", out=out, cache=cache)
        for entry in (cache.root / "results").iterdir():
            os.utime(entry, (entry.stat().st_mtime - 100.0,) * 2)
    project.execute(CHAIN, "seed=0", out="e", cache=cache)
    before = cache.size()
    freed = cache.prune(before // 2)
    assert cache.size() == before - freed <= before // 2
    assert ran(project.execute(CHAIN, "seed=0", out="f", cache=cache)) == []
    assert ran(project.execute(CHAIN, "seed=1", out="g", cache=cache)) != []
    assert ran(project.execute(CHAIN, "seed=2", out="c")) == []


def test_what_is_whole_is_kept_whole_by_pruning(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    assert cache.prune(10**9) == 0
    for limit in (2000, 1000, 500):
        cache.prune(limit)
        for entry in cache.entries():
            assert cache.fetch(entry.key, Store(Path("a/.store")))
    cache.prune(0)
    assert cache.entries() == []
    assert cache.size() == 0


def test_pruning_leaves_what_another_process_is_storing(project: Project, cache: Cache):
    project.execute(CHAIN, out="a", cache=cache)
    fresh = cache.root / "files" / "no result needs it yet"
    fresh.write_bytes(b"content")
    cache.prune(0)
    assert fresh.exists()


# The commands


def test_run_shares_in_the_folder_that_is_named(project: Project, monkeypatch: pytest.MonkeyPatch):
    config = project.write(CHAIN)
    assert project.command("run", config, "--out", "a", "--cache", "shared").code == 0
    assert project.command("run", config, "--out", "b", "--cache", "shared").err.count("unchanged") == 4
    assert project.command("run", config, "--out", "c").err.count("unchanged") == 0
    monkeypatch.setenv("SCAFFOLD_PIPELINE_CACHE", "shared")
    assert project.command("run", config, "--out", "d", "-n").out.count("unchanged") == 4
    assert project.command("run", config, "--out", "d").err.count("unchanged") == 4


def test_the_cache_is_kept_below_its_limit(project: Project, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SCAFFOLD_PIPELINE_CACHE", "shared")
    monkeypatch.setenv("SCAFFOLD_PIPELINE_CACHE_LIMIT", "0 B")
    assert project.command("run", project.write(CHAIN)).code == 0
    assert project.command("cache", "size", "--json").json == {"results": 0, "bytes": 0}
    monkeypatch.setenv("SCAFFOLD_PIPELINE_CACHE_LIMIT", "much")
    wrong = project.command("run", "config.yaml")
    assert (wrong.code, wrong.err) == (
        2,
        "SCAFFOLD_PIPELINE_CACHE_LIMIT: must be a size such as 500 MB or 20 GB, got 'much'\n",
    )


def test_the_cache_is_told_and_pruned(project: Project):
    project.command("run", project.write(CHAIN), "--cache", "shared")
    size = project.command("cache", "size", "shared").out
    assert size.startswith(f"{project.folder / 'shared'}: 4 results, ")
    lines = project.command("cache", "list", "shared").out.splitlines()
    assert len(lines) == 4
    assert any("  scatter_points (version 1): " in line for line in lines)
    assert {entry["stage"] for entry in project.command("cache", "list", "shared", "--json").json} == set(LABELS)
    assert project.command("cache", "prune", "shared").out.endswith(": 0 B freed\n")
    assert project.command("cache", "prune", "shared", "--keep", "0 B").code == 0
    assert project.command("cache", "size", "shared", "--json").json["results"] == 0


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["size"], "cache: no cache is named; give its folder, or set SCAFFOLD_PIPELINE_CACHE"),
        (["list", "nowhere"], "nowhere: no such folder"),
        (["prune", ".", "--keep", "5"], "--keep: must be a size such as 500 MB or 20 GB, got '5'"),
    ],
)
def test_a_cache_that_is_not_there_is_a_line(project: Project, arguments: list[str], fault: str):
    answer = project.command("cache", *arguments)
    assert (answer.code, answer.out, len(answer.err.splitlines())) == (2, "", 1)
    assert fault in answer.err
