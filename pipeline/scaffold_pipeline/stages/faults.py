"""Messages for faults of parameters, the same for a file, `--set` and a call from Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np
from pydantic_core import ErrorDetails

from scaffold_pipeline.errors import did_you_mean
from scaffold_pipeline.stages.contract import Stage

_RULES = {"tuple_type": "must be a list", "too_short": "must have at least {min_length} item"}
"""Where pydantic speaks of Python's tuples, which YAML does not have."""


def without_consequences(details: Iterable[ErrorDetails]) -> list[ErrorDetails]:
    """Return pydantic's findings without lists that are too short only as one of their items is refused."""
    found = list(details)
    refused = {detail["loc"][:-1] for detail in found if detail["loc"]}
    return [detail for detail in found if detail["type"] != "too_short" or detail["loc"] not in refused]


def parameter_fault(detail: ErrorDetails, stage: Stage) -> str:
    """Return pydantic's error on a parameter of `stage` as: parameter, rule, value, remedy."""
    place = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "extra_forbidden":
        return unknown_parameter(place, stage)
    if detail["type"] == "missing":
        return f"{place}: is required"
    own = _RULES.get(detail["type"])
    rule = own.format(**detail.get("ctx", {})) if own else detail["msg"]
    rule = rule.removeprefix("Value error, ").replace("Input should be", "must be").replace("Input", "it")
    subject = f"{place}: {rule}" if place else rule
    return subject if detail["type"] == "value_error" else f"{subject}, got {format_value(detail['input'])}"


def unknown_parameter(place: str, stage: Stage) -> str:
    """Return the fault of a parameter that `stage` does not have, with the most similar one that it has."""
    return f"unknown parameter {place!r}{did_you_mean(place, stage.params.model_fields)}"


def with_article(kind: type) -> str:
    """Return the name of a type as a sentence has it: `an OuterShape`, `a Solid`."""
    name = kind.__name__
    return f"an {name}" if name[:1].lower() in {*"aeio"} else f"a {name}"


def format_value(value: object) -> str:
    """Return a value as text for a fault."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."  # keeps a fault on one line


def to_plain(value: object) -> Any:  # noqa: ANN401 - what YAML can hold
    """Return a Python value as YAML would have it: numpy numbers and arrays, tuples and paths become plain values.

    >>> to_plain({"counts": np.array([4, 2, 2]), "edge": np.float32(0.5), "path": PurePath("heel.stl")})
    {'counts': [4, 2, 2], 'edge': 0.5, 'path': 'heel.stl'}
    """
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {to_plain(key): to_plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(entry) for entry in value]
    return str(value) if isinstance(value, PurePath) else value
