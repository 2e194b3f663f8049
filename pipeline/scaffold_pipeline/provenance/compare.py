"""Comparison of two runs: their configs, inputs, metrics, artifacts, files and versions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scaffold_pipeline.errors import ConfigError, Fault
from scaffold_pipeline.report.sources import METRICS, RECORD
from scaffold_pipeline.report.wording import NOTHING
from scaffold_pipeline.runs.runner import OWN_FILES
from scaffold_pipeline.studies.table import read_json, to_cell

_HASH = re.compile("[0-9a-f]{64}")

_OF_THE_MACHINE = frozenset({"seconds", "peak_memory_bytes"})
"""Metrics that differ between runs of one config."""


@dataclass(frozen=True)
class Line:
    """A named value in run `a` and in run `b`; None where a run has none."""

    name: str
    a: object
    b: object

    @property
    def is_equal(self) -> bool:
        """Whether the two values are equal."""
        return self.a == self.b


def compare_runs(first: Path, second: Path, *, show_all: bool = False) -> dict[str, list[Line]]:
    """Return, section by section, the values in which the runs in two folders differ, or all values if `show_all`.

    Raises `ConfigError` for a folder without the record of a finished run.
    """
    sides = [_sections(folder) for folder in (first, second)]
    return {
        section: [line for line in _lines(sides[0][section], sides[1][section]) if show_all or not line.is_equal]
        for section in sides[0]
    }


def to_lines(compared: Mapping[str, list[Line]]) -> list[str]:
    """Return a comparison as text: for each section the name of each value and both values, hashes shortened."""
    text = []
    for section, lines in compared.items():
        text.append(f"{section}:" if lines else f"{section}: no difference")
        text += [f"  {line.name}: {_value_text(line.a)} | {_value_text(line.b)}" for line in lines]
    return text


def _value_text(value: object) -> str:
    text = to_cell(value)
    return text[:12] if _HASH.fullmatch(text) else text or NOTHING


def _lines(a: Mapping[str, object], b: Mapping[str, object]) -> Iterator[Line]:
    for name in dict.fromkeys((*a, *b)):
        yield Line(name, a.get(name), b.get(name))


def _sections(folder: Path) -> dict[str, dict[str, object]]:
    record, metrics = read_json(folder / RECORD), read_json(folder / METRICS)
    try:
        stages = record["stages"]
        return {
            "config": _config(record),
            "inputs": {
                f"{stage['label']}.{name}": sha for stage in stages for name, sha in stage["input_files"].items()
            },
            "metrics": {name: value for name, value in metrics.items() if name not in _OF_THE_MACHINE},
            "artifacts": {stage["label"]: stage["output"] for stage in stages},
            "files": {name: facts["sha256"] for name, facts in record["files"].items() if name not in OWN_FILES},
            "versions": {**record["versions"], **record["platform"]},
        }
    except (KeyError, TypeError, AttributeError) as error:
        rule = f"contains no {RECORD} of a finished run; give the directory of a run"
        raise ConfigError([Fault(0, 0, rule, str(folder))]) from error


def _config(record: Mapping[str, Any]) -> dict[str, object]:
    """Return the seed, the order of the stages and all their parameters, named as for `--set`."""
    values: dict[str, object] = {
        "seed": record["seed"],
        "stages": [stage["label"] for stage in record["stages"]],
    }
    for stage in record["stages"]:
        parameters = {"use": stage["stage"], **stage["parameters"]}
        values |= {f"{stage['label']}.{name}": value for name, value in parameters.items()}
    return values
