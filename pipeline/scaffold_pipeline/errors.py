"""Errors and warnings for users: one line for each fault, with the place, the rule, the value and the remedy."""

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
    """Base of all errors that are reported in one line instead of a traceback."""

    exit_code = 1


class StageError(PipelineError):
    """A stage has no valid result for its inputs and parameters."""


class MemoryShortageError(StageError):
    """A stage ran out of memory; with more free memory it may succeed."""


class StageDefinitionError(PipelineError):
    """A stage, possibly of a plug-in, breaks the contract of `scaffold_pipeline.stages.contract`."""


@dataclass(frozen=True, order=True)
class Fault:
    """One fault of a configuration: `line` and `column` count from 1; they are 0 if it has no place in a file."""

    line: int
    column: int
    message: str
    source: str = ""

    def __str__(self) -> str:
        place = f"{self.source}:{self.line}:{self.column}" if self.line else self.source
        return f"{place}: {self.message}" if place else self.message


class ConfigError(PipelineError):
    """A configuration that cannot run, with every fault, in the order of the file."""

    exit_code = 2

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(sorted(set(faults)))
        super().__init__("\n".join(str(fault) for fault in self.faults))


def lines_and_code(error: Exception) -> tuple[str, int]:
    """Return the lines that the command prints for an error, and its exit code."""
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
    """A warning about a result that is still valid; it is kept in the run record."""


def warn(message: str) -> None:
    """Warn the user about a result that is still valid: a `PipelineWarning` at the line of the caller."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith(_ENGINE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, PipelineWarning, stacklevel=level)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` with the known name most similar to `name`, or else the list of known names.

    >>> did_you_mean("jiter", ["jitter", "measure"])
    "; did you mean 'jitter'?"
    """
    choices = sorted(known)
    near = get_close_matches(name, choices, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(choices) or 'none'}"
