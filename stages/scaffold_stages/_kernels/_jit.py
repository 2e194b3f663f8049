"""The one place that names a compiler and its flags.

`@kernel` compiles a function of arrays and scalars; `@parallel_kernel` also runs its `prange` on all threads:

    @kernel
    def square(x: float) -> float: ...

    @parallel_kernel(fastmath=frozenset({"contract"}))
    def squares(xs: Floats) -> Floats: ...

Both keep the type of what they decorate, release the GIL, keep the machine code on disk and divide as numpy
does (1/0 is inf). `fastmath` is True for every liberty, or the names of LLVM's that are meant: "contract",
"afn", "arcp", "nsz", "reassoc", "nnan", "ninf". With `NUMBA_DISABLE_JIT=1` both return the plain function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
import numpy as np
from llvmlite import binding as llvm
from numba import prange
from numpy.typing import NDArray

__all__ = ["kernel", "parallel_kernel", "prange", "spread"]


def _use_widest_vectors() -> None:
    """Let LLVM use vectors of 512 bits where the processor has them: by itself it takes 256, and half the speed."""
    features = llvm.get_host_cpu_features()
    if features.get("avx512f") and numba.config.CPU_FEATURES is None:
        features["prefer-256-bit"] = False
        numba.config.CPU_FEATURES = features.flatten()


_use_widest_vectors()

_STRIDE = 64

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
Fastmath = bool | frozenset[str]


@overload
def kernel(function: Kernel, /) -> Kernel: ...


@overload
def kernel(*, fastmath: Fastmath = False, inline: bool = False) -> Callable[[Kernel], Kernel]: ...


def kernel(function: Kernel | None = None, /, *, fastmath: Fastmath = False, inline: bool = False) -> Any:
    """Compile a function to run on one thread.

    `inline` puts its code into every caller's: what a formula in a loop needs for the loop to become a vector's.
    LLVM left to itself calls all but the smallest; for the distance to a segment that cost a factor of four.
    """
    return _compiled(function, fastmath=fastmath, forceinline=inline)


@overload
def parallel_kernel(function: Kernel, /) -> Kernel: ...


@overload
def parallel_kernel(*, fastmath: Fastmath = False) -> Callable[[Kernel], Kernel]: ...


def parallel_kernel(function: Kernel | None = None, /, *, fastmath: Fastmath = False) -> Any:
    """Compile a function whose `prange` loops run on all threads."""
    return _compiled(function, fastmath=fastmath, parallel=True)


def _compiled(function: Kernel | None, *, fastmath: Fastmath, **flags: bool) -> Any:  # noqa: ANN401
    liberties = set(fastmath) if isinstance(fastmath, frozenset) else fastmath

    def compiled(plain: Kernel) -> Any:  # noqa: ANN401
        options = {"nogil": True, "error_model": "numpy", "fastmath": liberties, **flags}
        user_folder = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(Path(user_folder or Path(__file__).with_name("__pycache__"), _sources_digest()))
        try:
            return numba.njit(cache=True, **options)(plain)
        except RuntimeError:  # neither this folder nor the user's own can be written: compile at each start
            return numba.njit(**options)(plain)
        finally:
            numba.config.CACHE_DIR = user_folder

    return compiled if function is None else compiled(function)


def spread(work: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pieces of work (n,) in a stride, so that the equal shares of all threads take equal time."""
    return work[np.argsort(np.arange(len(work)) % _STRIDE, kind="stable")]


@cache
def _sources_digest() -> str:
    """Return a name for the kernels' sources as they are now.

    numba looks only at the file of the function it keeps: after a change of a formula in `distances.py` it
    would go on using the machine code of callers in other files, with the old formula within. So each state
    of the sources has a folder of its own.
    """
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return "kernels-" + sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
