"""Declarations of a stage's results: its metrics by key, its quality gates, and the drawings that pages show.

A stage gives these to `@stage(...)`. The tables of pages, `metrics.json`, the README and the titles of gates come from
them, so that no other module names a metric, a gate or a picture.
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
    """A number that a stage measures: its key, unit, title and meaning.

    A metric of a plug-in appears on the page, in `metrics.json` and in the output of `stages --metrics` once it is
    declared, in the declaration of its stage:

        CURVATURE = Metric(
            "curvature_mean_per_mm", "mm\u207b\u00b9", "Mean curvature", "Cells prefer hollow walls.", section="Surface"
        )

        @stage(writes="metrics", version=1, metrics=(CURVATURE,))
        def measure_curvature(solid: Solid, *, params: MeasureCurvatureParams) -> Metrics:
            return Metrics({"curvature_mean_per_mm": ...}, has_gates=False)

    A stage whose facts are passed on by a measuring stage, such as a field's, declares them in the same way. A key
    that no stage declares is stored too, and listed at the end of the page by its key.

    Parameters
    ----------
    key
        The key in `metrics.json`. It may have placeholders, as `tortuosity_{axis}` has, and matches all keys that fill
        them; title and meaning may have the same placeholders. If several metrics match a key, the one with the longest
        literal text is used.
    unit
        `mm`, `mm\u00b2`, ...; empty for a share or a count.
    title
        The name for people.
    meaning
        Its meaning, in a sentence.
    section
        Heading of its table on the page; empty if it is only in the table of all metrics.
    symbol
        Its name in BoneJ and CTAn, if it has one: `Tb.Th`.
    method
        How it is computed, and its error. Metrics with the same text share a row of the README's table.
    shown_in
        `headline`: in large type at the top of the page; `caption`: under the pictures of a study.
    instead
        The key to use instead: the metric is deprecated, and no page shows it.

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
        """Number of characters of the key outside placeholders."""
        return len(_GAP.sub("", self.key))

    def at(self, key: str) -> Metric | None:
        """Return the metric with its placeholders filled for `key`; None if the key does not match."""
        gaps = _gaps(self.key, key)
        if not gaps:
            return self if gaps is not None else None
        title, meaning, instead = (_fill(text, gaps) for text in (self.title, self.meaning, self.instead))
        return replace(self, key=key, title=title, meaning=meaning, instead=instead)


@dataclass(frozen=True)
class Gate:
    """A quality gate of a stage: a condition on its metrics.

    Parameters
    ----------
    name
        The beginning of its lines in `Metrics.failed_gates` and `gates_not_applied`: `porosity: ...`.
    passed
        The condition, as a sentence that is true if the gate is passed.
    switch
        The stage's parameter that switches it on: true or false, or a required value or None.
    """

    name: str
    passed: str
    switch: str


@dataclass(frozen=True)
class Drawing:
    """A file of a stage, shown on pages.

    Parameters
    ----------
    file
        Its name: a PNG, an SVG, or the data of the 3-D view; it may have placeholders, as the key of a metric may.
    title
        The caption of the picture.
    meaning
        What it shows, used as the alternative text and as a note above the picture; may be empty.
    place
        `lead`: the picture of the solid at the top of the page; `view`: the data of the 3-D view, see
        `scaffold_pipeline.report.view.View`; `section`: with other sections, to one scale; `picture`: with all others.
    """

    file: str
    title: str
    meaning: str
    place: Literal["lead", "view", "section", "picture"] = "picture"

    def at(self, file: str) -> Drawing | None:
        """Return the drawing with its placeholders filled for `file`; None if the file does not match."""
        gaps = _gaps(self.file, file)
        if gaps is None:
            return None
        return replace(self, file=file, title=_fill(self.title, gaps), meaning=_fill(self.meaning, gaps))


@dataclass(frozen=True)
class Declared:
    """The declarations of several stages, as a record holds them; each of `gates` has the label of its stage.

    `viewers` are the names of stages that would add a 3-D view to a run without one.
    """

    metrics: tuple[Metric, ...] = ()
    gates: tuple[tuple[str, Gate], ...] = ()
    drawings: tuple[Drawing, ...] = ()
    viewers: tuple[str, ...] = ()

    def metric(self, key: str) -> Metric | None:
        """Return the declaration of a metric, its placeholders filled; None for an undeclared key."""
        return self._find(key)[1]

    def rank(self, key: str) -> int:
        """Return the position of a key in the order of the declarations; undeclared keys are last."""
        return self._find(key)[0]

    def _find(self, key: str) -> tuple[int, Metric | None]:
        if key not in self._found:
            fitting = [(number, at) for number, metric in enumerate(self.metrics) if (at := metric.at(key)) is not None]
            best = max(fitting, key=lambda pair: self.metrics[pair[0]].own_text, default=(len(self.metrics), None))
            self._found[key] = best
        return self._found[key]

    @cached_property
    def _found(self) -> dict[str, tuple[int, Metric | None]]:
        """Results of earlier searches by key: the points of a study have the same keys."""
        return {}

    def drawing(self, file: str) -> Drawing | None:
        """Return the declaration of a drawing, its placeholders filled; None for an undeclared file."""
        return next((found for drawing in self.drawings if (found := drawing.at(file)) is not None), None)

    def shown_in(self, place: str, keys: Iterable[str]) -> list[Metric]:
        """Return the metrics among `keys` that are shown in `place`, in the order of the declarations."""
        found = [self.metric(key) for key in sorted(keys, key=self.rank)]
        return [metric for metric in found if metric is not None and place in metric.shown_in]

    @classmethod
    def from_json(cls, payload: Mapping[str, Any]) -> Self:
        """Return declarations from the payload of `to_json`; entries unknown to this version are left out."""
        return cls(
            metrics=tuple(_read(Metric, entry) for entry in payload["metrics"]),
            gates=tuple((str(entry["stage"]), _read(Gate, entry)) for entry in payload["gates"]),
            drawings=tuple(_read(Drawing, entry) for entry in payload["drawings"]),
            viewers=tuple(map(str, payload["viewers"])),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the declarations as plain values for JSON."""
        return {
            "metrics": [_payload(metric) for metric in self.metrics],
            "gates": [{"stage": label, **_payload(gate)} for label, gate in self.gates],
            "drawings": [_payload(drawing) for drawing in self.drawings],
            "viewers": list(self.viewers),
        }


def _gaps(pattern: str, text: str) -> dict[str, str] | None:
    """Return the values of a pattern's placeholders for which it equals `text`; None if there are none."""
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
    """Return the fields that differ from their defaults, to keep the records of many points small."""
    given = {
        part.name: getattr(entry, part.name) for part in fields(entry) if getattr(entry, part.name) != part.default
    }
    return {name: list(value) if isinstance(value, tuple) else value for name, value in given.items()}
