"""The compiler of kernels and its flags; no other module names them.

`@kernel` compiles a function of arrays and scalars; `@parallel_kernel` also runs its `prange` on all threads:

    @kernel
    def square(x: float) -> float: ...

    @parallel_kernel(fastmath=frozenset({"contract"}))
    def squares(xs: Floats) -> Floats: ...

Both keep the type of the function, release the GIL, store the machine code on disk and divide as numpy does (1/0 is
inf). `fastmath` is True for all of LLVM's fast-math flags, or a set of some: "contract", "afn", "arcp", "nsz",
"reassoc", "nnan", "ninf". With `NUMBA_DISABLE_JIT=1` both return the plain function.
"""

from __future__ import annotations

import ast
import sys
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

from scaffold_pipeline.stages.libraries import imports_in

__all__ = ["kernel", "parallel_kernel", "prange", "spread"]


def _use_widest_vectors() -> None:
    """Let LLVM use 512-bit vectors if the processor has them: its default of 256 bits is half as fast."""
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

    `inline` inserts its code into every caller, so that a loop over a formula can be vectorised. By default LLVM
    inlines only the smallest functions; for the distance to a segment that is four times slower.
    """
    return _compile(function, fastmath=fastmath, forceinline=inline)


@overload
def parallel_kernel(function: Kernel, /) -> Kernel: ...


@overload
def parallel_kernel(*, fastmath: Fastmath = False) -> Callable[[Kernel], Kernel]: ...


def parallel_kernel(function: Kernel | None = None, /, *, fastmath: Fastmath = False) -> Any:
    """Compile a function whose `prange` loops run on all threads."""
    return _compile(function, fastmath=fastmath, parallel=True)


def _compile(function: Kernel | None, *, fastmath: Fastmath, **flags: bool) -> Any:  # noqa: ANN401
    liberties = set(fastmath) if isinstance(fastmath, frozenset) else fastmath

    def compiled(plain: Kernel) -> Any:  # noqa: ANN401
        options = {"nogil": True, "error_model": "numpy", "fastmath": liberties, **flags}
        user_folder = numba.config.CACHE_DIR
        state = _sources_digest(plain.__module__)
        numba.config.CACHE_DIR = str(Path(user_folder or Path(__file__).with_name("__pycache__"), state))
        try:
            return numba.njit(cache=True, **options)(plain)
        except RuntimeError:  # neither this folder nor the user's own can be written: compile at each start
            return numba.njit(**options)(plain)
        finally:
            numba.config.CACHE_DIR = user_folder

    return compiled if function is None else compiled(function)


def spread(work: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pieces of work (n,) in strided order, so that equal shares of all threads take equal time."""
    return work[np.argsort(np.arange(len(work)) % _STRIDE, kind="stable")]


def _sources_digest(module: str) -> str:
    """Return a hash of the sources that the machine code of the kernels in `module` depends on.

    numba checks only the file of a compiled function: after a change of a formula in `segment_distances.py` it would
    use the old machine code of callers in other files, with the old formula. So each state of a module and of its
    imports from its own package and from this one, followed recursively, has its own folder.
    """
    digest = sha256()
    for name in sorted(_sources_of(module)):
        digest.update(f"{name} {len(_source(name))}\n".encode() + _source(name))
    return "kernels-" + digest.hexdigest()[:16]


def _sources_of(module: str) -> set[str]:
    packages = {name.partition(".")[0] for name in (module, __name__)}
    found: set[str] = set()
    todo = {module, __name__}
    while todo:
        name = todo.pop()
        found.add(name)
        todo |= {other for other in _imports(name) if other.partition(".")[0] in packages} - found
    return found


@cache
def _imports(module: str) -> frozenset[str]:
    """Return the modules that `module` imports as it is loaded, not inside a function."""
    package = sys.modules[module].__package__ or ""
    pairs = imports_in(ast.parse(_source(module)).body, package)
    return frozenset(name for base, inner in pairs for name in (base, f"{base}.{inner}") if name in sys.modules)


def _source(module: str) -> bytes:
    """Return the source of a module; empty if it has no file, as in a notebook."""
    file = getattr(sys.modules[module], "__file__", None)
    return Path(file).read_bytes() if file else b""
