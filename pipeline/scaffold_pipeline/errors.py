"""Every failure a user can meet: one line a fault, with the place, the rule, the value and the remedy."""

from __future__ import annotations

import inspect
import warnings
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


_ENGINE = __name__.partition(".")[0]


class PipelineError(Exception):
    """Base of all errors that are reported as a line instead of a traceback."""

    exit_code = 1


class StageError(PipelineError):
    """A stage could not do its work on the values it was given."""


class MemoryShortageError(StageError):
    """A stage could not have the memory that it needs; with more of it free it may do its work."""


class StageDefinitionError(PipelineError):
    """A stage, ours or a plug-in's, does not keep the contract of `scaffold_pipeline.stages.contract`."""


@dataclass(frozen=True, order=True)
class Fault:
    """One fault of a configuration: `line` and `column` count from 1, 0 where there is no place in a file."""

    line: int
    column: int
    message: str
    source: str = ""

    def __str__(self) -> str:
        place = f"{self.source}:{self.line}:{self.column}" if self.line else self.source
        return f"{place}: {self.message}" if place else self.message


class ConfigError(PipelineError):
    """A configuration or a plan that cannot run; holds every fault found, in the order of the file."""

    exit_code = 2

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(sorted(set(faults)))
        super().__init__("\n".join(str(fault) for fault in self.faults))


def lines_and_code(error: Exception) -> tuple[str, int]:
    """Return the lines and the exit code that an error becomes."""
    if isinstance(error, PipelineError):
        return str(error), error.exit_code
    if isinstance(error, OSError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}", PipelineError.exit_code
    text = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {text}; --debug shows where", PipelineError.exit_code


def no_folder(path: Path, error: OSError) -> str:
    """Return what is wrong where a folder for results cannot be made."""
    return f"{path}: cannot be made a folder for results ({error.strerror}); choose another"


class PipelineWarning(UserWarning):
    """What a stage wants the user to know of a result that is still good; kept in the run record."""


def warn(message: str) -> None:
    """Tell the user something of a result that is still good, as a `PipelineWarning` of the line that called us."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith(_ENGINE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, PipelineWarning, stacklevel=level)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the known name nearest to `name`, or the list of what is known.

    >>> did_you_mean("jiter", ["jitter", "measure"])
    "; did you mean 'jitter'?"
    """
    choices = sorted(known)
    near = get_close_matches(name, choices, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(choices) or 'none'}"
