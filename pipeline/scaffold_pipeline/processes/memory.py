"""Peak memory of a block of code, and the free memory of the machine."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Self

import psutil

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_INTERVAL = 0.2


def available_memory() -> int:
    """Return the free memory, bytes, that can be used without swapping."""
    return int(psutil.virtual_memory().available)


class PeakMemory:
    """Measure the greatest resident memory, bytes, of this process and its children inside a `with` block.

    A thread samples both five times a second. A child counts from its second sample on: until it has started its own
    program it shows its parent's memory, which would count twice. Linux's high-water mark of this process is read too:
    while native code holds the interpreter's lock, the thread takes no samples.
    """

    def __init__(self) -> None:
        self.peak = 0
        self._has_mark = False
        self._stop = Event()
        self._thread = Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Self:
        _release_freed_memory()
        with suppress(OSError):
            _CLEAR.write_text("5")  # proc(5): resets VmHWM
            self._has_mark = True
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()
        if self._has_mark:  # otherwise the mark includes everything before this block
            self.peak = max(self.peak, _high_water_mark())

    def _sample(self) -> None:
        process = psutil.Process()
        known: set[psutil.Process] = set()
        while True:
            children = set(_children(process))
            self.peak = max(self.peak, sum(map(_resident, [process, *(children & known)])))
            known = children
            if self._stop.wait(_INTERVAL):
                return


def _release_freed_memory() -> None:
    """Return freed memory to the system: glibc keeps it for the process, over a GB after a large run."""
    with suppress(AttributeError, OSError, TypeError):  # not glibc, or not Linux
        ctypes.CDLL(None).malloc_trim(0)


def _resident(process: psutil.Process) -> int:
    with suppress(psutil.Error):
        return int(process.memory_info().rss)
    return 0


def _children(process: psutil.Process) -> list[psutil.Process]:
    with suppress(psutil.Error):
        return process.children(recursive=True)
    return []


def _high_water_mark() -> int:
    """Return the greatest resident memory of this process since the mark was reset, bytes; 0 if the system has none."""
    with suppress(OSError, StopIteration, ValueError):
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    return 0
