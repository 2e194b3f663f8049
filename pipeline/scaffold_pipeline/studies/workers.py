"""Worker processes on this machine for the points of a study."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import TypeVar

from scaffold_pipeline.processes.isolation import die_with_parent
from scaffold_pipeline.processes.memory import available_memory
from scaffold_pipeline.processes.threads import core_count, threads_of_children

_GRACE = 5.0
"""Seconds that an interrupted worker has to clean up before it is killed."""

_Result = TypeVar("_Result")

_is_worker = False


@dataclass(frozen=True)
class WorkerPool:
    """Workers for points: at most `size` at once, `memory` bytes in all, in executors made by `start`."""

    size: int
    memory: int
    start: Callable[[], AbstractContextManager[Executor]]


def local_pool(most: int, count: int | None = None) -> WorkerPool:
    """Return a pool of `count` processes on this machine; by default one per core, at most `most`."""
    size = max(1, count or min(core_count(), most))
    return WorkerPool(size, available_memory(), partial(local_workers, size))


def in_process() -> WorkerPool:
    """Return this process itself as the one that works on points, one after another."""
    return WorkerPool(1, available_memory(), _InProcess)


class _InProcess(Executor):
    """An executor that does what it is given at once; an interrupt ends it as it ends any other call."""

    def submit(self, fn: Callable[..., _Result], /, *args: object, **kwargs: object) -> Future[_Result]:
        future: Future[_Result] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - it is raised where the result is asked for
            future.set_exception(error)
        return future


@contextmanager
def local_workers(count: int) -> Iterator[Executor]:
    """Yield an executor of `count` processes that share the cores; an exception, such as Ctrl-C, stops their work.

    They are new interpreters, not forks: a fork would inherit compiled threads in an undefined state.
    """
    earlier = set(active_children())
    with threads_of_children(max(1, core_count() // count)):
        executor = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            _stop(set(active_children()) - earlier)
            raise
        finally:
            executor.shutdown(cancel_futures=True)


def _stop(workers: Iterable[BaseProcess]) -> None:
    for worker in workers:
        with suppress(ProcessLookupError):
            os.kill(worker.pid or 0, signal.SIGINT)
    for worker in workers:
        worker.join(_GRACE)
        worker.terminate()


def _begin() -> None:
    """Prepare a worker: it ends with its parent, and can be interrupted only while it works."""
    global _is_worker  # noqa: PLW0603 - one worker is one process
    _is_worker = True
    die_with_parent()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _exit_with_parent() -> None:
    """End this process when its parent has ended, on systems that do not do so themselves."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the first interrupt raise `KeyboardInterrupt` in a worker; no effect in any other process."""
    if not _is_worker or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the clean-up is not interrupted
    raise KeyboardInterrupt
