from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import numpy as np
import psutil
import pytest

from pipeline.workplace import wait_for
from scaffold_pipeline.errors import MemoryShortageError, StageError
from scaffold_pipeline.processes.isolation import Arrays, call_in_child

WORK = """
    import os, signal, sys, time
    import numpy as np
    from scaffold_pipeline.errors import StageError

    def echo(**given):
        scalars = {name: np.array(value) for name, value in given.items() if not isinstance(value, np.ndarray)}
        return {**given, **scalars}

    def add(numbers, *, amount):
        numbers += amount
        return {"numbers": numbers}

    def crash(*, signal_name):
        os.kill(os.getpid(), getattr(signal, signal_name))

    def leave(*, code):
        print("last words", flush=True)
        os._exit(code)

    def hang(*, seconds):
        time.sleep(seconds)
        return {}

    def fail():
        raise ValueError("too flat")

    def refuse():
        raise StageError("the surface is open, 3 edges: größer")

    def chatter():
        print("x" * 10_000_000)
        return {"done": np.array(True)}

    def folder():
        open("left.txt", "w").write("left")
        return {"folder": np.array(os.getcwd())}

    def devour(*, gigabytes):
        return {"sum": np.ones(gigabytes * 2**27).sum()}

    def spell(*, path):
        open(path, "w").write(str(os.getpid()))
        time.sleep(60)
    """


@pytest.fixture
def work(install: Callable[..., None]) -> ModuleType:
    """A module that a child process can import."""
    install("work_in_child", WORK)
    import work_in_child  # type: ignore[import-not-found]

    return work_in_child  # type: ignore[no-any-return]


def call(function: Callable[..., Arrays], arrays: Arrays | None = None, **scalars: str | float | None) -> Arrays:
    return call_in_child(function, arrays or {}, scalars, seconds=30.0, about="heel.stl; raise edge_length")


def test_arrays_and_scalars_go_and_come_as_they_are(work: ModuleType):
    arrays = {
        "odd": np.array([np.nan, np.inf, -0.0]),
        "none": np.empty((0, 3), np.int32),
        "turned": np.asfortranarray(np.arange(6, dtype=np.uint8).reshape(2, 3)),
        "single": np.array(3.5, np.float32),
    }
    answer = call(work.echo, arrays, text="größer", count=3, flag=True, length=0.1)
    for name, given in arrays.items():
        assert answer[name].dtype == given.dtype
        np.testing.assert_array_equal(answer[name], given)
    assert [answer[name].item() for name in ("text", "count", "flag", "length")] == ["größer", 3, True, 0.1]


def test_a_locked_array_can_be_worked_on_by_the_child_and_stays(work: ModuleType):
    numbers = np.arange(3.0)
    numbers.setflags(write=False)
    assert call(work.add, {"numbers": numbers}, amount=1.0)["numbers"].tolist() == [1.0, 2.0, 3.0]
    assert numbers.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("name", ["SIGSEGV", "SIGABRT", "SIGKILL"])
def test_a_crash_of_native_code_is_survived(work: ModuleType, name: str):
    with pytest.raises(StageError, match=f"^work_in_child was ended by {name}.*; heel.stl; raise edge_length$"):
        call(work.crash, signal_name=name)


def test_a_silent_end_is_told_with_its_last_words(work: ModuleType):
    with pytest.raises(StageError, match=r"^work_in_child ended with exit code 3 \(last words\); heel.stl"):
        call(work.leave, code=3)
    with pytest.raises(StageError, match=r"^work_in_child ended with exit code 0 \(last words\); heel.stl"):
        call(work.leave, code=0)


def test_a_hang_ends_at_the_time_limit(work: ModuleType):
    started, before = time.monotonic(), set(psutil.Process().children())
    with pytest.raises(StageError, match=r"^gave no result within 1 s; heel.stl; raise edge_length$"):
        call_in_child(work.hang, {}, {"seconds": 60.0}, seconds=1.0, about="heel.stl; raise edge_length")
    assert time.monotonic() - started < 20.0
    assert set(psutil.Process().children()) <= before


def test_an_exception_is_one_line(work: ModuleType):
    with pytest.raises(StageError, match=r"^work_in_child ended with exit code 1 \(ValueError: too flat\); heel.stl"):
        call(work.fail)


def test_a_stage_error_keeps_its_words(work: ModuleType):
    with pytest.raises(StageError, match=r"^the surface is open, 3 edges: größer; heel.stl; raise edge_length$"):
        call(work.refuse)


def test_what_the_child_prints_disturbs_nobody(work: ModuleType, capfd: pytest.CaptureFixture[str]):
    assert call(work.chatter)["done"]
    assert capfd.readouterr() == ("", "")


def test_the_child_works_in_a_folder_that_is_removed(work: ModuleType):
    folder = Path(str(call(work.folder)["folder"]))
    assert folder != Path.cwd()
    assert not folder.exists()
    assert not Path("left.txt").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
@pytest.mark.usefixtures("work")
def test_a_child_ends_with_its_killed_parent(tmp_path: Path):
    sign = tmp_path / "pid.txt"
    code = f"""
        from scaffold_pipeline.processes.isolation import call_in_child
        import work_in_child
        call_in_child(work_in_child.spell, {{}}, {{"path": {str(sign)!r}}}, seconds=60.0, about="")
        """
    parent = subprocess.Popen([sys.executable, "-c", dedent(code)])
    wait_for(lambda: sign.exists() and sign.read_text() != "")
    child = psutil.Process(int(sign.read_text()))
    parent.kill()
    parent.wait()
    wait_for(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child for its memory")
def test_a_child_gets_no_more_memory_than_is_free(work: ModuleType, monkeypatch: pytest.MonkeyPatch):
    assert call(work.devour, gigabytes=1)["sum"] == 2**27
    monkeypatch.setattr("scaffold_pipeline.processes.isolation.available_memory", lambda: 2**30)
    with pytest.raises(MemoryShortageError, match=r"more than the 1.0 GiB of memory that were free \(.*\); heel.stl"):
        call(work.devour, gigabytes=2)
