"""The results of a study: `table.csv`, one row per point, and `study.json`, the record needed to repeat it."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.sources import METRICS, RECORD
from scaffold_pipeline.runs.store import write_atomically

TABLE = "table.csv"
STUDY_RECORD = "study.json"

FAILURE = "failure.json"
"""File in a point's folder with the error of a configuration and its hash."""

_OF_A_RECORD = ("seed", "finished", "seconds", "peak_memory_bytes", "config", "config_sha256", "warnings", "files")


@dataclass(frozen=True)
class PointState:
    """The state of a point's folder: `status` is done, failed or waiting; if done, it has part of the run's record."""

    name: str
    varied: Mapping[str, object]
    status: str
    error: str | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Fact] = field(default_factory=dict)

    @property
    def gates(self) -> list[str]:
        """The quality gates that failed."""
        quality = self.metrics.get("quality", [])
        return [str(gate) for gate in quality] if isinstance(quality, list) else []

    @property
    def seconds(self) -> tuple[float, float]:
        """Seconds of the stages that were run for this point, and of those whose results were reused."""
        stages = self.record.get("stages", {}).values()
        run = sum(stage["seconds"] for stage in stages if not stage["reused"])
        return run, sum(stage["seconds"] for stage in stages if stage["reused"])


def read_state(name: str, varied: Mapping[str, object], folder: Path, config_sha256: str) -> PointState:
    """Return the state of the point's folder for the configuration with that hash."""
    record = read_json(folder / RECORD)
    if record.get("config_sha256") == config_sha256 and _has_files(folder, record):
        return PointState(name, varied, "done", None, _record_payload(record), read_json(folder / METRICS))
    failure = read_json(folder / FAILURE)
    if failure.get("config_sha256") == config_sha256:
        return PointState(name, varied, "failed", str(failure.get("error")))
    return PointState(name, varied, "waiting")


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file; an empty one if there is none."""
    with suppress(OSError, ValueError):
        value = json.loads(path.read_text(encoding="utf-8"))
        return value if isinstance(value, dict) else {}
    return {}


def write_json(path: Path, value: object) -> None:
    """Write a JSON file atomically."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def write_results(out: Path, columns: Sequence[str], states: Iterable[PointState], facts: Mapping[str, Any]) -> None:
    """Write the table and the record, which begins with `facts`, into the study's folder."""
    states = list(states)
    text = _csv(columns, states)
    write_atomically(out / TABLE, lambda stream: stream.write(text.encode()))
    write_json(out / STUDY_RECORD, {**facts, "points": [_state_payload(state) for state in states]})


def to_table(columns: Sequence[str], states: Sequence[PointState]) -> tuple[list[str], list[list[object]]]:
    """Return the titles and rows of the table: point, varied parameters, all metrics, verdict and error."""
    metrics = [key for key in dict.fromkeys(key for state in states for key in state.metrics) if key != "quality"]
    rows: list[list[object]] = []
    for state in states:
        varied = [state.varied.get(column) for column in columns]
        measured = [state.metrics.get(key) for key in (*metrics, "quality")]
        rows.append([state.name, *varied, *measured, state.error if state.status != "waiting" else "not run"])
    return ["point", *columns, *metrics, "quality", "error"], rows


def _csv(columns: Sequence[str], states: Sequence[PointState]) -> str:
    titles, rows = to_table(columns, states)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(titles)
    writer.writerows([to_cell(value) for value in row] for row in rows)
    return stream.getvalue()


def to_cell(value: object) -> str:
    """Return a value as text for a table cell: None is empty, a list of texts is joined, all else is as in JSON."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list) and all(isinstance(entry, str) for entry in value):
        return "; ".join(value)
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict) else str(value)


def _state_payload(state: PointState) -> dict[str, Any]:
    ends = {"status": state.status, "error": state.error, "quality": state.metrics.get("quality")}
    return {"name": state.name, "varied": dict(state.varied), **ends, **state.record}


def _record_payload(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a point's record that `study.json` has."""
    facts = ("key", "output", "seconds", "reused")
    stages = {stage["label"]: {fact: stage[fact] for fact in facts} for stage in record["stages"]}
    kept = {key: record[key] for key in _OF_A_RECORD}
    return {**kept, "threads": record["platform"]["threads"], "stages": stages}


def _has_files(folder: Path, record: Mapping[str, Any]) -> bool:
    """Return whether all files of a record exist and have the recorded sizes."""
    with suppress(OSError, KeyError, TypeError, AttributeError):
        return all((folder / name).stat().st_size == facts["bytes"] for name, facts in record["files"].items())
    return False
