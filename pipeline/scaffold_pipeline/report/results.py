"""The results for people: each metric with its declared title and unit, under its heading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from scaffold_pipeline.artifacts import Declared, Fact, Metric
from scaffold_pipeline.report.rendering import Cell
from scaffold_pipeline.report.wording import to_text


class Line(NamedTuple):
    """A metric: its name, its value with its unit, and what it means."""

    title: str
    value: str
    meaning: str


class Group(NamedTuple):
    """The metrics under a heading."""

    title: str
    lines: list[Line]


def headline(metrics: Mapping[str, Fact], declared: Declared) -> list[Line]:
    """Return the metrics for the top of the page."""
    return [
        _line(metric, metrics) for metric in declared.shown_in("headline", metrics) if metrics[metric.key] is not None
    ]


def group_results(metrics: Mapping[str, Fact], declared: Declared) -> list[Group]:
    """Return the metrics by heading; those that are None or deprecated are left out."""
    groups: dict[str, list[Line]] = {}
    for key in sorted(current_keys(metrics, declared), key=declared.rank):
        metric = declared.metric(key)
        if metric and metric.section and metrics[key] is not None:
            groups.setdefault(metric.section, []).append(_line(metric, metrics))
    return [Group(title, lines) for title, lines in groups.items()]


def list_metrics(metrics: Mapping[str, Fact], declared: Declared) -> list[tuple[str, str | Cell]]:
    """Return all metrics except deprecated ones, in the order of the declarations."""
    keys = sorted(current_keys(metrics, declared), key=declared.rank)
    return [(key, to_cell(metrics[key])) for key in keys]


def current_keys(facts: Mapping[str, Any], declared: Declared) -> Iterator[str]:
    """Yield the keys of facts, without deprecated ones whose replacement exists; older runs have only the old keys."""
    for key in facts:
        metric = declared.metric(key)
        if metric is None or metric.instead not in facts:
            yield key


def to_cell(value: Fact) -> str | Cell:
    """Return a value as a cell of a table that sorts by number."""
    text = to_text(value)
    return Cell(text, float(value)) if isinstance(value, int | float) and not isinstance(value, bool) else text


def _line(metric: Metric, metrics: Mapping[str, Fact]) -> Line:
    value = to_text(metrics[metric.key])
    return Line(metric.title, f"{value}\u202f{metric.unit}" if metric.unit else value, metric.meaning)
