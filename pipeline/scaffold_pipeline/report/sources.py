"""The sources of a run's page: only files of the run directory, so that `report` can repeat the page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.report.declared import declared_of
from scaffold_pipeline.runs.store import hash_file

RECORD = "run.json"
METRICS = "metrics.json"
MEASURES = "measures.json"
"""Distributions, curves and findings."""
CONFIG = "config.yaml"
PAGE = "report.html"

_PICTURES = (".png", ".svg")


@dataclass(frozen=True)
class Sources:
    """A run's record, its measures, its config as text, and its pictures and view as bytes.

    `missing` are the names of recorded pictures that are missing or have changed.
    """

    record: Mapping[str, Any]
    metrics: Mapping[str, Fact]
    measures: Mapping[str, Any] = field(default_factory=dict)
    config: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    view: bytes | None = None
    missing: tuple[str, ...] = ()


def read_record(folder: Path) -> dict[str, Any]:
    """Return the record of the finished run in `folder`; raises `PipelineError` if there is none."""
    path = folder / RECORD
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if _is_record(record):
            return record
    except FileNotFoundError as error:
        remedy = "; name one of its points" if (folder / "study.json").is_file() else "; name the folder of a run"
        raise PipelineError(f"{path}: there is no record of a finished run{remedy}") from error
    except (ValueError, TypeError) as error:
        raise PipelineError(f"{path}: cannot be read ({error}); run the config again") from error
    raise PipelineError(f"{path}: is not the record of a run")


def read_sources(folder: Path, record: Mapping[str, Any]) -> Sources:
    """Return the sources of a run's page; `record` is that of the run in `folder`.

    Raises `PipelineError` if a file with results is not the recorded one; such a picture is left out.
    """
    files = {name: facts for name, facts in record["files"].items() if name != PAGE}
    whole = {name for name, facts in files.items() if _is_recorded(folder, name, facts)}
    for name in (METRICS, MEASURES, CONFIG):
        if name in files and name not in whole:
            raise PipelineError(f"{folder / name}: is not the file that the run wrote; run the config again")
    views = {drawing.file for drawing in declared_of(record).drawings if drawing.place == "view"}
    drawn = [name for name in files if name.endswith(_PICTURES) or name in views]
    return Sources(
        record={**record, "files": files},
        metrics=_json(folder / METRICS) if METRICS in files else {},
        measures=_json(folder / MEASURES) if MEASURES in files else {},
        config=(folder / CONFIG).read_text(encoding="utf-8") if CONFIG in files else "",
        pictures={name: (folder / name).read_bytes() for name in drawn if name in whole and name not in views},
        view=next(((folder / name).read_bytes() for name in drawn if name in views & whole), None),
        missing=tuple(name for name in drawn if name not in whole),
    )


def _is_record(content: object) -> bool:
    """Return whether the content of a file has the parts of a record."""
    parts = {"stages": list, "files": dict, "versions": dict, "platform": dict}
    if not (isinstance(content, dict) and all(isinstance(content.get(key), kind) for key, kind in parts.items())):
        return False
    files, stages = content["files"].values(), content["stages"]
    return all(isinstance(facts, dict) and "sha256" in facts for facts in files) and all(
        isinstance(stage, dict) for stage in stages
    )


def _is_recorded(folder: Path, name: str, facts: Mapping[str, Any]) -> bool:
    path = folder / name
    return Path(name).name == name and path.is_file() and hash_file(path) == facts["sha256"]


def _json(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found
