"""A study for people: `study.html`, one self-contained page, and `sheet.png`, its pictures as one."""

from __future__ import annotations

import re
from base64 import b64encode
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from scaffold_pipeline.artifacts import Declared
from scaffold_pipeline.report.declared import declared_here, stages_that_draw
from scaffold_pipeline.report.markup import TABLES, document, harmless_json, section, table, text_of
from scaffold_pipeline.report.wording import failed_gates, to_name, to_text
from scaffold_pipeline.run.store import write_atomically
from scaffold_pipeline.study.file import Study
from scaffold_pipeline.study.table import TABLE, PointState, to_cell, to_table

if TYPE_CHECKING:
    from PIL.Image import Image

    from scaffold_pipeline.report.contact_sheet import Cell

PAGE = "study.html"
SHEET = "sheet.png"

_MOST_ON_PAPER = 14
"""Columns of a table that a printed page has room for."""

_LONG = 60
"""Characters from which on a cell of the table is made wide."""

_MOST_VALUES = 12
"""Values of what varied that are listed; of more the number is told."""

MOST_ON_SHEET = 120
"""Points on `sheet.png`: with more it is larger than what programs open."""

_SCRIPT = Path(__file__).parents[1] / "report" / "study_page.js"
_VERDICTS = {
    "pass": "passed",
    "fail": "failed a quality gate",
    "error": "failed with an error",
    "unknown": "without quality gates",
    "waiting": "not run",
}
_COLOURS = {"pass": "pass", "fail": "fail", "error": "fail"}


@dataclass(frozen=True)
class Card:
    """A point as the page and the sheet show it: its state, and what its config says of itself."""

    state: PointState
    caption: str
    declared: Declared

    @property
    def verdict(self) -> str:
        """The key of `_VERDICTS`."""
        if self.state.status != "done":
            return "error" if self.state.status == "failed" else "waiting"
        gates = failed_gates(self.state.metrics.get("quality"))
        return "unknown" if gates is None else "fail" if gates else "pass"

    @property
    def told(self) -> str:
        """What was measured and what became of the point, in words; the table has the whole of each gate."""
        metrics = self.state.metrics
        facts = {metric.key: metrics[metric.key] for metric in self.declared.shown_in("caption", metrics)}
        ends = {
            "pass": "quality pass",
            "fail": f"quality gates failed: {', '.join(gate.partition(':')[0] for gate in self.state.gates)}",
            "error": f"failed: {self.state.error}",
        }
        measured = [f"{key} {to_text(value)}" for key, value in facts.items() if value is not None]
        return ", ".join([*measured, ends.get(self.verdict, _VERDICTS[self.verdict])])


def write_page(out: Path, study: Study, states: Sequence[PointState], points: str) -> None:
    """Write the page and the sheet of a study into its folder, whose folder `points` holds the run directories.

    Without any picture there is no sheet.
    """
    captions = {point.name: point.caption for point in study.points}
    declared = declared_here()
    cards = [Card(state, captions[state.name], declared) for state in states]
    shown: list[str] = []
    cells: list[Cell] = []
    has_pictures = False
    for card in cards:
        pictures = _pictures(card, out / points / card.state.name)
        shown.append(_card(card, pictures, f"{points}/{quote(card.state.name)}"))
        has_pictures |= bool(pictures)
        if len(cells) < MOST_ON_SHEET:
            cells.append(_cell(card, pictures))
    has_sheet = _write_sheet(out / SHEET, study.name, cells, len(cards))
    intro = _SHEET_LINK if has_sheet else "" if has_pictures else _what_draws()
    is_told = has_pictures or any(captions.values())
    page = _page(study, cards, intro + (f'<div class="cards">\n{"".join(shown)}\n</div>' if is_told else ""))
    write_atomically(out / PAGE, lambda stream: stream.write(page.encode()))


def _pictures(card: Card, folder: Path) -> dict[str, Image | None]:
    """Return the pictures among the files of a run, made small; None for one that cannot be read."""
    from scaffold_pipeline.report.contact_sheet import in_order, thumbnail

    names = in_order(list(card.state.record.get("files", ())), card.declared.drawings)
    return {name: thumbnail(folder / name) for name in names}


