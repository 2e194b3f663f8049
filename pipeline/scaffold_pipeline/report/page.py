"""A run's record as one self-contained HTML page: the values for its template, `run.html.j2`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from scaffold_pipeline.artifacts import Declared, Drawing, Fact
from scaffold_pipeline.report.declared import declared_of
from scaffold_pipeline.report.gates import list_gates
from scaffold_pipeline.report.plots import draw_curve, draw_histogram
from scaffold_pipeline.report.rendering import Cell, Figure, render, to_data_uri
from scaffold_pipeline.report.reproducing import CITATIONS, TITLE, needed_files
from scaffold_pipeline.report.results import current_keys, group_results, headline, list_metrics
from scaffold_pipeline.report.sources import Sources
from scaffold_pipeline.report.view import DrawnView, colour_of, draw_view, places_of, read_view
from scaffold_pipeline.report.window import draw_window
from scaffold_pipeline.report.wording import NOTHING, failed_gates, to_name, to_size, to_text

_SHORT = 24
"""Most characters of a fact shown in the line of its stage."""

_MOST_BUTTONS, _MOST_LISTED = 12, 200
"""Places of a finding with buttons, and in its list; the view marks more, and `measures.json` has all."""

_WIDTH = re.compile(rb'<svg [^>]{0,100}\bwidth="([0-9]{1,6}(?:\.[0-9]{1,9})?)mm"')
_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
_STYLES = ("page.css", "run.css")


def render_page(sources: Sources) -> str:
    """Return the page of a run. Missing values are left out or shown as a dash."""
    record, metrics, declared = sources.record, sources.metrics, declared_of(sources.record)
    findings = _mappings(sources.measures, "findings")
    view, view_fault = _view(sources, findings, declared)
    return render(
        "run.html.j2",
        styles=_STYLES,
        scripts=("tables.js", "painter.js", "viewer.js") if view else ("tables.js",),
        **_headline(record, metrics, declared),
        **_pictures(sources, declared),
        findings=[_finding(finding, number) for number, finding in enumerate(findings)],
        results=group_results(metrics, declared),
        every=list_metrics(metrics, declared),
        charts=list(_charts(sources.measures)),
        certificate=draw_window(metrics),
        view=view,
        view_fault=view_fault,
        viewers=() if sources.view else declared.viewers,
        missing=sources.missing,
        **_record(sources, declared),
    )


def _mappings(measures: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    return [entry for entry in measures.get(name) or () if isinstance(entry, Mapping)]


class Verdict(NamedTuple):
    """The result of the quality gates, as a style and in words."""

    kind: str
    words: str


_VERDICTS = {
    None: Verdict("unknown", "quality not measured"),
    True: Verdict("fail", "quality fail"),
    False: Verdict("pass", "quality pass"),
}


def _headline(record: Mapping[str, Any], metrics: Mapping[str, Fact], declared: Declared) -> dict[str, object]:
    quality = metrics.get("quality")
    gates = failed_gates(record.get("quality") if quality is None else quality)
    return {
        "name": record.get("name"),
        "verdict": _VERDICTS[None if gates is None else bool(gates)],
        "gates": list_gates(record, metrics, declared),
        "headline": headline(metrics, declared),
        "seed": record.get("seed"),
        "seconds": record.get("seconds"),
        "memory": record.get("peak_memory_bytes"),
        "when": record.get("finished") or record.get("started"),
    }


class Cut(NamedTuple):
    """A section through the solid, and a note for all sections."""

    figure: Figure
    meaning: str


def _pictures(sources: Sources, declared: Declared) -> dict[str, object]:
    """Return the pictures by their place on the page; the first lead picture shows the solid."""
    drawn = [(file, declared.drawing(file) or Drawing(file, file, "")) for file in sources.pictures]
    lead = next((file for file, drawing in drawn if drawing.place == "lead"), None)
    about = f"The solid {to_text(sources.record.get('name'))}"
    return {
        "lead": None if lead is None else _figure(sources, lead, about),
        "cuts": [
            Cut(_figure(sources, file, f"{drawing.title}: {drawing.meaning}", drawing.title), drawing.meaning)
            for file, drawing in drawn
            if drawing.place == "section"
        ],
        "pictures": [
            _figure(sources, file, drawing.meaning or drawing.title, drawing.title)
            for file, drawing in drawn
            if drawing.place == "picture"
        ],
    }


def _figure(sources: Sources, file: str, about: str, caption: str = "") -> Figure:
    """Return the picture in a file; a drawing with a width in mm can be shown to scale."""
    content = sources.pictures[file]
    width = _WIDTH.match(content)
    return Figure(to_data_uri(_TYPES[file[-4:]], content), about, caption, float(width[1]) if width else None)


def _view(sources: Sources, findings: list[Mapping[str, Any]], declared: Declared) -> tuple[DrawnView | None, str]:
    """Return the 3-D view, if there is one, or its fault."""
    if sources.view is None:
        return None, ""
    try:
        return draw_view(read_view(sources.view), findings), ""
    except ValueError as error:
        file = next((drawing.file for drawing in declared.drawings if drawing.place == "view"), "its file")
        return None, f"{file} {error}"


def _charts(measures: Mapping[str, Any]) -> Iterator[object]:
    for name, draw in (("histograms", draw_histogram), ("curves", draw_curve)):
        yield from filter(None, map(draw, _mappings(measures, name)))


class Place(NamedTuple):
    """A place, mm, exact for the script and rounded for people."""

    exact: str
    short: list[str]


class Found(NamedTuple):
    """A finding: buttons for its first places, and a list of more."""

    number: int
    colour: str
    rule: object
    message: object
    buttons: list[Place]
    title: str
    rows: list[list[str]]


def _finding(finding: Mapping[str, Any], number: int) -> Found:
    places = places_of(finding)
    short = [[f"{length:.4g}" for length in place] for place in places[:_MOST_LISTED]]
    is_whole = len(places) <= _MOST_LISTED
    return Found(
        number,
        colour_of(number),
        finding.get("rule"),
        finding.get("message"),
        [Place(" ".join(map(str, place)), text) for place, text in zip(places[:_MOST_BUTTONS], short, strict=False)],
        f"{len(places)} places" if is_whole else f"The first {_MOST_LISTED} of {len(places)} places",
        short,
    )


class StageLine(NamedTuple):
    """A stage of the run: its time and memory, facts, and parameters and hashes."""

    label: object
    use: object
    version: object
    status: str
    seconds: float | None
    memory: float | None
    share_of_time: str | None
    share_of_memory: str | None
    gist: str
    facts: list[tuple[str, Any]]
    origin: list[tuple[str, Any]]
    warnings: list[str]


def _stages(stages: Sequence[Mapping[str, Any]], declared: Declared) -> list[StageLine]:
    longest, largest = (max((stage.get(key) or 0 for stage in stages), default=0) for key in _MEASURED)
    return [_stage(stage, longest, largest, declared) for stage in stages]


_MEASURED = ("seconds", "peak_memory_bytes")


def _stage(stage: Mapping[str, Any], longest: float, largest: float, declared: Declared) -> StageLine:
    reused = stage.get("reused")
    seconds, memory = (stage.get(key) for key in _MEASURED)
    summary = stage.get("summary") or {}
    facts = [(key, summary[key]) for key in current_keys(summary, declared)]
    return StageLine(
        label=stage.get("label"),
        use=stage.get("stage"),
        version=stage.get("version"),
        status=NOTHING if reused is None else "reused" if reused else "run",
        seconds=seconds,
        memory=memory,
        share_of_time=_share(seconds, longest),
        share_of_memory=_share(memory, largest),
        gist=_gist(facts),
        facts=facts,
        origin=_origin(stage),
        warnings=[f"warning: {message}" for message in stage.get("warnings") or ()],
    )


def _share(value: float | None, whole: float) -> str | None:
    """Return a value's share of the greatest, per cent."""
    return f"{100.0 * value / whole:.0f}" if value and whole else None


