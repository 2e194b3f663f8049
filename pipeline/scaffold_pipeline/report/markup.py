"""What the pages have in common: the document around their sections, escaping, tables and styles."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import NamedTuple

from scaffold_pipeline.report.wording import to_text

TABLES = Path(__file__).with_name("tables.js")
"""The script by which tables sort."""


class Number(NamedTuple):
    """A cell of a table that tells a number in words, and the number that it is sorted by."""

    html: str
    value: float | None


def document(name: str, sections: Iterable[str], *, style: str = "", script: str = "") -> str:
    """Return a page of `sections`, HTML already, that can load nothing and can run no script but `script`."""
    allowed = f"script-src 'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'; " if script else ""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        f"{allowed}style-src 'unsafe-inline'\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text_of(name)} \u2013 scaffold-pipeline</title>\n<style>{_STYLE}{style}</style>\n"
        "</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + (f"\n<script>{script}</script>" if script else "")
        + "\n</main>\n</body>\n</html>\n"
    )


def text_of(value: object) -> str:
    """Return a fact as people read it, escaped."""
    return escape(to_text(value))


def section(title: str, content: str) -> str:
    """Return a section; no content, no section."""
    return f'<section id="{anchor_of(title)}">\n<h2>{title}</h2>\n{content}\n</section>' if content else ""


def contents(sections: Mapping[str, str]) -> str:
    """Return links to those of the sections, title -> content, that have any."""
    links = "".join(f'<li><a href="#{anchor_of(title)}">{title}</a></li>' for title, text in sections.items() if text)
    return f'<nav aria-label="Contents"><ul>{links}</ul></nav>'


def anchor_of(title: str) -> str:
    """Return the name under which links find the section of that title."""
    return title.lower().replace(" ", "-")


def folded(title: str, content: str) -> str:
    """Return what opens by a click on its title; no content, nothing."""
    return f"<details>\n<summary>{title}</summary>\n{content}\n</details>" if content else ""


def items(lines: Iterable[object]) -> str:
    """Return a list of lines, escaped; no lines, no list."""
    entries = "".join(f"<li>{text_of(line)}</li>" for line in lines)
    return f"<ul>{entries}</ul>" if entries else ""


def harmless_json(identity: str, value: object) -> str:
    """Return data for a script as an element of the page; no text in it can end that element."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="{identity}">{text}</script>'


def table(head: Iterable[str], rows: Iterable[Iterable[str | Number]], kind: str) -> str:
    """Return a table of cells that are HTML already; no rows, no table."""
    body = "\n".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    titles = "".join(f'<th scope="col">{title}</th>' for title in head)
    top = f"<thead><tr>{titles}</tr></thead>\n" if titles else ""
    whole = f'<div class="wide"><table class="{kind}">\n{top}<tbody>\n{body}\n</tbody></table></div>'
    return whole if body else ""


def _cell(cell: str | Number) -> str:
    if isinstance(cell, str):
        return f"<td>{cell}</td>"
    key = "" if cell.value is None else f"{cell.value:.9g}"
    return f'<td data-value="{key}">{cell.html}</td>'


_STYLE = """
:root { --ink: #23272e; --faint: #5d6675; --paper: #fdfcf9; --panel: #f4f0e7; --line: #ddd6c6; --accent: #7a5f30;
  --good: #24724a; --bad: #b3261e; --good-band: #9fd0b2; --closed-band: #8fa9c9; --broken-band: #e2a79b;
  --mark: #2f6f9f; }
@media screen and (prefers-color-scheme: dark) { :root { --ink: #e6e3dc; --faint: #a3aab5; --paper: #17191d;
  --panel: #22252b; --line: #3a3e46; --accent: #d9b97c; --good: #6fce9a; --bad: #ff8a80; --good-band: #2f6b4a;
  --closed-band: #3c5270; --broken-band: #77413a; --mark: #7db4de; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { margin: 0; font-size: 2rem; line-height: 1.2; overflow-wrap: anywhere; }
h2 { margin: 2.5rem 0 .75rem; padding-bottom: .25rem; font-size: 1.2rem; border-bottom: 1px solid var(--line); }
h3 { margin: 1.5rem 0 .25rem; font-size: 1rem; }
a { color: var(--accent); }
header { display: grid; grid-template-columns: 1fr auto; gap: .25rem 1rem; align-items: center; }
header > * { grid-column: 1 / -1; }
header > h1, header > .verdict { grid-column: auto; }
.told { margin: 0; color: var(--faint); }
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
svg line.grid { stroke: var(--line); stroke-width: 1; }
rect.open { fill: var(--good-band); }
rect.closed { fill: var(--closed-band); fill-opacity: .9; }
rect.broken { fill: var(--broken-band); fill-opacity: .75; }
.wide { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .75rem .35rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 500; font-size: .9rem; }
th button { padding: 0; border: 0; background: none; color: inherit; font: inherit; text-align: left; cursor: pointer; }
[aria-sort=ascending] button::after { content: " \\25B2"; }
[aria-sort=descending] button::after { content: " \\25BC"; }
input, select { max-width: 100%; padding: .2rem .4rem; border: 1px solid var(--line); border-radius: .25rem;
  background: var(--panel); color: inherit; font: inherit; accent-color: var(--accent); }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 2px; }
.facts, details { font-size: .9rem; }
.facts td { overflow-wrap: anywhere; }
.facts td:first-child { width: 40%; color: var(--faint); }
summary { cursor: pointer; color: var(--accent); }
code, pre { font: .85em/1.45 ui-monospace, monospace; overflow-wrap: anywhere; }
pre { padding: .75rem 1rem; overflow-x: auto; background: var(--panel); border-radius: .5rem; }
@media print { :root { color-scheme: light; --ink: #000; --faint: #444; --paper: #fff; --line: #bbb; --accent: #5a4622;
  --good: #1b5e3a; --bad: #8c1d18; }
  body { font-size: 10pt; } main { max-width: none; padding: 0; } tr, figure, header { break-inside: avoid; }
  h2, h3 { break-after: avoid; } figure img { max-height: 12cm; } * { print-color-adjust: exact; }
  details::details-content { content-visibility: visible; height: auto; } }
"""
