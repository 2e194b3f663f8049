"""The page of a study: `study.html`, self-contained, and `sheet.png`, all pictures in one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

from scaffold_pipeline.artifacts import Declared
from scaffold_pipeline.report.declared import declared_here, stages_that_draw
from scaffold_pipeline.report.rendering import render, to_data_uri
from scaffold_pipeline.report.wording import failed_gates, to_name, to_text
from scaffold_pipeline.runs.store import write_atomically
from scaffold_pipeline.studies.file import Study
from scaffold_pipeline.studies.table import TABLE, PointState, to_cell, to_table

if TYPE_CHECKING:
    from PIL.Image import Image

    from scaffold_pipeline.report.contact_sheet import Cell

PAGE = "study.html"
SHEET = "sheet.png"

_MOST_ON_PAPER = 14
"""Most columns of a table that fit on a printed page."""

_LONG = 60
"""Characters above which a cell of the table is made wide."""

_MOST_VALUES = 12
"""Most values of a varied parameter that are listed; otherwise their number is shown."""

MOST_ON_SHEET = 120
"""Most points on `sheet.png`: a larger picture does not open in many programs."""

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
    """A point on the page and the sheet: its state, and the caption from its config."""

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
    def summary(self) -> str:
        """The metrics and the state of the point, in words; the table has the full lines of the gates."""
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
    """Write the page and the sheet of a study into its folder; its subfolder `points` has the run directories.

    Without pictures no sheet is written.
    """
    declared = declared_here()
    captions = {point.name: point.caption for point in study.points}
    cards = [Card(state, captions[state.name], declared) for state in states]
    shown: list[ShownCard] = []
    cells: list[Cell] = []
    for card in cards:
        pictures = _pictures(card, out / points / card.state.name)
        shown.append(_show(card, pictures, f"{points}/{quote(card.state.name)}"))
        if len(cells) < MOST_ON_SHEET:
            cells.append(_cell(card, pictures))
    has_sheet = _write_sheet(out / SHEET, study.name, cells, len(cards))
    has_pictures = any(card.pictures for card in shown)
    page = render(
        "study.html.j2",
        styles=("page.css", "study.css"),
        scripts=("tables.js", "study_page.js"),
        **_headline(study, cards),
        sheet=SHEET if has_sheet else None,
        has_pictures=has_pictures,
        drawing_stages=() if has_pictures else stages_that_draw(".png"),
        shows_cards=has_pictures or any(captions.values()),
        cards=shown,
        **_table(study, cards),
    )
    write_atomically(out / PAGE, lambda stream: stream.write(page.encode()))


def _pictures(card: Card, folder: Path) -> dict[str, Image | None]:
    """Return thumbnails of the pictures of a run; None for one that cannot be read."""
    from scaffold_pipeline.report.contact_sheet import in_order, thumbnail

    names = in_order(list(card.state.record.get("files", ())), card.declared.drawings)
    return {name: thumbnail(folder / name) for name in names}


def _cell(card: Card, pictures: Mapping[str, Image | None]) -> Cell:
    from scaffold_pipeline.report.contact_sheet import Cell

    lines = tuple(line for line in (card.caption, card.summary) if line)
    return Cell(card.state.name, lines, tuple(picture for picture in pictures.values() if picture))


def _write_sheet(path: Path, name: str, cells: Sequence[Cell], count: int) -> bool:
    """Write the sheet if there are pictures, and return whether it was written."""
    from scaffold_pipeline.report.contact_sheet import draw_sheet

    if not any(cell.pictures for cell in cells):
        path.unlink(missing_ok=True)
        return False
    title = name if len(cells) == count else f"{name}: the first {len(cells)} of {count} points"
    sheet = draw_sheet(title, cells)
    write_atomically(path, lambda stream: sheet.save(stream, "PNG"))
    return True


class Verdict(NamedTuple):
    """The state of some points, as a style and in words."""

    kind: str
    words: str


def _headline(study: Study, cards: Sequence[Card]) -> dict[str, object]:
    counts = Counter(card.verdict for card in cards)
    verdicts = [
        Verdict(_COLOURS.get(kind, "unknown"), f"{counts[kind]} {words}")
        for kind, words in _VERDICTS.items()
        if counts[kind]
    ]
    varied = list(_varied_values(study, cards))
    return {"name": study.name, "caption": study.caption, "verdicts": verdicts, "varied": varied}


def _varied_values(study: Study, cards: Sequence[Card]) -> Iterator[tuple[str, str]]:
    """Yield the varied parameters, each with its values."""
    for column in study.columns:
        values = dict.fromkeys(to_cell(card.state.varied.get(column)) or "left out" for card in cards)
        yield column, ", ".join(values) if len(values) <= _MOST_VALUES else f"{len(values)} values"


class ShownPicture(NamedTuple):
    """A thumbnail with a link to the picture; without a source it cannot be read."""

    link: str
    about: str
    source: str


class ShownCard(NamedTuple):
    """The values of a point for the template; `page` links to the page of its run."""

    name: str
    page: str
    caption: str
    colour: str
    summary: str
    pictures: list[ShownPicture]


def _show(card: Card, pictures: Mapping[str, Image | None], folder: str) -> ShownCard:
    from scaffold_pipeline.report.contact_sheet import to_jpeg

    name = card.state.name
    return ShownCard(
        name=name,
        page=f"{folder}/report.html" if card.state.status == "done" else "",
        caption=card.caption,
        colour=_COLOURS.get(card.verdict, "unknown"),
        summary=card.summary,
        pictures=[
            ShownPicture(
                f"{folder}/{quote(file)}",
                f"{name}: {file}",
                to_data_uri("image/jpeg", to_jpeg(picture)) if picture else "",
            )
            for file, picture in pictures.items()
        ],
    )


def _table(study: Study, cards: Sequence[Card]) -> dict[str, object]:
    """Return the values for the table, and for the script, with the columns that it plots first."""
    titles, rows = to_table(study.columns, [card.state for card in cards])
    plain = [[value if isinstance(value, int | float | None) else to_cell(value) for value in row] for row in rows]
    first = next((metric.key for card in cards for metric in card.declared.shown_in("caption", titles)), "")
    return {
        "csv": TABLE,
        "titles": [re.split(r"(?<=[._])", title) for title in titles],
        "rows": [
            [_shown(to_name(value) if title == "seed" else value) for title, value in zip(titles, row, strict=True)]
            for row in rows
        ],
        "is_wide": len(titles) > _MOST_ON_PAPER,
        "most": _LONG,
        "data": {"titles": titles, "varied": len(study.columns), "rows": plain, "first": first},
    }


def _shown(value: object) -> str:
    """Return a value as text; empty if it is missing, as in `table.csv`."""
    return to_text(value) if isinstance(value, bool | int | float) else to_cell(value)
