from __future__ import annotations

import ctypes
import mmap
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from scaffold_pipeline.processes import memory
from scaffold_pipeline.processes.memory import PeakMemory, available_memory

MIB = 2**20


def resident() -> int:
    return int(psutil.Process().memory_info().rss)


def hold() -> mmap.mmap:
    """Return 200 MiB that the system gives anew, whatever freed memory earlier tests have left to the process."""
    block = mmap.mmap(-1, 200 * MIB)
    np.frombuffer(block, np.uint8)[:] = 1
    return block


def test_the_peak_is_what_was_held_in_between_though_it_is_freed_again():
    before = resident()
    with PeakMemory() as peak:
        block = hold()
        time.sleep(0.5)
        del block
    assert before + 190 * MIB < peak.peak < before + 300 * MIB


def test_a_peak_shorter_than_the_sampling_is_seen_where_the_system_marks_it():
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("only Linux marks the greatest memory of a process")
    before = resident()
    with PeakMemory() as peak:
        hold()
    assert before + 190 * MIB < peak.peak < before + 300 * MIB


def test_an_earlier_peak_is_not_counted_again():
    with PeakMemory() as first:
        hold()
        time.sleep(0.3)
    with PeakMemory() as second:
        time.sleep(0.01)
    assert second.peak < first.peak - 150 * MIB


def test_an_earlier_peak_is_not_counted_where_the_mark_cannot_be_reset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    status = tmp_path / "status"
    status.write_text("Name:\tpython\nVmHWM:\t 99999999 kB\n")
    monkeypatch.setattr(memory, "_STATUS", status)
    monkeypatch.setattr(memory, "_CLEAR", tmp_path / "no" / "clear_refs")
    with PeakMemory() as peak:
        time.sleep(0.01)
    assert peak.peak < 20_000 * MIB
    monkeypatch.setattr(memory, "_CLEAR", tmp_path / "clear_refs")
    with PeakMemory() as marked:
        time.sleep(0.01)
    assert marked.peak == 99999999 * 1024


def test_freed_memory_that_the_process_keeps_is_not_counted():
    if not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("only glibc gives freed memory back when it is asked to")
    blocks = [np.ones(10_000) for _ in range(4000)]  # 320 MB, each too small to have pages of its own
    last = blocks.pop()
    held = resident()
    blocks.clear()
    assert resident() > held - 20 * MIB
    with PeakMemory() as peak:
        time.sleep(0.01)
    assert last.sum() == 10_000
    assert peak.peak < held - 200 * MIB


def test_memory_of_child_processes_counts():
    program = f"import time; block = bytearray(b'x') * {200 * MIB}; print('ready', flush=True); time.sleep(60)"
    before = resident()
    with PeakMemory() as peak:
        child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        assert child.stdout is not None
        child.stdout.readline()
        time.sleep(0.5)
        child.kill()
        child.wait()
        child.stdout.close()
    assert before + 200 * MIB < peak.peak < before + 300 * MIB


def test_a_child_that_has_not_yet_started_its_program_does_not_count_its_parents_memory_again(
    monkeypatch: pytest.MonkeyPatch,
):
    ballast = hold()
    seen = iter([[psutil.Process()]])  # between fork and exec a child has the very pages of its parent
    monkeypatch.setattr(memory, "_children", lambda _: next(seen, []))
    before = resident()
    with PeakMemory() as peak:
        time.sleep(0.5)
    assert before - MIB < peak.peak < before + len(ballast) / 2


def test_the_peak_is_told_when_the_work_fails():
    peak = PeakMemory()
    with pytest.raises(ValueError, match="no"), peak:
        raise ValueError("no")
    assert peak.peak > MIB


def test_available_memory_is_a_share_of_the_whole():
    assert 0 < available_memory() <= psutil.virtual_memory().total
