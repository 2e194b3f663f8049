"""What the stages of a run declare of its metrics, gates and drawings: from the record, or from what is installed."""

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
"""The key of the record under which the declarations stand."""

RUN_METRICS = (
    Metric("quality", "", "Quality", "Whether all gates are passed, or those that failed.", ""),
    Metric("seconds", "s", "Time", "Of all stages, where they were run.", ""),
    Metric("peak_memory_bytes", "B", "Memory", "Of the stage that needed most.", ""),
)
"""What each run tells of itself."""


def declared_by(stages: Sequence[tuple[str, Stage]], slots: Collection[str]) -> Declared:
    """Return what stages, each with its label, declare; `slots` are those that were written.

    The metrics of measuring stages come first: others declare the facts that these hand on.
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
    """Return what the record of a run declares; of one that is older, what its stages do as they are installed."""
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
    """Return what all installed stages declare."""
    stages = [(stage.name, stage) for stage in installed_stages() if isinstance(stage, Stage)]
    return declared_by(stages, ())


def stages_that_draw(suffix: str) -> list[str]:
    """Return the installed stages that declare drawings in files of that suffix."""
    stages = (stage for stage in installed_stages() if isinstance(stage, Stage))
    return [stage.name for stage in stages if any(drawing.file.endswith(suffix) for drawing in stage.reports.drawings)]


def used_by(declared: Declared, keys: Collection[str], files: Collection[str]) -> Declared:
    """Return the declarations that some metrics and files need: what a record holds, without how they are computed."""
    metrics = [replace(metric, method="") for metric in declared.metrics if any(metric.at(key) for key in keys)]
    drawings = [drawing for drawing in declared.drawings if any(drawing.at(file) for file in files)]
    return Declared(tuple(metrics), declared.gates, tuple(drawings), declared.viewers)


def in_order(metrics: Mapping[str, Fact], declared: Declared) -> dict[str, Fact]:
    """Return metrics in the order in which they are declared; those that none declares, and the run's own, last."""
    return {key: metrics[key] for key in sorted(metrics, key=declared.rank)}


def _draws_view(stage: Stage) -> bool:
    return any(drawing.place == "view" for drawing in stage.reports.drawings)


def _viewers(slots: Collection[str]) -> Iterator[str]:
    """Yield the installed stages that would draw a 3-D view of what was written to `slots`."""
    for stage in installed_stages():
        if isinstance(stage, Stage) and _draws_view(stage) and stage.requires <= set(slots):
            yield stage.name
