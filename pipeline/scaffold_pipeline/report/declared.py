"""The declarations of a run's metrics, gates and drawings: from its record, or from the installed stages."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from scaffold_pipeline.artifacts import Declared, Fact, Metric, Metrics
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.stages.contract import Stage
from scaffold_pipeline.stages.registry import installed_stages, load_stage

DECLARED = "declared"
"""The key of the declarations in the record."""

RUN_METRICS = (
    Metric("quality", "", "Quality", "pass, or the quality gates that failed.", ""),
    Metric("seconds", "s", "Time", "Of all stages that were run.", ""),
    Metric("peak_memory_bytes", "B", "Memory", "Of the stage that used most.", ""),
)
"""The metrics that every run has."""


def declared_by(stages: Sequence[tuple[str, Stage]], slots: Collection[str]) -> Declared:
    """Return the declarations of stages, each with its label; `slots` are those that were written.

    The metrics of measuring stages come first; other stages declare the facts that these pass on.
    """
    measuring = [stage for _, stage in stages if issubclass(stage.output, Metrics)]
    others = [stage for _, stage in stages if stage not in measuring]
    metrics = (metric for stage in (*measuring, *others) for metric in stage.reports.metrics)
    drawings = (drawing for _, stage in stages for drawing in stage.reports.drawings)
    return Declared(
        metrics=(*dict.fromkeys((*metrics, *RUN_METRICS)),),
        gates=tuple((label, gate) for label, stage in stages for gate in stage.reports.gates),
        drawings=(*dict.fromkeys(drawings),),
        viewers=() if any(_draws_view(stage) for _, stage in stages) else tuple(_viewers(slots)),
    )


def declared_of(record: Mapping[str, Any]) -> Declared:
    """Return the declarations in a run's record, or of the installed stages if an older record has none."""
    found = record.get(DECLARED)
    if found is not None:
        return Declared.from_json(found)
    entries = record.get("stages") or ()
    stages = []
    for entry in entries:
        with suppress(LookupError, StageDefinitionError):
            stages.append((str(entry.get("label")), load_stage(str(entry.get("stage")))))
    return declared_by(stages, {str(entry.get("slot")) for entry in entries})


def declared_here() -> Declared:
    """Return the declarations of all installed stages."""
    stages = [(stage.name, stage) for stage in installed_stages() if isinstance(stage, Stage)]
    return declared_by(stages, ())


def stages_that_draw(suffix: str) -> list[str]:
    """Return the installed stages that declare drawings in files with a suffix."""
    stages = (stage for stage in installed_stages() if isinstance(stage, Stage))
    return [stage.name for stage in stages if any(drawing.file.endswith(suffix) for drawing in stage.reports.drawings)]


def used_by(declared: Declared, keys: Collection[str], files: Collection[str]) -> Declared:
    """Return the declarations of some metrics and files, for a record: without the methods of the metrics."""
    metrics = [replace(metric, method="") for metric in declared.metrics if any(metric.at(key) for key in keys)]
    drawings = [drawing for drawing in declared.drawings if any(drawing.at(file) for file in files)]
    return Declared(tuple(metrics), declared.gates, tuple(drawings), declared.viewers)


def in_order(metrics: Mapping[str, Fact], declared: Declared) -> dict[str, Fact]:
    """Return metrics in the order of their declarations; undeclared ones, and the run's own, are last."""
    return {key: metrics[key] for key in sorted(metrics, key=declared.rank)}


def _draws_view(stage: Stage) -> bool:
    return any(drawing.place == "view" for drawing in stage.reports.drawings)


def _viewers(slots: Collection[str]) -> Iterator[str]:
    """Yield the installed stages that can draw a 3-D view from `slots`."""
    for stage in installed_stages():
        if isinstance(stage, Stage) and _draws_view(stage) and stage.requires <= set(slots):
            yield stage.name
