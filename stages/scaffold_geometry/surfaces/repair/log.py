"""What a repair did to a surface, in words and by number."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from scaffold_pipeline.artifacts import Fact, Metric

METRICS = (
    Metric("repair_mode", "", "Repair", "How far the repair of the input was allowed to go.", ""),
    Metric("repair_grid_mm", "mm", "Repair, grid", "Voxels of the surface that was built anew.", ""),
    Metric("repair_{what}", "", "Repair, {what}", "How often this was done to the input, or how far it moved it.", ""),
)
"""What the facts of a log are told as, each with `repair_` before its name."""


class RepairOp(NamedTuple):
    """What can be done: the name of the fact that counts it, and a sentence with a `{}` for the number."""

    name: str
    said: str


MERGED = RepairOp("vertices_merged", "merged {} coincident vertices")
TWICE = RepairOp("triangles_of_two_corners_dropped", "dropped {} triangles that use a vertex twice")
DOUBLE = RepairOp("duplicate_triangles_dropped", "dropped {} duplicate triangles")
TURNED = RepairOp("triangles_turned", "turned {} triangles that were wound against their neighbours")

OpCounts: TypeAlias = Counter[RepairOp]
"""How often what was done."""


@dataclass(frozen=True)
class RepairLog:
    """What was done: in words, how often by the name of the fact, and what was measured of it."""

    notes: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    measures: dict[str, Fact] = field(default_factory=dict)

    @property
    def facts(self) -> dict[str, Fact]:
        """What was counted and measured."""
        return {**self.counts, **self.measures}

    def count(self, op: RepairOp, number: int) -> None:
        """Note what was done so many times, unless that is none."""
        if number:
            self.notes.append(op.said.format(number))
            self.counts[op.name] += number

    def count_all(self, done: OpCounts) -> None:
        """Note all that was done."""
        for op, number in done.items():
            self.count(op, number)

    def add(self, other: RepairLog) -> None:
        """Take over what another log has; counts add up."""
        self.notes.extend(other.notes)
        self.counts.update(other.counts)
        self.measures.update(other.measures)
