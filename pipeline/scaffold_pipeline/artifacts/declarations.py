"""What a stage says of what it gives: the metrics under their keys, the quality gates, the drawings that a page shows.

A stage hands these to `@stage(...)`. The tables of pages, `metrics.json`, the README and the words of gates are made
of them, so that no other place names a metric, a gate or a picture.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import Any, Literal, Self, TypeVar

_GAP = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True)
class Metric:
    """A number that a stage measures, and how it is told.

    A measure of a third party appears on the page, in `metrics.json` and in the README's kind of table by being
    declared beside what computes it, and named in the declaration of its stage:

        CURVATURE = Metric(
            "curvature_mean_per_mm", "mm\u207b\u00b9", "Mean curvature", "Cells prefer hollow walls.", section="Surface"
        )

        @stage(writes="metrics", version=1, metrics=(CURVATURE,))
        def measure_curvature(solid: Solid, *, params: MeasureCurvatureParams) -> Metrics:
            return Metrics({"curvature_mean_per_mm": ...}, has_gates=False)

    A stage whose facts another stage passes on, as fields' and outer shapes' are, declares these in the same way.
    A key that no stage declares is stored all the same, and listed at the end of the page by the key alone.

    Parameters
    ----------
    key
        The key in `metrics.json`. It may have gaps, `tortuosity_{axis}`, and stands for all keys that fill them; title
        and meaning may have the same gaps. Of several that fit a key, the one with the longest text of its own is
        taken.
    unit
        `mm`, `mm\u00b2`, ...; empty for a share or a count.
    title
        The name for people.
    meaning
        What it tells, in a sentence.
    section
        The heading of the page's table that it stands in; empty for the table of all metrics alone.
    symbol
        The name in BoneJ and CTAn, if it has one there: `Tb.Th`.
    method
        How it is computed, and how far off it may be. Metrics with the same text share a row of the README's table.
    shown_in
        `headline`: in large type at the top of the page; `caption`: under the pictures of a study.
    instead
        The key that is to be used instead: the metric is deprecated, and no page shows it.

    Examples
    --------
    >>> tortuosity = Metric("tortuosity_{axis}", "", "Tortuosity along {axis}", "How winding.", "Transport")
    >>> tortuosity.at("tortuosity_x").title, tortuosity.at("porosity")
    ('Tortuosity along x', None)
    """

    key: str
    unit: str
    title: str
    meaning: str
    section: str
    symbol: str = ""
    method: str = ""
    shown_in: tuple[Literal["headline", "caption"], ...] = ()
    instead: str = ""

    @property
    def own_text(self) -> int:
        """How many characters of the key are no gap."""
        return len(_GAP.sub("", self.key))

    def at(self, key: str) -> Metric | None:
        """Return the metric of that very key, its gaps filled; None where the key is another's."""
        gaps = _gaps(self.key, key)
        if not gaps:
            return self if gaps is not None else None
        title, meaning, instead = (_fill(text, gaps) for text in (self.title, self.meaning, self.instead))
        return replace(self, key=key, title=title, meaning=meaning, instead=instead)


@dataclass(frozen=True)
class Gate:
    """A quality gate of a stage: a condition that what it measured must keep.

    Parameters
    ----------
    name
        What the lines of `Metrics.failed_gates` and of `gates_not_applied` begin with: `porosity: ...`.
    passed
        What is so where the gate is passed, as a sentence.
    switch
        The stage's parameter that switches it on: true or false, or a value that is asked for, or none.
    """

    name: str
    passed: str
    switch: str


@dataclass(frozen=True)
class Drawing:
    """A file of a stage that pages show.

    Parameters
    ----------
    file
        Its name, a PNG, an SVG, or what the 3-D view is made of; it may have gaps, as the key of a metric may.
    title
        What it is called beneath the picture.
    meaning
        What it shows, for those who do not see it and as a hint above; may be empty.
    place
        `lead`: the picture that stands for the solid at the top of the page; `view`: what the 3-D view is made of, as
        `scaffold_pipeline.report.view.View` says; `section`: beside others to one scale; `picture`: with all others.
    """

    file: str
    title: str
    meaning: str
    place: Literal["lead", "view", "section", "picture"] = "picture"

    def at(self, file: str) -> Drawing | None:
        """Return the drawing of that very file; None where the file is another's."""
        gaps = _gaps(self.file, file)
        if gaps is None:
            return None
        return replace(self, file=file, title=_fill(self.title, gaps), meaning=_fill(self.meaning, gaps))