def _what_draws() -> str:
    names = ", ".join(f"<code>{text_of(name)}</code>" for name in stages_that_draw(".png"))
    return f'<p class="none">No picture was drawn: the stages {names} draw them.</p>\n'


def _cell(card: Card, pictures: Mapping[str, Image | None]) -> Cell:
    from scaffold_pipeline.report.contact_sheet import Cell

    lines = tuple(line for line in (card.caption, card.told) if line)
    return Cell(card.state.name, lines, tuple(picture for picture in pictures.values() if picture))


def _write_sheet(path: Path, name: str, cells: Sequence[Cell], count: int) -> bool:
    """Write the sheet where there is any picture, and return whether."""
    from scaffold_pipeline.report.contact_sheet import draw_sheet

    if not any(cell.pictures for cell in cells):
        path.unlink(missing_ok=True)
        return False
    title = name if len(cells) == count else f"{name}: the first {len(cells)} of {count} points"
    sheet = draw_sheet(title, cells)
    write_atomically(path, lambda stream: sheet.save(stream, "PNG"))
    return True


def _page(study: Study, cards: Sequence[Card], contact_sheet: str) -> str:
    states = [card.state for card in cards]
    titles, rows = to_table(study.columns, states)
    sections = (
        _headline(study, cards),
        section("Contact sheet", contact_sheet),
        section("Table", _table(titles, rows)),
        _PLOT,
        _data(titles, study, rows, cards),
    )
    script = TABLES.read_text(encoding="utf-8") + _SCRIPT.read_text(encoding="utf-8")
    return document(study.name, sections, style=_STYLE, script=script)


def _headline(study: Study, cards: Sequence[Card]) -> str:
    counts = Counter(card.verdict for card in cards)
    verdicts = "".join(
        f'<p class="verdict {_COLOURS.get(kind, "unknown")}">{counts[kind]} {words}</p>'
        for kind, words in _VERDICTS.items()
        if counts[kind]
    )
    varied = "".join(
        f"<li><code>{text_of(name)}</code>: {values}</li>" for name, values in _varied_values(study, cards)
    )
    return (
        f'<header>\n<h1>{text_of(study.name)}</h1>\n<div class="verdicts">{verdicts}</div>\n'
        f'<p class="told">{text_of(study.caption) if study.caption else ""}</p>\n'
        f'<ul class="told">{varied}</ul>\n</header>'
    )


def _varied_values(study: Study, cards: Sequence[Card]) -> Iterator[tuple[str, str]]:
    """Yield what varied, each with its values, escaped."""
    for column in study.columns:
        values = dict.fromkeys(to_cell(card.state.varied.get(column)) or "left out" for card in cards)
        yield column, escape(", ".join(values)) if len(values) <= _MOST_VALUES else f"{len(values)} values"


def _card(card: Card, pictures: Mapping[str, Image | None], folder: str) -> str:
    from scaffold_pipeline.report.contact_sheet import to_jpeg

    name, shown = escape(card.state.name), []
    for file, picture in pictures.items():
        link, what = f"{folder}/{quote(file)}", escape(f"{card.state.name}: {file}")
        source = f"data:image/jpeg;base64,{b64encode(to_jpeg(picture)).decode()}" if picture else ""
        image = f'<img alt="{what}" src="{source}">' if source else f'<span class="none">{what} cannot be read</span>'
        shown.append(f'<a href="{link}">{image}</a>')
    drawn = "".join(shown) or '<span class="none">no picture</span>'
    title = f'<a href="{folder}/report.html">{name}</a>' if card.state.status == "done" else name
    caption = f"<p>{escape(card.caption)}</p>" if card.caption else ""
    verdict = f'<p class="{_COLOURS.get(card.verdict, "unknown")}">{escape(card.told)}</p>'
    return (
        f'<figure class="card"><div class="pictures">{drawn}</div>'
        f"<figcaption><h3>{title}</h3>{caption}{verdict}</figcaption></figure>"
    )


