"""The results as people read them: each metric as its stage declares it, under the heading that it names."""

from __future__ import annotations

from collections.abc import Mapping

from scaffold_pipeline.artifacts import Declared, Fact, Metric
from scaffold_pipeline.report.markup import Number, folded, table, text_of


def highlights(metrics: Mapping[str, Fact], declared: Declared) -> str:
    """Return the metrics that tell most in large type."""
    known = [metric for metric in declared.shown_in("headline", metrics) if metrics[metric.key] is not None]
    cards = "".join(
        f"<div><dt>{text_of(metric.title)}</dt><dd>{value_of(metric, metrics)}</dd></div>" for metric in known
    )
    return f'<dl class="highlights">{cards}</dl>' if cards else ""


def results(metrics: Mapping[str, Fact], declared: Declared) -> str:
    """Return the tables of what was measured, and all of `metrics.json` folded."""
    named = {key: declared.metric(key) for key in sorted(metrics, key=declared.rank)}
    known = [metric for metric in named.values() if metric and not metric.instead]
    parts = []
    for section in dict.fromkeys(metric.section for metric in known if metric.section):
        rows = [
            (
                text_of(metric.title),
                value_of(metric, metrics),
                f'<span class="meaning">{text_of(metric.meaning)}</span>',
            )
            for metric in known
            if metric.section == section and metrics[metric.key] is not None
        ]
        parts.append(f"<h3>{text_of(section)}</h3>\n{table((), rows, 'results')}" if rows else "")
    every = (
        (f"<code>{text_of(key)}</code>", _sortable(metrics[key]))
        for key, metric in named.items()
        if not (metric and metric.instead)
    )
    return "\n".join(filter(None, parts)) + folded("All metrics", table(("Key", "Value"), every, "facts sortable"))


def value_of(metric: Metric, metrics: Mapping[str, Fact]) -> str:
    """Return a metric with its unit, escaped."""
    value = text_of(metrics.get(metric.key))
    return f"{value}\u202f{text_of(metric.unit)}" if metric.unit else value


def _sortable(value: Fact) -> str | Number:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return Number(text_of(value), float(value)) if is_number else text_of(value)  # type: ignore[arg-type]
