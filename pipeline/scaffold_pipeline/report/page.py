"""A run's record as one self-contained HTML page: it asks for nothing and reads on paper too.

Its script turns the solid and sorts tables; all else is there without it.
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

from scaffold_pipeline.artifacts import Declared, Fact
from scaffold_pipeline.report import reproducing
from scaffold_pipeline.report.declared import declared_of
from scaffold_pipeline.report.gates import gate_list, list_gates
from scaffold_pipeline.report.markup import TABLES, Number, contents, document, folded, items, section, table, text_of
from scaffold_pipeline.report.page_style import STYLE
from scaffold_pipeline.report.plots import draw_curve, draw_histogram
from scaffold_pipeline.report.results import highlights, results
from scaffold_pipeline.report.sources import Sources
from scaffold_pipeline.report.view import colour_of, draw_view, places_of, read_view
from scaffold_pipeline.report.window import draw_window
from scaffold_pipeline.report.wording import NOTHING, failed_gates, to_duration, to_name, to_size, to_text

_SHORT = 24
"""Characters of a fact that has a place in the line of its stage."""

_MOST_BUTTONS, _MOST_LISTED = 12, 200
"""Places of a finding that buttons lead to, and that are listed; the view marks more, `measures.json` has all."""

_VIEWER = [Path(__file__).with_name(name) for name in ("painter.js", "viewer.js")]
_WIDTH = re.compile(rb'<svg [^>]{0,100}\bwidth="([0-9]{1,6}(?:\.[0-9]{1,9})?)mm"')
_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}


def render_page(sources: Sources) -> str:
    """Return the page of a run. What is missing or None is left out or shown as a dash."""
    record, metrics = sources.record, sources.metrics
    declared = declared_of(record)
    name = text_of(record.get("name"))
    findings = _mappings(sources.measures, "findings")
    view = _view(sources, findings, name)
    sections = {
        "Sections": _sections(sources, declared),
        "Places to look at": _findings(findings),
        "Results": results(metrics, declared),
        "Distributions": _plots(sources.measures),
        "Certificate": draw_window(metrics),
        "Pictures": _pictures(sources, declared),
        "Stages": _stages(list(record.get("stages") or ())),
        "Warnings": items(record.get("warnings") or ()),
        "Configuration": folded("Resolved configuration", _config(sources)),
        "Files": _files(record.get("files") or {}),
        "Record": _provenance(record),
        "Run it again": reproducing.how_to_run(record),
        "How to cite": reproducing.how_to_cite(),
    }
    parts = [_headline(record, metrics, declared), contents(sections), _solid(sources, name, declared), view]
    parts += [section(title, content) for title, content in sections.items()]
    scripts = [TABLES, *(_VIEWER if "view-data" in view else ())]
    script = "".join(path.read_text(encoding="utf-8") for path in scripts)
    return document(to_text(record.get("name")), parts, style=STYLE, script=script)


def _mappings(measures: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    return [entry for entry in measures.get(name) or () if isinstance(entry, Mapping)]


def _headline(record: Mapping[str, Any], metrics: Mapping[str, Fact], declared: Declared) -> str:
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
            f"seed {text_of(to_name(record.get('seed')))}",
            to_duration(record.get("seconds")),
            f"{to_size(record.get('peak_memory_bytes'))} at most",
            text_of(when).replace("T", " "),
        )
    )
    return (
        f'<header>\n<h1>{text_of(record.get("name"))}</h1>\n<p class="verdict {kind}">{verdict}</p>\n'
        f"{gate_list(list_gates(record, metrics, declared))}\n"
        f'{highlights(metrics, declared)}\n<p class="told">{told}</p>\n</header>'
    )


def _solid(sources: Sources, name: str, declared: Declared) -> str:
    """Return the picture of the solid, which stands where it cannot be turned: on paper, or without script."""
    lead = next((file for file in sources.pictures if _place(file, declared) == "lead"), None)
    left_out = (
        f'<div class="none">Left out, as they are not the files that the run wrote: {items(sources.missing)}</div>'
    )
    picture = (
        '<p class="none instead">No picture was drawn.</p>'
        if lead is None
        else _figure(lead, sources.pictures[lead], f"The solid {name}", kind="instead")
    )
    viewers = " or ".join(f"<code>{text_of(name)}</code>" for name in declared.viewers)
    how = _HOW_TO_VIEW.format(viewers) if viewers and not sources.view else ""
    return picture + how + (left_out if sources.missing else "")


def _figure(file: str, content: bytes, about: str, *, kind: str = "", caption: str = "") -> str:
    """Return a picture of a file; `about`, its text for those who do not see it, and `caption` are escaped already.

    Drawings whose width is known in mm can share a scale.
    """
    source = f"data:{_TYPES[file[-4:]]};base64,{b64encode(content).decode()}"
    told = f"<figcaption>{caption}</figcaption>" if caption else ""
    width = _WIDTH.match(content)
    wide = f' style="--wide: {float(width[1]):g}"' if width else ""
    return f'<figure class="{kind}"{wide}><img alt="{about}" src="{source}">{told}</figure>'


def _view(sources: Sources, findings: list[Mapping[str, Any]], name: str) -> str:
    if sources.view is None:
        return ""
    try:
        return draw_view(read_view(sources.view), findings, name)
    except ValueError as error:
        return f'<p class="none">The 3-D view is left out: view.npz {text_of(error)}.</p>'


def _place(file: str, declared: Declared) -> str:
    """Return where a picture is shown; with the others where no stage declares it."""
    drawing = declared.drawing(file)
    return "picture" if drawing is None else drawing.place


def _sections(sources: Sources, declared: Declared) -> str:
    drawn = {file: found for file in sources.pictures if (found := declared.drawing(file)) and found.place == "section"}
    figures = [
        _figure(
            file,
            sources.pictures[file],
            text_of(f"{drawing.title}: {drawing.meaning}"),
            caption=text_of(drawing.title),
        )
        for file, drawing in drawn.items()
    ]
    hints = "".join(
        f'<p class="meaning">{text_of(meaning)}</p>\n'
        for meaning in dict.fromkeys(drawing.meaning for drawing in drawn.values())
    )
    return f'{hints}<div class="sections">{"".join(figures)}</div>' if figures else ""


def _pictures(sources: Sources, declared: Declared) -> str:
    others = [file for file in sources.pictures if _place(file, declared) == "picture"]
    return "".join(_figure(file, sources.pictures[file], text_of(file), caption=text_of(file)) for file in others)


def _plots(measures: Mapping[str, Any]) -> str:
    drawn = [draw_histogram(told) for told in _mappings(measures, "histograms")]
    drawn += [draw_curve(told) for told in _mappings(measures, "curves")]
    figures = "\n".join(filter(None, drawn))
    return f'<div class="plots">{figures}</div>' if figures else ""


def _findings(findings: list[Mapping[str, Any]]) -> str:
    lines = "".join(
        f'<li><span class="dot" style="--own: {colour_of(number)}"></span>'
        f"<strong>{text_of(finding.get('rule'))}</strong>: "
        f"{text_of(finding.get('message'))}{_places(places_of(finding), number)}</li>"
        for number, finding in enumerate(findings)
    )
    return f'<ul class="findings">{lines}</ul>' if lines else ""


def _places(places: list[list[float]], number: int) -> str:
    buttons = "".join(
        f'<li><button type="button" hidden data-finding="{number}" data-place="{" ".join(map(str, place))}">'
        f"show {', '.join(f'{length:.4g}' for length in place)}</button></li>"
        for place in places[:_MOST_BUTTONS]
    )
    rows = ([f"{length:.4g}" for length in place] for place in places[:_MOST_LISTED])
    title = (
        f"{len(places)} places" if len(places) <= _MOST_LISTED else f"The first {_MOST_LISTED} of {len(places)} places"
    )
    listed = folded(title, table(("x, mm", "y, mm", "z, mm"), rows, "facts"))
    return (f'<ul class="places">{buttons}</ul>' if buttons else "") + listed


def _stages(stages: list[Mapping[str, Any]]) -> str:
    longest, largest = (max((stage.get(key) or 0 for stage in stages), default=0) for key in _MEASURED)
    head = ("Stage", "Status", "Time", "Memory", "Facts")
    return table(head, (_stage_row(stage, longest, largest) for stage in stages), "stages sortable")


_MEASURED = ("seconds", "peak_memory_bytes")


def _stage_row(stage: Mapping[str, Any], longest: float, largest: float) -> tuple[str | Number, ...]:
    label, used = stage.get("label"), stage.get("stage")
    named = f"<strong>{text_of(label)}</strong>" + (f"<br>{text_of(used)}" if used != label else "")
    reused = stage.get("reused")
    status = NOTHING if reused is None else "reused" if reused else "run"
    seconds, memory = (stage.get(key) for key in _MEASURED)
    return (
        f"{named}<br><small>version {text_of(stage.get('version'))}</small>",
        f'<span class="{status}">{status}</span>',
        Number(to_duration(seconds) + _share(seconds, longest), seconds),
        Number(to_size(memory) + _share(memory, largest), memory),
        _stage_facts(stage),
    )


def _share(value: float | None, whole: float) -> str:
    """Return a bar as long as the share of the greatest."""
    return f'<span class="share" style="--part: {100.0 * value / whole:.0f}%"></span>' if value and whole else ""


def _stage_facts(stage: Mapping[str, Any]) -> str:
    facts = ((text_of(key), text_of(value)) for key, value in (stage.get("summary") or {}).items())
    origin = {
        **{f"reads {slot}": digest for slot, digest in (stage.get("inputs") or {}).items()},
        **{f"file {name}": digest for name, digest in (stage.get("input_files") or {}).items()},
        f"writes {to_text(stage.get('slot'))}": stage.get("output"),
        "seed": to_name(stage.get("seed")),
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


def _config(sources: Sources) -> str:
    config = sources.record.get("config")
    text = sources.config or json.dumps(config, indent=2, ensure_ascii=False, default=str) if config else ""
    return f"<pre>{escape(text)}</pre>" if text else ""


def _files(files: Mapping[str, Mapping[str, Any]]) -> str:
    rows = (
        (
            text_of(name),
            Number(to_size(facts.get("bytes")), facts.get("bytes")),
            f"<code>{text_of(facts.get('sha256'))}</code>",
        )
        for name, facts in files.items()
    )
    return table(("File", "Size", "SHA-256"), rows, "files sortable")


def _provenance(record: Mapping[str, Any]) -> str:
    facts = {
        "Seed": to_name(record.get("seed")),
        "SHA-256 of the configuration": record.get("config_sha256"),
        **{str(key).capitalize(): value for key, value in (record.get("platform") or {}).items()},
    }
    return _codes(facts.items()) + folded("Versions of libraries", _codes((record.get("versions") or {}).items()))


def _codes(facts: Iterable[tuple[object, object]]) -> str:
    return table((), ((text_of(key), f"<code>{text_of(value)}</code>") for key, value in facts), "facts")


_HOW_TO_VIEW = '<p class="none">There is no 3-D view: the stage {}, last in a config, makes one.</p>\n'
