"""Call a function in a child process whose crash or hang is survived.

Native geometry libraries end the process, never return or take all memory on some inputs. The child gets arrays and
scalars as a file, works in a temporary folder, and answers with a file; its death is one `StageError`.
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
"""What Python and C++ say where an allocation fails."""

Arrays = dict[str, NDArray[Any]]
Scalars = dict[str, str | int | float | bool | None]


def call_in_child(
    function: Callable[..., Arrays], arrays: Arrays, scalars: Scalars, *, seconds: float, about: str
) -> Arrays:
    """Return `function(**arrays, **scalars)`, computed in a child process within `seconds` and the free memory.

    `function` is a module's top-level function that takes arrays and scalars by keyword and returns arrays.
    `about` names the input and the remedy in the error that the child's death, an exception, the time-out or
    the want of memory becomes (`StageError`). Only Linux ends a child for its memory.
    """
    memory = available_memory()
    with tempfile.TemporaryDirectory(prefix="scaffold-") as folder:
        box = Path(folder)
        np.savez(box / "request.npz", allow_pickle=False, **arrays)
        request = {"module": function.__module__, "function": function.__qualname__, "memory": memory}
        (box / "request.json").write_text(json.dumps({**request, "scalars": scalars}), encoding="utf-8")
        code = _run_child(box, seconds, about)
        failure = box / "error.txt"
        if failure.exists():
            raise StageError(f"{failure.read_text(encoding='utf-8')}; {about}")
        answer = box / "answer.npz"
        if code != 0 or not answer.exists():
            kind, how = _death(code, box, memory)
            raise kind(f"{request['module']} {how}; {about}")
        with np.load(answer, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def _run_child(box: Path, seconds: float, about: str) -> int:
    command = [sys.executable, "-m", __name__, str(box)]
    with (box / "output.txt").open("wb") as output:
        child = subprocess.Popen(command, cwd=box, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        try:
            return child.wait(timeout=seconds)
        except subprocess.TimeoutExpired as error:
            raise StageError(f"gave no result within {seconds:.0f} s; {about}") from error
        finally:
            child.kill()
            child.wait()


def _death(code: int, box: Path, memory: int) -> tuple[type[StageError], str]:
    """Return the kind of error that the child's death is, and how it died."""
    lines = (box / "output.txt").read_text(encoding="utf-8", errors="replace").strip().splitlines()
    last = lines[-1].strip()[:200] if lines else ""
    if any(sign in line for line in lines for sign in _OUT_OF_MEMORY):
        return MemoryShortageError, f"needs more than the {memory / 2**30:.1f} GiB of memory that were free ({last})"
    ended = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return StageError, f"{ended} ({last})" if last else ended


def _serve(box: Path) -> None:
    """Do what the request in `box` asks for: the child's side."""
    die_with_parent()
    request = json.loads((box / "request.json").read_text(encoding="utf-8"))
    function = getattr(import_module(request["module"]), request["function"])
    _use_at_most(request["memory"])
    with np.load(box / "request.npz", allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    try:
        answer = function(**arrays, **request["scalars"])
    except PipelineError as error:
        (box / "error.txt").write_text(str(error), encoding="utf-8")
    else:
        np.savez(box / "answer.npz", allow_pickle=False, **answer)


def die_with_parent() -> None:
    """Have Linux end this process when its parent is killed: native code can hang on for ever."""
    if sys.platform == "linux":
        import ctypes

        set_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)


def _use_at_most(memory: int) -> None:
    """Let this process have so many bytes: an allocation that fails is better than a machine that swaps to death."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
