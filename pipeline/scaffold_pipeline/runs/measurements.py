"""The metrics of all measuring stages of a run, combined: numbers, gates, distributions, curves and findings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from scaffold_pipeline.artifacts import Metrics
from scaffold_pipeline.errors import StageError

_SHOWN = 5
"""Most keys that an error lists; `measure` has more than fifty."""


def merge_metrics(measured: Mapping[str, Metrics]) -> Metrics | None:
    """Return the combined metrics of all stages, by their labels, in their order; None without metrics.

    The run has gates if any stage has, and passes if no gate of any stage failed. Raises `StageError` if two stages
    have the same key, histogram or curve, or both have a thickness of the struts.
    """
    if len(measured) < 2:
        return next(iter(measured.values()), None)
    _require_distinct(measured)
    parts = measured.values()
    return Metrics(
        values={key: value for part in parts for key, value in part.values.items()},
        failed_gates=tuple(gate for part in parts for gate in part.failed_gates),
        has_gates=any(part.has_gates for part in parts),
        histograms=tuple(entry for part in parts for entry in part.histograms),
        curves=tuple(entry for part in parts for entry in part.curves),
        findings=tuple(entry for part in parts for entry in part.findings),
        strut_thickness=next((part.strut_thickness for part in parts if len(part.strut_thickness)), np.empty(0)),
    )


def _require_distinct(measured: Mapping[str, Metrics]) -> None:
    owners: dict[str, str] = {}
    for label, metrics in measured.items():
        names = list(_names(metrics))
        doubled = [name for name in names if name in owners]
        if doubled:
            others = ", ".join(dict.fromkeys(owners[name] for name in doubled))
            more = f" and {len(doubled) - _SHOWN} more" if len(doubled) > _SHOWN else ""
            raise StageError(
                f"{label}: measures {', '.join(doubled[:_SHOWN])}{more}, which {others} also measures; remove one of "
                "them, or rename the keys if the stage is yours"
            )
        owners |= dict.fromkeys(names, label)


def _names(metrics: Metrics) -> Iterator[str]:
    """Yield names that must be unique in a run: keys, histograms, curves and the thickness of the struts."""
    yield from metrics.values
    yield from (f"the histogram {entry.name}" for entry in metrics.histograms)
    yield from (f"the curve {entry.name}" for entry in metrics.curves)
    if len(metrics.strut_thickness):
        yield "the thickness of the struts"
