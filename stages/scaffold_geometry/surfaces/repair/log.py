"""The log of a repair, in words and numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from scaffold_pipeline.artifacts import Fact, Metric

METRICS = (
    Metric("repair_mode", "", "Repair", "The repair mode of the input.", ""),
    Metric("repair_grid_mm", "mm", "Repair, grid", "Voxel size of the rebuilt surface.", ""),
    Metric("repair_{what}", "", "Repair, {what}", "Number of these repairs of the input, or distance moved.", ""),
)
"""The metrics of a log's facts, each with the prefix `repair_`."""


class RepairOp(NamedTuple):
    """A repair: the name of the fact that counts it, and a sentence with a `{}` for the number."""

    name: str
    note: str


MERGED = RepairOp("vertices_merged", "merged {} coincident vertices")
TWICE = RepairOp("triangles_of_two_corners_dropped", "dropped {} triangles that use a vertex twice")
DOUBLE = RepairOp("duplicate_triangles_dropped", "dropped {} duplicate triangles")
TURNED = RepairOp("triangles_turned", "reoriented {} triangles to agree with their neighbours")

OpCounts: TypeAlias = Counter[RepairOp]
"""Number of each repair."""


@dataclass(frozen=True)
class RepairLog:
    """The repairs in words, their numbers by the name of the fact, and further measured facts."""

    notes: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    measures: dict[str, Fact] = field(default_factory=dict)

    @property
    def facts(self) -> dict[str, Fact]:
        """The counts and measured facts."""
        return {**self.counts, **self.measures}

    def count(self, op: RepairOp, number: int) -> None:
        """Add a repair that was done `number` times, unless it is 0."""
        if number:
            self.notes.append(op.note.format(number))
            self.counts[op.name] += number

    def count_all(self, done: OpCounts) -> None:
        """Add several repairs."""
        for op, number in done.items():
            self.count(op, number)

    def add(self, other: RepairLog) -> None:
        """Add the entries of another log; counts are summed."""
        self.notes.extend(other.notes)
        self.counts.update(other.counts)
        self.measures.update(other.measures)
