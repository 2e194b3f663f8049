"""A run's record as one self-contained HTML page: no script, no request, readable on paper too."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.markup import document, folded, items, section, table, text_of
from scaffold_pipeline.report.window import draw_window
from scaffold_pipeline.report.wording import NOTHING, failed_gates, to_duration, to_size, to_text

_SHORT = 24
"""Characters of a fact that has a place in the line of its stage."""

_UNITS = {
    "area_mm2": "mm\u00b2",
    "outer_volume_mm3": "mm\u00b3",
    "volume_mm3": "mm\u00b3",
    "voxel_size": "mm",
}


@dataclass(frozen=True)
class Entry:
    """A line of the table of results: the metric it shows, and what that means in a sentence."""

    title: str
    key: str
    meaning: str


_RESULTS = (
    Entry("Porosity", "porosity", "Share of the outer shape that is pore, measured on the written solid."),
    Entry("Porosity asked for", "porosity_requested", "What the iso-value was solved for."),
    Entry("Iso-value", "iso", "Solid is where the field is above it: pores grow as it grows."),
    Entry("Channels closed", "channels_closed", "Passages from pore to pore that are shut at this iso-value."),
    Entry("Struts broken", "struts_broken", "Mesh edges that are not solid all along at this iso-value."),
    Entry("Pieces of solid", "solid_pieces", "One is what a printer wants; more are loose."),
    Entry("Largest piece of solid", "solid_largest_fraction", "Its share of the solid's volume."),
    Entry("Pieces of pore space", "pore_pieces", "One lets fluid and cells reach everywhere."),
    Entry("Largest piece of pore space", "pore_largest_fraction", "Its share of the pore volume."),
    Entry("Manifold", "is_manifold", "Whether the surface is closed, with two triangles at each edge."),
    Entry("Volume of the solid", "volume_mm3", "What has to be printed."),
    Entry("Volume of the outer shape", "outer_volume_mm3", "The anatomy before it was made porous."),
    Entry("Area of the solid", "area_mm2", "Where cells can settle, the outer surface included."),
    Entry("Triangles", "triangles", "Of the solid's surface."),
    Entry("Cells", "cells", "Of the volume mesh; each holds one pore."),
    Entry("Elements", "elements", "Points and segments that the field is interpolated from."),
    Entry("Voxels", "voxels", "Samples of the field."),
    Entry("Voxel size", "voxel_size", "Distance between samples: finer details are lost."),
)


def render_page(record: Mapping[str, Any], metrics: Mapping[str, Fact], preview_png: bytes | None) -> str:
    """Return the page of a run: `record` as in `run.json`, `metrics` as in `metrics.json`, the picture if any.

    A value that is missing or None is shown as a dash.
    """
    name = text_of(record.get("name"))
    sections = (
        _headline(record, name, metrics),
        _picture(preview_png, name),
        section("Results", draw_window(metrics) + _results(metrics)),
        section("Stages", _stages(record.get("stages") or ())),
        section("Warnings", items(record.get("warnings") or ())),
        section("Configuration", folded("Resolved configuration", _json(record.get("config")))),
        section("Files", _files(record.get("files") or {})),
        section("Provenance", _provenance(record)),
    )
    return document(to_text(record.get("name")), sections)


def _json(value: object) -> str:
    text = json.dumps(value, indent=2, ensure_ascii=False, default=str)
    return f"<pre>{escape(text)}</pre>" if value else ""


def _headline(record: Mapping[str, Any], name: str, metrics: Mapping[str, Fact]) -> str:
    quality = metrics.get("quality")
    gates = failed_gates(record.get("quality") if quality is None else quality)
    verdicts = {
        None: ("unknown", "quality not measured"),
        True: ("fail", "quality fail"),
        False: ("pass", "quality pass"),
    }
    kind, verdict = verdicts[None if gates is None else bool(gates)]
    when = record.get("finished") or record.get("started")
    told = " \u00b7 ".join(
        (
            f"porosity {text_of(metrics.get('porosity'))}",
            f"{text_of(metrics.get('triangles'))} triangles",
            f"seed {text_of(record.get('seed'))}",
            to_duration(record.get("seconds")),
            f"{to_size(record.get('peak_memory_bytes'))} at most",
            text_of(when).replace("T", " "),
        )
    )
    failures = f'<div class="gates">{items(gates)}</div>' if gates else ""
    return (
        f'<header>\n<h1>{name}</h1>\n<p class="verdict {kind}">{verdict}</p>\n'
        f'<p class="told">{told}</p>\n{failures}</header>'
    )


def _picture(png: bytes | None, name: str) -> str:
    if png is None:
        return '<p class="none">No picture was drawn.</p>'
    return f'<figure><img alt="The solid {name}" src="data:image/png;base64,{b64encode(png).decode()}"></figure>'


def _results(metrics: Mapping[str, Fact]) -> str:
    rows = [
        (entry.title, _value(entry.key, metrics), f'<span class="meaning">{entry.meaning}</span>') for entry in _RESULTS
    ]
    skipped = metrics.get("gates_not_applied")
    if isinstance(skipped, list) and skipped:
        rows.append(
            ("Gates not applied", text_of(len(skipped)), f'<span class="meaning">{text_of("; ".join(skipped))}</span>')
        )
    every = table(("Key", "Value"), ((f"<code>{text_of(k)}</code>", text_of(v)) for k, v in metrics.items()), "facts")
    return table((), rows, "results") + folded("All metrics", every)


def _value(key: str, metrics: Mapping[str, Fact]) -> str:
    unit = _UNITS.get(key)
    value = text_of(metrics.get(key))
    return f"{value} {unit}" if unit and value != NOTHING else value


def _stages(stages: Iterable[Mapping[str, Any]]) -> str:
    head = ("Stage", "Status", "Time", "Memory", "Facts")
    return table(head, (_stage_row(stage) for stage in stages), "stages")


def _stage_row(stage: Mapping[str, Any]) -> tuple[str, ...]:
    label, used = stage.get("label"), stage.get("stage")
    named = f"<strong>{text_of(label)}</strong>" + (f"<br>{text_of(used)}" if used != label else "")
    reused = stage.get("reused")
    status = NOTHING if reused is None else "reused" if reused else "run"
    return (
        f"{named}<br><small>version {text_of(stage.get('version'))}</small>",
        f'<span class="{status}">{status}</span>',
        to_duration(stage.get("seconds")),
        to_size(stage.get("peak_memory_bytes")),
        _stage_facts(stage),
    )


def _stage_facts(stage: Mapping[str, Any]) -> str:
    facts = ((text_of(key), text_of(value)) for key, value in (stage.get("summary") or {}).items())
    origin = {
        **{f"reads {slot}": digest for slot, digest in (stage.get("inputs") or {}).items()},
        **{f"file {name}": digest for name, digest in (stage.get("input_files") or {}).items()},
        f"writes {to_text(stage.get('slot'))}": stage.get("output"),
        "seed": stage.get("seed"),
    }
    parameters = stage.get("parameters") or {}
    rows = ((text_of(key), f"<code>{text_of(value)}</code>") for key, value in {**parameters, **origin}.items())
    return (
        folded(_gist(stage), table((), facts, "facts"))
        + folded("parameters, hashes", table((), rows, "facts"))
        + items(f"warning: {message}" for message in stage.get("warnings") or ())
    )


def _gist(stage: Mapping[str, Any]) -> str:
    """Return the first short facts of a stage in a line."""
    facts = ((key, to_text(value)) for key, value in (stage.get("summary") or {}).items())
    short = [f"{key} {value}" for key, value in facts if len(value) <= _SHORT]
    return escape(", ".join(short[:3])) or "facts"


def _files(files: Mapping[str, Mapping[str, Any]]) -> str:
    rows = (
        (text_of(name), to_size(facts.get("bytes")), f"<code>{text_of(facts.get('sha256'))}</code>")
        for name, facts in files.items()
    )
    return table(("File", "Size", "SHA-256"), rows, "files")


def _provenance(record: Mapping[str, Any]) -> str:
    facts = {
        "Seed": record.get("seed"),
        "SHA-256 of the configuration": record.get("config_sha256"),
        **{str(key).capitalize(): value for key, value in (record.get("platform") or {}).items()},
    }
    rows = [(text_of(key), f"<code>{text_of(value)}</code>") for key, value in facts.items()]
    versions = [
        (text_of(key), f"<code>{text_of(value)}</code>") for key, value in (record.get("versions") or {}).items()
    ]
    return table((), rows, "facts") + folded("Versions of libraries", table((), versions, "facts"))
