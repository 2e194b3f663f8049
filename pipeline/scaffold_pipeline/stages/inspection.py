"""Measure one file outside any run: the stage `inspect_surface`, called alone."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.errors import ConfigError, Fault
from scaffold_pipeline.stages.catalogue import require_stage

_STAGE = "inspect_surface"
"""The command `inspect` is this stage, so that it is the one stage which the engine names."""


def inspect_file(path: Path, units: str | None) -> dict[str, Fact]:
    """Return the facts of the surface in `path`; raises `ConfigError` for a path or unit that cannot be."""
    stage = require_stage(_STAGE)
    try:
        params = stage.params.model_validate({"path": path, "units": units})
    except ValidationError as error:
        messages = [detail["msg"].removeprefix("Value error, ") for detail in error.errors(include_url=False)]
        raise ConfigError([Fault(0, 0, message, str(path)) for message in messages]) from error
    return stage.function(params=params).summary()
