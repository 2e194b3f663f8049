"""HTML of artifacts for notebooks: their facts in a small table, all texts escaped."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from scaffold_pipeline.artifacts.meshes import Artifact
from scaffold_pipeline.artifacts.metrics import Metrics

_MOST_ROWS = 40
"""Number of facts shown: a longer table is not read at a glance."""


def artifact_html(artifact: Artifact) -> str:
    """Return the name of the artifact's type and its facts as HTML, with its verdict first if it has one."""
    facts = artifact.values if isinstance(artifact, Metrics) else artifact.summary()
    verdict = f"<p>{verdict_html(artifact.summary()['quality'])}</p>" if isinstance(artifact, Metrics) else ""
    return f"<div><strong>{escape(type(artifact).__name__)}</strong>{verdict}{facts_table(facts)}</div>"


def facts_table(facts: Mapping[str, object]) -> str:
    """Return facts as a table of two columns, or an empty text without facts."""
    rows = [f"<tr><th>{escape(str(key))}</th><td>{escape(_text(value))}</td></tr>" for key, value in facts.items()]
    more = len(rows) - _MOST_ROWS
    if more > 0:
        rows[_MOST_ROWS:] = [f"<tr><td colspan=2>and {more} more</td></tr>"]
    return f"<table>{''.join(rows)}</table>" if rows else ""


def verdict_html(quality: object) -> str:
    """Return the verdict in `quality` of the metrics as HTML: pass, not measured, or the failed gates."""
    if isinstance(quality, str):
        return f"quality: <strong>{escape(quality)}</strong>"
    gates = quality if isinstance(quality, list | tuple) else [quality]
    lines = "".join(f"<li>{escape(str(gate))}</li>" for gate in gates)
    return f"quality: <strong>FAILED</strong><ul>{lines}</ul>"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    return "" if value is None else str(value)
