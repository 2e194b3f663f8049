"""Measure one file outside any run: the stage `inspect_surface`, called alone, and whether `load_surface` takes it."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

from pydantic import ValidationError

from scaffold_pipeline.artifacts import Artifact, Fact
from scaffold_pipeline.errors import ConfigError, Fault, PipelineWarning, StageError
from scaffold_pipeline.stages.catalogue import require_stage

_MEASURE, _LOAD = "inspect_surface", "load_surface"
"""The command `inspect` is these two stages, so that they are the ones which the engine names."""


class Inspection(NamedTuple):
    """The facts of a surface, and the line with which a run would refuse it, if it would."""

    facts: dict[str, Fact]
    refusal: str | None


def inspect_file(path: Path, units: str | None) -> Inspection:
    """Return what is measured of the surface in `path`, and whether a run would load it.

    Raises `ConfigError` for a path or unit that cannot be, `StageError` for a file that cannot be read.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        facts = _call(_MEASURE, path, units).summary()
        # Nothing is measured in no unit: a file without one was taken as mm, and is loaded as that.
        refusal = _refusal(path, units or ("mm" if "not in the file" in str(facts.get("unit")) else None))
    said = [str(warning.message) for warning in caught if issubclass(warning.category, PipelineWarning)]
    if said:
        facts["warnings"] = "; ".join(dict.fromkeys(said))
    facts["loads"] = refusal is None
    return Inspection(facts, refusal)


def _refusal(path: Path, units: str | None) -> str | None:
    """Return the line with which `load_surface`, left as it is, refuses a file."""
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