def _origin(stage: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the parameters of a stage, the hashes of its inputs and outputs, and its seed."""
    origin = {
        **(stage.get("parameters") or {}),
        **{f"reads {slot}": digest for slot, digest in (stage.get("inputs") or {}).items()},
        **{f"file {name}": digest for name, digest in (stage.get("input_files") or {}).items()},
        f"writes {to_text(stage.get('slot'))}": stage.get("output"),
        "seed": to_name(stage.get("seed")),
    }
    return list(origin.items())


def _gist(facts: list[tuple[str, Any]]) -> str:
    """Return the first short facts of a stage in one line."""
    short = [f"{key} {text}" for key, text in ((key, to_text(value)) for key, value in facts) if len(text) <= _SHORT]
    return ", ".join(short[:3]) or "facts"


def _record(sources: Sources, declared: Declared) -> dict[str, object]:
    """Return the values for the sections on configuration, record, repeating and citing the run."""
    record = sources.record
    config, files = record.get("config"), record.get("files") or {}
    text = sources.config or json.dumps(config, indent=2, ensure_ascii=False, default=str) if config else ""
    platform = ((str(key).capitalize(), value) for key, value in (record.get("platform") or {}).items())
    versions = record.get("versions") or {}
    return {
        "stages": _stages(list(record.get("stages") or ()), declared),
        "warnings": list(record.get("warnings") or ()),
        "config": text,
        "files": [
            (name, Cell(to_size(facts.get("bytes")), facts.get("bytes")), facts.get("sha256"))
            for name, facts in files.items()
        ],
        "facts": [
            ("Seed", to_name(record.get("seed"))),
            ("SHA-256 of the configuration", record.get("config_sha256")),
            *platform,
        ],
        "versions": list(versions.items()),
        "version": versions.get(TITLE),
        "inputs": needed_files(record),
        "citations": CITATIONS,
    }
