"""What a repair did to a surface, in words and by number."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from scaffold_pipeline.artifacts import Fact


class Deed(NamedTuple):
    """What can be done: the name of the fact that counts it, and a sentence with a `{}` for the number."""

    name: str
    said: str


MERGED = Deed("vertices_merged", "merged {} coincident vertices")
TWICE = Deed("triangles_of_two_corners_dropped", "dropped {} triangles that use a vertex twice")
DOUBLE = Deed("duplicate_triangles_dropped", "dropped {} duplicate triangles")
TURNED = Deed("triangles_turned", "turned {} triangles that were wound against their neighbours")

Done: TypeAlias = Counter[Deed]
"""How often what was done."""


@dataclass(frozen=True)
class Account:
    """What was done: in words, how often by the name of the fact, and what was measured of it."""

    notes: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    measures: dict[str, Fact] = field(default_factory=dict)

    @property
    def facts(self) -> dict[str, Fact]:
        """What was counted and measured."""
        return {**self.counts, **self.measures}

    def count(self, deed: Deed, number: int) -> None:
        """Note what was done so many times, unless that is none."""
        if number:
            self.notes.append(deed.said.format(number))
            self.counts[deed.name] += number

    def count_all(self, done: Done) -> None:
        """Note all that was done."""
        for deed, number in done.items():
            self.count(deed, number)

    def add(self, other: Account) -> None:
        """Take over what another account has; counts add up."""
        self.notes.extend(other.notes)
        self.counts.update(other.counts)
        self.measures.update(other.measures)