@dataclass(frozen=True)
class Declared:
    """What stages declare, as a record holds it: `gates` each with the label of its stage.

    `viewers` name the stages that would add a 3-D view where there is none.
    """

    metrics: tuple[Metric, ...] = ()
    gates: tuple[tuple[str, Gate], ...] = ()
    drawings: tuple[Drawing, ...] = ()
    viewers: tuple[str, ...] = ()

    def metric(self, key: str) -> Metric | None:
        """Return the declaration of a metric, its gaps filled; None for a key that none declares."""
        return self._find(key)[1]

    def rank(self, key: str) -> int:
        """Return where a key stands among all: in the order of the declarations, those that none declares last."""
        return self._find(key)[0]

    def _find(self, key: str) -> tuple[int, Metric | None]:
        if key not in self._found:
            fitting = [(number, at) for number, metric in enumerate(self.metrics) if (at := metric.at(key)) is not None]
            best = max(fitting, key=lambda pair: self.metrics[pair[0]].own_text, default=(len(self.metrics), None))
            self._found[key] = best
        return self._found[key]

    @cached_property
    def _found(self) -> dict[str, tuple[int, Metric | None]]:
        """What was found of each key so far: the points of a study have the same keys."""
        return {}

    def drawing(self, file: str) -> Drawing | None:
        """Return the declaration of a drawing, its gaps filled; None for a file that none declares."""
        return next((found for drawing in self.drawings if (found := drawing.at(file)) is not None), None)

    def shown_in(self, place: str, keys: Iterable[str]) -> list[Metric]:
        """Return the metrics of those keys that are shown in a place, in the order of the declarations."""
        found = [self.metric(key) for key in sorted(keys, key=self.rank)]
        return [metric for metric in found if metric is not None and place in metric.shown_in]

    @classmethod
    def from_json(cls, payload: Mapping[str, Any]) -> Self:
        """Return what `to_json` gave; names that this version does not know are left out."""
        return cls(
            metrics=tuple(_read(Metric, entry) for entry in payload["metrics"]),
            gates=tuple((str(entry["stage"]), _read(Gate, entry)) for entry in payload["gates"]),
            drawings=tuple(_read(Drawing, entry) for entry in payload["drawings"]),
            viewers=tuple(map(str, payload["viewers"])),
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return {
            "metrics": [_payload(metric) for metric in self.metrics],
            "gates": [{"stage": label, **_payload(gate)} for label, gate in self.gates],
            "drawings": [_payload(drawing) for drawing in self.drawings],
            "viewers": list(self.viewers),
        }


def _gaps(pattern: str, text: str) -> dict[str, str] | None:
    """Return what fills the gaps of a pattern where it becomes that text; None where it cannot."""
    found = _compile(pattern).fullmatch(text)
    return None if found is None else found.groupdict()


@cache
def _compile(pattern: str) -> re.Pattern[str]:
    parts = _GAP.split(pattern)
    return re.compile(
        "".join(f"(?P<{part}>.+)" if number % 2 else re.escape(part) for number, part in enumerate(parts))
    )


def _fill(text: str, gaps: Mapping[str, str]) -> str:
    return _GAP.sub(lambda gap: gaps.get(gap[1], gap[0]), text)


Kind = TypeVar("Kind", Metric, Gate, Drawing)


def _read(kind: type[Kind], entry: Mapping[str, Any]) -> Kind:
    known = {part.name for part in fields(kind)}
    values: Any = {
        name: tuple(value) if isinstance(value, list) else value for name, value in entry.items() if name in known
    }
    return kind(**values)


def _payload(entry: Metric | Gate | Drawing) -> dict[str, Any]:
    """Return what differs from the defaults: records of many points stay small."""
    told = {part.name: getattr(entry, part.name) for part in fields(entry) if getattr(entry, part.name) != part.default}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in told.items()}
