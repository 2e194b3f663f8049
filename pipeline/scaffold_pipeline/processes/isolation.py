"""Run a function in a child process, so that a crash or hang does not end the run.

On some inputs native geometry libraries crash, hang or take all memory. The child reads arrays and scalars from a file,
works in a temporary folder, and writes its result to a file; if it dies, the caller gets one `StageError`.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import MemoryShortageError, PipelineError, StageError
from scaffold_pipeline.processes.memory import available_memory

_OUT_OF_MEMORY = ("MemoryError", "bad_alloc")
"""Names of the errors of a failed allocation in Python and C++."""

Arrays = dict[str, NDArray[Any]]
Scalars = dict[str, str | int | float | bool | None]


def call_in_child(
    function: Callable[..., Arrays], arrays: Arrays, scalars: Scalars, *, seconds: float, about: str
) -> Arrays:
    """Return `function(**arrays, **scalars)`, computed in a child process within `seconds` and the free memory.

    `function` is a module's top-level function that takes arrays and scalars by keyword and returns arrays.
    Raises `StageError` if the child crashes, raises an exception, exceeds the time or lacks memory; `about` gives the
    input and the remedy for the message. Only Linux limits the memory of a child.
    """
    memory = available_memory()
    with tempfile.TemporaryDirectory(prefix="scaffold-") as name:
        folder = Path(name)
        np.savez(folder / "request.npz", allow_pickle=False, **arrays)
        request = {"module": function.__module__, "function": function.__qualname__, "memory": memory}
        (folder / "request.json").write_text(json.dumps({**request, "scalars": scalars}), encoding="utf-8")
        code = _run_child(folder, seconds, about)
        failure = folder / "error.txt"
        if failure.exists():
            raise StageError(f"{failure.read_text(encoding='utf-8')}; {about}")
        answer = folder / "answer.npz"
        if code != 0 or not answer.exists():
            kind, reason = _failure(code, folder, memory)
            raise kind(f"{request['module']} {reason}; {about}")
        with np.load(answer, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def _run_child(folder: Path, seconds: float, about: str) -> int:
    command = [sys.executable, "-m", __name__, str(folder)]
    with (folder / "output.txt").open("wb") as output:
        child = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        try:
            return child.wait(timeout=seconds)
        except subprocess.TimeoutExpired as error:
            raise StageError(f"gave no result within {seconds:.0f} s; {about}") from error
        finally:
            child.kill()
            child.wait()


def _failure(code: int, folder: Path, memory: int) -> tuple[type[StageError], str]:
    """Return the type of error for a child that died, and the reason in words."""
    lines = (folder / "output.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()
    last = lines[-1].strip()[:200] if lines else ""
    if any(sign in line for line in lines for sign in _OUT_OF_MEMORY):
        return MemoryShortageError, f"needs more than the {memory / 2**30:.1f} GiB of memory that were free ({last})"
    ended = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return StageError, f"{ended} ({last})" if last else ended


def _serve(folder: Path) -> None:
    """Run the request in `folder` and write the answer; this is the child process."""
    die_with_parent()
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    function = getattr(import_module(request["module"]), request["function"])
    _limit_memory(request["memory"])
    with np.load(folder / "request.npz", allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    try:
        answer = function(**arrays, **request["scalars"])
    except PipelineError as error:
        (folder / "error.txt").write_text(str(error), encoding="utf-8")
    else:
        np.savez(folder / "answer.npz", allow_pickle=False, **answer)


def die_with_parent() -> None:
    """Have Linux end this process when its parent is killed: native code may never return."""
    if sys.platform == "linux":
        import ctypes

        set_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)


def _limit_memory(memory: int) -> None:
    """Limit this process to `memory` bytes: a failed allocation is better than a machine that swaps."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
