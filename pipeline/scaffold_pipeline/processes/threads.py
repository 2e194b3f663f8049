"""How many cores there are for this process, and how many threads its compiled code may use."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What compiled libraries ask when they are loaded, so that only processes started later follow a change."""

_BLAS_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_one_blas_thread() -> None:
    """Have BLAS, where it is not loaded yet, use one thread here and in children: its last digits depend on how many.

    With two threads the exact field had other weights than with one.
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
    """Return the number of threads that compiled code shall use: `OMP_NUM_THREADS`, or one a core."""
    given = os.environ.get(THREAD_VARIABLES[0], "")
    return int(given) if given.isdecimal() and int(given) > 0 else core_count()


@contextmanager
def threads_of_children(count: int) -> Iterator[None]:
    """Have the processes that are started, and the libraries that are loaded, in a `with` block use `count` threads."""
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
