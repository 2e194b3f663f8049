"""Number of cores for this process, and number of threads for its compiled code."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Compiled libraries read them when they are loaded, so a change has effect only in processes started later."""

_BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_one_blas_thread() -> None:
    """Make BLAS, if it is not loaded yet, use one thread here and in child processes.

    The last digits of its results depend on the number of threads: with two, the exact field had different weights.
    """
    os.environ.update(dict.fromkeys(_BLAS_VARIABLES, "1"))


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
    earlier = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(count)))
    try:
        yield
    finally:
        for name, value in earlier.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
