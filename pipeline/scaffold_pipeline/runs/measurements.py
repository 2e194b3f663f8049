"""What all measuring stages of a run found, as one: their numbers, gates, distributions, curves and places."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from scaffold_pipeline.artifacts import Metrics
from scaffold_pipeline.errors import StageError

_SHOWN = 5
"""Keys that a fault names: enough to see what doubles; `measure` has more than fifty."""


def merge_metrics(measured: Mapping[str, Metrics]) -> Metrics | None:
    """Return the metrics of all stages, by their labels, as one, in their order; None where nothing was measured.

    The run has passed where no gate of any stage failed, and was judged where one of them judged. Raises `StageError`
    where two stages give the same key, or a histogram, a curve or the struts' thickness of the same name.
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
                f"{label}: measures {', '.join(doubled[:_SHOWN])}{more}, which {others} has measured too; leave one of "
                "them out, or give their keys other names where they are your own"
            )
        owners |= dict.fromkeys(names, label)


def _names(metrics: Metrics) -> Iterator[str]:
    """Yield what may be there once in a run: the keys, and what pages find by its name."""
    yield from metrics.values
    yield from (f"the histogram {entry.name}" for entry in metrics.histograms)
    yield from (f"the curve {entry.name}" for entry in metrics.curves)
    if len(metrics.strut_thickness):
        yield "the thickness of the struts"
