"""Number of cores for this process, and number of threads for its compiled code."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Compiled libraries read them when they are loaded, so a change has effect only in processes started later."""

_BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_one_blas_thread() -> None:
    """Make BLAS, if it is not loaded yet, use one thread here and in child processes.

    The last digits of its results depend on the number of threads: with two, the exact field had different weights.
    """
    os.environ.update(dict.fromkeys(_BLAS_VARIABLES, "1"))


_COMPUTING = threading.RLock()


@contextmanager
def computing() -> Iterator[None]:
    """Compute with one BLAS thread in a `with` block, in a process of the user's own, and let one thread in at a time.

    The number of BLAS threads, and what is done with warnings, are those of the whole process. A BLAS that is loaded
    in the block keeps its one thread.
    """
    from threadpoolctl import threadpool_limits

    with _COMPUTING, _environment(dict.fromkeys(_BLAS_VARIABLES, "1")), threadpool_limits(1, user_api="blas"):
        yield


def core_count() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """Return the number of threads for compiled code: `OMP_NUM_THREADS`, or one per core."""
    given = os.environ.get(THREAD_VARIABLES[0], "")
    return int(given) if given.isdecimal() and int(given) > 0 else core_count()


@contextmanager
def threads_of_children(count: int) -> Iterator[None]:
    """Make processes started, and libraries loaded, inside a `with` block use `count` threads."""
    with _environment(dict.fromkeys(THREAD_VARIABLES, str(count))):
        yield


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    earlier = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in earlier.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
