"""A run's record as one self-contained HTML page: no script, no request, readable on paper too."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

from scaffold_pipeline.artifacts import Fact
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
    name = _text(record.get("name"))
    sections = (
        _headline(record, name, metrics),
        _picture(preview_png, name),
        _section("Results", draw_window(metrics) + _results(metrics)),
        _section("Stages", _stages(record.get("stages") or ())),
        _section("Warnings", _items(record.get("warnings") or ())),
        _section("Configuration", _folded("Resolved configuration", _json(record.get("config")))),
        _section("Files", _files(record.get("files") or {})),
        _section("Provenance", _provenance(record)),
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{name} \u2013 scaffold-pipeline</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )


def _text(value: object) -> str:
    return escape(to_text(value))


def _section(title: str, content: str) -> str:
    return f"<section>\n<h2>{title}</h2>\n{content}\n</section>" if content else ""


def _folded(title: str, content: str) -> str:
    return f"<details>\n<summary>{title}</summary>\n{content}\n</details>" if content else ""


def _items(lines: Iterable[object]) -> str:
    items = "".join(f"<li>{_text(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _table(head: Iterable[str], rows: Iterable[Iterable[str]], kind: str) -> str:
    """Return a table of cells that are HTML already; no rows, no table."""
    body = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    titles = "".join(f'<th scope="col">{title}</th>' for title in head)
    top = f"<thead><tr>{titles}</tr></thead>\n" if titles else ""
    table = f'<div class="wide"><table class="{kind}">\n{top}<tbody>\n{body}\n</tbody></table></div>'
    return table if body else ""


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
            f"porosity {_text(metrics.get('porosity'))}",
            f"{_text(metrics.get('triangles'))} triangles",
            f"seed {_text(record.get('seed'))}",
            to_duration(record.get("seconds")),
            f"{to_size(record.get('peak_memory_bytes'))} at most",
            _text(when).replace("T", " "),
        )
    )
    failures = f'<div class="gates">{_items(gates)}</div>' if gates else ""
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
            ("Gates not applied", _text(len(skipped)), f'<span class="meaning">{_text("; ".join(skipped))}</span>')
        )
    every = _table(("Key", "Value"), ((f"<code>{_text(k)}</code>", _text(v)) for k, v in metrics.items()), "facts")
    return _table((), rows, "results") + _folded("All metrics", every)


def _value(key: str, metrics: Mapping[str, Fact]) -> str:
    unit = _UNITS.get(key)
    value = _text(metrics.get(key))
    return f"{value} {unit}" if unit and value != NOTHING else value


def _stages(stages: Iterable[Mapping[str, Any]]) -> str:
    head = ("Stage", "Status", "Time", "Memory", "Facts")
    return _table(head, (_stage_row(stage) for stage in stages), "stages")


def _stage_row(stage: Mapping[str, Any]) -> tuple[str, ...]:
    label, used = stage.get("label"), stage.get("stage")
    named = f"<strong>{_text(label)}</strong>" + (f"<br>{_text(used)}" if used != label else "")
    reused = stage.get("reused")
    status = NOTHING if reused is None else "reused" if reused else "run"
    return (
        f"{named}<br><small>version {_text(stage.get('version'))}</small>",
        f'<span class="{status}">{status}</span>',
        to_duration(stage.get("seconds")),
        to_size(stage.get("peak_memory_bytes")),
        _stage_facts(stage),
    )


def _stage_facts(stage: Mapping[str, Any]) -> str:
    facts = ((_text(key), _text(value)) for key, value in (stage.get("summary") or {}).items())
    origin = {
        **{f"reads {slot}": digest for slot, digest in (stage.get("inputs") or {}).items()},
        **{f"file {name}": digest for name, digest in (stage.get("input_files") or {}).items()},
        f"writes {to_text(stage.get('slot'))}": stage.get("output"),
        "seed": stage.get("seed"),
    }
    parameters = stage.get("parameters") or {}
    rows = ((_text(key), f"<code>{_text(value)}</code>") for key, value in {**parameters, **origin}.items())
    return (
        _folded(_gist(stage), _table((), facts, "facts"))
        + _folded("parameters, hashes", _table((), rows, "facts"))
        + _items(f"warning: {message}" for message in stage.get("warnings") or ())
    )


def _gist(stage: Mapping[str, Any]) -> str:
    """Return the first short facts of a stage in a line."""
    facts = ((key, to_text(value)) for key, value in (stage.get("summary") or {}).items())
    short = [f"{key} {value}" for key, value in facts if len(value) <= _SHORT]
    return escape(", ".join(short[:3])) or "facts"


def _files(files: Mapping[str, Mapping[str, Any]]) -> str:
    rows = (
        (_text(name), to_size(facts.get("bytes")), f"<code>{_text(facts.get('sha256'))}</code>")
        for name, facts in files.items()
    )
    return _table(("File", "Size", "SHA-256"), rows, "files")


def _provenance(record: Mapping[str, Any]) -> str:
    facts = {
        "Seed": record.get("seed"),
        "SHA-256 of the configuration": record.get("config_sha256"),
        **{str(key).capitalize(): value for key, value in (record.get("platform") or {}).items()},
    }
    rows = [(_text(key), f"<code>{_text(value)}</code>") for key, value in facts.items()]
    versions = [(_text(key), f"<code>{_text(value)}</code>") for key, value in (record.get("versions") or {}).items()]
    return _table((), rows, "facts") + _folded("Versions of libraries", _table((), versions, "facts"))


_STYLE = """
:root { --ink: #23272e; --faint: #667080; --paper: #fdfcf9; --panel: #f4f0e7; --line: #ddd6c6; --accent: #8a6d3b;
  --good: #24724a; --bad: #b3261e; --good-band: #9fd0b2; --closed-band: #8fa9c9; --broken-band: #e2a79b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e3dc; --faint: #9aa1ac; --paper: #17191d; --panel: #22252b;
  --line: #3a3e46; --accent: #d9b97c; --good: #6fce9a; --bad: #ff8a80; --good-band: #2f6b4a;
  --closed-band: #3c5270; --broken-band: #77413a; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { margin: 0; font-size: 2rem; line-height: 1.2; overflow-wrap: anywhere; }
h2 { margin: 2.5rem 0 .75rem; padding-bottom: .25rem; font-size: 1.2rem; border-bottom: 1px solid var(--line); }
header { display: grid; grid-template-columns: 1fr auto; gap: .25rem 1rem; align-items: center; }
.told, .gates { grid-column: 1 / -1; margin: 0; color: var(--faint); }
.gates { color: var(--bad); }
.gates ul { margin: .5rem 0 0; }
.verdict { margin: 0; padding: .25rem .9rem; border: 1.5px solid; border-radius: 1rem; font-weight: 600; }
.pass { color: var(--good); }
.fail { color: var(--bad); }
.unknown, .none, .meaning, small { color: var(--faint); }
figure { margin: 1.5rem 0; }
figure img { display: block; max-width: 100%; max-height: 80vh; margin: 0 auto; padding: .5rem; background: #fff;
  border: 1px solid var(--line); border-radius: .5rem; }
figcaption { color: var(--faint); font-size: .9rem; }
svg { width: 100%; height: auto; }
svg text { fill: var(--ink); font: 14px system-ui, sans-serif; }
svg line { stroke: var(--ink); stroke-width: 1.5; }
rect.open { fill: var(--good-band); }
rect.closed { fill: var(--closed-band); fill-opacity: .9; }
rect.broken { fill: var(--broken-band); fill-opacity: .75; }
.wide { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .75rem .35rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 500; font-size: .9rem; }
.results td:nth-child(2) { text-align: right; font-weight: 600; white-space: nowrap; }
.results td:nth-child(3) { padding-left: 1rem; font-size: .9rem; }
.stages td:nth-child(3), .stages td:nth-child(4), .files td:nth-child(2) { white-space: nowrap; }
.stages ul { margin: .25rem 0; padding-left: 1.2rem; color: var(--accent); font-size: .9rem; }
.facts, details { font-size: .9rem; }
.facts td { overflow-wrap: anywhere; }
.facts td:first-child { width: 40%; color: var(--faint); }
.reused { color: var(--faint); }
summary { cursor: pointer; color: var(--accent); }
code, pre { font: .85em/1.45 ui-monospace, monospace; overflow-wrap: anywhere; }
pre { padding: .75rem 1rem; overflow-x: auto; background: var(--panel); border-radius: .5rem; }
@media print { :root { color-scheme: light; --ink: #000; --faint: #444; --paper: #fff; --line: #bbb; --accent: #5a4622;
  --good: #1b5e3a; --bad: #8c1d18; --good-band: #9fd0b2; --closed-band: #8fa9c9; --broken-band: #e2a79b; }
  body { font-size: 10pt; } main { max-width: none; padding: 0; } tr, figure, header { break-inside: avoid; }
  h2 { break-after: avoid; } figure img { max-height: 12cm; } * { print-color-adjust: exact; }
  details::details-content { content-visibility: visible; height: auto; } }
"""
