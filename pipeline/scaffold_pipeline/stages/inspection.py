"""Measure one file without a run, by the stage `inspect_surface`, and check whether `load_surface` accepts it."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from scaffold_pipeline.artifacts import Artifact, Fact
from scaffold_pipeline.errors import ConfigError, Fault, PipelineWarning, StageError
from scaffold_pipeline.stages.catalogue import require_stage

_MEASURE, _LOAD = "inspect_surface", "load_surface"
"""The stages of the command `inspect`, the only ones that the engine names."""


class Inspection(NamedTuple):
    """The facts of a surface, and the error of a run that loads it, if there is one."""

    facts: dict[str, Fact]
    refusal: str | None


def inspect_file(path: Path, units: str | None) -> Inspection:
    """Measure the surface in `path`, and check whether a run would load it.

    Raises `ConfigError` for an invalid path or unit, `StageError` for a file that cannot be read.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        facts = _call(_MEASURE, path, units).summary()
        # A measure needs a unit: a file without one was taken as mm, and is loaded as mm.
        refusal = _refusal(path, units or ("mm" if "not in the file" in str(facts.get("unit")) else None))
    messages = [str(warning.message) for warning in caught if issubclass(warning.category, PipelineWarning)]
    if messages:
        facts["warnings"] = "; ".join(dict.fromkeys(messages))
    facts["loads"] = refusal is None
    return Inspection(facts, refusal)


def _refusal(path: Path, units: str | None) -> str | None:
    """Return the error of `load_surface` with default parameters, or None if it loads the file."""
    try:
        _call(_LOAD, path, units)
    except StageError as error:
        return f"{_LOAD}: {error}"
    return None


def _call(name: str, path: Path, units: str | None) -> Artifact:
    stage = require_stage(name)
    try:
        params = stage.params.model_validate({"path": path, "units": units})
    except ValidationError as error:
        messages = [detail["msg"].removeprefix("Value error, ") for detail in error.errors(include_url=False)]
        raise ConfigError([Fault(0, 0, message, str(path)) for message in messages]) from error
    return stage.function(params=params)