def _table(titles: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    cells = [
        [_shown(to_name(value) if title == "seed" else value) for title, value in zip(titles, row, strict=True)]
        for row in rows
    ]
    heads = [re.sub(r"(?<=[._])", "<wbr>", escape(title)) for title in titles]
    kind = "points" if len(titles) <= _MOST_ON_PAPER else "points too-wide"
    return _TABLE_INTRO + table(heads, cells, kind)


def _shown(value: object) -> str:
    """Return a value as people read it, escaped; nothing where there is none, as in `table.csv`."""
    if isinstance(value, bool | int | float):
        return escape(to_text(value))
    text = to_cell(value)
    return escape(text) if len(text) <= _LONG else f'<div class="long">{escape(text)}</div>'


def _data(titles: Sequence[str], study: Study, rows: Sequence[Sequence[object]], cards: Sequence[Card]) -> str:
    """Return the table for the script, and what it plots first."""
    first = next((metric.key for card in cards for metric in card.declared.shown_in("caption", titles)), "")
    plain = [[value if isinstance(value, int | float | None) else to_cell(value) for value in row] for row in rows]
    return harmless_json("data", {"titles": titles, "varied": len(study.columns), "rows": plain, "first": first})


_SHEET_LINK = f'<p class="meaning">As one picture: <a href="{SHEET}">{SHEET}</a></p>\n'
_TABLE_INTRO = (
    f'<p class="meaning">For other programs: <a href="{TABLE}">{TABLE}</a></p>\n'
    '<p id="filter" hidden><label>Points with the words <input type="search"></label> '
    '<output class="meaning" aria-live="polite"></output></p>\n'
)
_PLOT = """<section id="plot" hidden>
<h2>Plot</h2>
<p><label>Of <select id="y"></select></label> <label>against <select id="x"></select></label>
<label>lines by <select id="by"></select></label></p>
<figure><svg role="img"></svg><figcaption></figcaption></figure>
</section>
<noscript><p class="none">Sorting, filtering and plotting need JavaScript; all is in the table.</p></noscript>"""

_STYLE = """
main { max-width: 90rem; }
header ul { padding-left: 1.2rem; }
.verdicts { display: flex; flex-wrap: wrap; gap: .5rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(22rem, 1fr)); gap: 1.5rem; }
.card { margin: 0; break-inside: avoid; }
.pictures { display: flex; gap: .5rem; align-items: center; justify-content: center; min-height: 8rem;
  padding: .5rem; background: #fff; border: 1px solid var(--line); border-radius: .5rem; }
.pictures a { flex: 0 1 20rem; min-width: 0; }
.pictures .none { color: #667080; }
.pictures img { max-height: none; padding: 0; border: 0; border-radius: 0; }
.card h3 { margin: .5rem 0 0; font-size: 1rem; overflow-wrap: anywhere; }
.card p { margin: .25rem 0 0; }
.points { font-size: .85rem; }
.points th, .points td { padding-right: 1rem; overflow-wrap: break-word; }
.points td:first-child { min-width: 12rem; }
.points .long { width: 36rem; }
polyline { fill: none; stroke: var(--own); stroke-width: 2.5; }
circle { fill: var(--own); }
.key { margin-left: .75rem; }
.key::before { content: "\\25CF "; color: var(--own); }
.g0 { --own: #c0392b; } .g1 { --own: #2f6f9f; } .g2 { --own: #24824a; }
.g3 { --own: #a8741a; } .g4 { --own: #8e5aa8; } .g5 { --own: #4a8f95; }
.g1 polyline { stroke-dasharray: 9 5; }
@media screen and (prefers-color-scheme: dark) { .g0 { --own: #f0776a; } .g1 { --own: #7db4de; }
  .g2 { --own: #6fce9a; } .g3 { --own: #e3b866; } .g4 { --own: #c79add; } .g5 { --own: #86c5ca; } }
@media print { #filter, .too-wide { display: none; } .cards { grid-template-columns: 1fr 1fr; gap: .75rem; }
  .points { font-size: 6pt; } .points th, .points td { padding-right: .25rem; overflow-wrap: anywhere; } }
"""
