"""Write the results of a finished run into its directory: the files of its stages, metrics, record and page.

All files are first written to a temporary folder in the directory and then renamed, `run.json` last, as it has the hash
of every other file. Files of an earlier run that this run did not write are removed.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any

from packaging.requirements import Requirement

from scaffold_pipeline import __version__
from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.config.plan import Plan
from scaffold_pipeline.config.yaml_source import to_yaml
from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.processes.threads import thread_count
from scaffold_pipeline.report.declared import DECLARED, declared_by, in_order, used_by
from scaffold_pipeline.report.page import render_page
from scaffold_pipeline.report.sources import CONFIG, MEASURES, METRICS, PAGE, RECORD, read_record, read_sources
from scaffold_pipeline.runs.records import config_hash
from scaffold_pipeline.runs.runner import STORE, RunResult, locked
from scaffold_pipeline.runs.store import Store, hash_file
from scaffold_pipeline.stages.registry import stage_owners

_STAGING = ".publish-"


def publish(plan: Plan, result: RunResult, out: Path) -> dict[str, Any]:
    """Write all files of a complete run into `out` and return its record."""
    store = Store(out / STORE)
    with locked(out), _staging(out) as folder:
        staging = Path(folder)
        for name, digest in result.files.items():
            store.copy_file(digest, staging / name)
        declared = declared_by([(step.label, step.stage) for step in plan.steps], {step.slot for step in plan.steps})
        metrics = in_order(run_metrics(result), declared)
        _write_json(staging / METRICS, metrics)
        details = result.metrics.details() if result.metrics else {}
        if any(details.values()):
            _write_json(staging / MEASURES, details)
        (staging / CONFIG).write_text(to_yaml(plan.resolved()), encoding="utf-8")
        record = _record(plan, result, staging)
        record[DECLARED] = used_by(declared, metrics, record["files"]).to_json()
        _write_page(staging, record)
        _write_json(staging / RECORD, record)
        _replace(out, staging, record)
    return record


def publish_page(folder: Path) -> Path:
    """Write the page of the finished run in `folder` again, from its record and files alone, and return its path.

    If its hash differs from the recorded one, as with another version of this package, the record is updated. Raises
    `PipelineError` for a folder without a valid record, and if a file with results has changed.
    """
    record = read_record(folder)
    with locked(folder), _staging(folder) as name:
        earlier = record["files"].get(PAGE)
        staging = Path(name)
        (staging / PAGE).write_text(_page_of(folder, record), encoding="utf-8")
        record["files"][PAGE] = _file_facts(staging / PAGE)
        _write_json(staging / RECORD, record)
        (staging / PAGE).replace(folder / PAGE)
        if record["files"][PAGE] != earlier:
            (staging / RECORD).replace(folder / RECORD)
    return folder / PAGE


def _page_of(folder: Path, record: Mapping[str, Any]) -> str:
    """Return the page of a run; raises `PipelineError` for an invalid record."""
    try:
        return render_page(read_sources(folder, record))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        place = folder / RECORD
        raise PipelineError(f"{place}: no page can be made of it ({error}); run the config again") from error


def _write_page(staging: Path, record: dict[str, Any]) -> None:
    """Write the page of staged files, from the record after a round trip through JSON, and add it to the record."""
    as_read = json.loads(json.dumps(record))
    (staging / PAGE).write_text(render_page(read_sources(staging, as_read)), encoding="utf-8")
    record["files"][PAGE] = _file_facts(staging / PAGE)


def _staging(out: Path) -> TemporaryDirectory[str]:
    """Return a new temporary folder in `out`, after removing those of killed runs."""
    for leftover in out.glob(f"{_STAGING}*"):
        rmtree(leftover, ignore_errors=True)
    return TemporaryDirectory(dir=out, prefix=_STAGING)


def run_metrics(result: RunResult) -> dict[str, Fact]:
    """Return the flat metrics of a run: measured values, time and memory."""
    measured = result.metrics.summary() if result.metrics else {"quality": "not measured"}
    peak = max(step.peak_memory_bytes for step in result.steps)
    seconds = round(sum(step.seconds for step in result.steps), 3)
    return {**measured, "seconds": seconds, "peak_memory_bytes": peak}


def _record(plan: Plan, result: RunResult, staging: Path) -> dict[str, Any]:
    warnings = [*result.warnings, *(f"{step.label}: {message}" for step in result.steps for message in step.warnings)]
    metrics = run_metrics(result)
    return {
        "name": plan.name,
        "seed": plan.seed,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "quality": metrics["quality"],
        "seconds": metrics["seconds"],
        "peak_memory_bytes": metrics["peak_memory_bytes"],
        "config": plan.resolved(),
        "config_sha256": config_hash(plan),
        "stages": [asdict(step) for step in result.steps],
        "warnings": warnings,
        "files": {path.name: _file_facts(path) for path in sorted(staging.iterdir())},
        **environment([step.stage for step in result.steps]),
    }


def environment(stages: Collection[str] = ()) -> dict[str, Any]:
    """Return what may affect results besides their inputs: versions, also those of `stages`, and the machine."""
    return {
        "versions": {**library_versions(), **stage_owners(stages)},
        "platform": {
            "system": platform.platform(),
            "machine": platform.machine(),
            "python": platform.python_version(),
            "cores": os.cpu_count(),
            "threads": thread_count(),
        },
    }


def library_versions() -> dict[str, str]:
    """Return the versions of this package and of all packages that it requires."""
    names = [Requirement(text).name for text in requires("scaffold-pipeline") or [] if "extra ==" not in text]
    found = {"scaffold-pipeline": __version__}
    for name in sorted(names):
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _file_facts(path: Path) -> dict[str, Fact]:
    return {"sha256": hash_file(path), "bytes": path.stat().st_size}


def _write_json(path: Path, value: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _replace(out: Path, staging: Path, record: Mapping[str, Any]) -> None:
    """Move the staged files to `out`, the record last, and remove files that only an earlier record names."""
    stale = _recorded_files(out) - set(record["files"])
    for name in record["files"]:
        (staging / name).replace(out / name)
    for name in stale:
        (out / name).unlink(missing_ok=True)
    (staging / RECORD).replace(out / RECORD)


def _recorded_files(out: Path) -> set[str]:
    """Return the names of the files in the record of `out`; none without a valid record."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        earlier = json.loads((out / RECORD).read_text(encoding="utf-8"))["files"]
        return {name for name in earlier if Path(name).name == name and (out / name).is_file()}
    return set()
