"""What was measured on a result: numbers and verdict, distributions, curves, and places to look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats
from scaffold_pipeline.errors import StageError


@dataclass(frozen=True, eq=False)
class Histogram(Artifact):
    """How a length or another number is distributed: `shares` (n,) of the whole between `edges` (n + 1,), in `unit`."""

    name: str
    title: str
    unit: str
    edges: Floats
    shares: Floats

    def __post_init__(self) -> None:
        self.own_array("edges", np.float64, (None,))
        self.own_array("shares", np.float64, (max(len(self.edges) - 1, 0),))
        if not (np.diff(self.edges) > 0.0).all():
            raise StageError(f"Histogram.edges: must rise, those of {self.name} do not")
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Curve(Artifact):
    """A measured function: `y` (n,) over rising `x` (n,), each with what it is, its unit included."""

    name: str
    title: str
    x_title: str
    y_title: str
    x: Floats
    y: Floats

    def __post_init__(self) -> None:
        self.own_array("x", np.float64, (None,))
        self.own_array("y", np.float64, self.x.shape)
        if not (np.diff(self.x) > 0.0).all():
            raise StageError(f"Curve.x: must rise, that of {self.name} does not")
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Finding(Artifact):
    """What a printer or a reader should look at: the `rule` that found it, a line about it, `places` (n, 3) mm."""

    rule: str
    message: str
    places: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        self.own_array("places", np.float64, (None, 3))
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Metrics(Artifact):
    """What was measured on the finished solid, and the quality gates that it failed, one line a gate.

    Without `has_gates` nothing was judged, so that nothing has passed. `strut_thickness` (n,) mm is the local
    thickness at each vertex of the solid, NaN-free; empty where it was not measured.
    """

    values: Mapping[str, Fact]
    failed_gates: tuple[str, ...] = ()
    has_gates: bool = True
    histograms: tuple[Histogram, ...] = ()
    curves: tuple[Curve, ...] = ()
    findings: tuple[Finding, ...] = ()
    strut_thickness: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        self.own_array("strut_thickness", np.float64, (None,))
        super().__post_init__()

    def summary(self) -> dict[str, Fact]:
        """Return the metrics and the verdict."""
        passed = "pass" if self.has_gates else "not measured"
        return {**self.values, "quality": list(self.failed_gates) or passed}

    def details(self) -> dict[str, list[dict[str, Any]]]:
        """Return histograms, curves and findings as JSON holds them: what `measures.json` is made of."""
        return {name: [_plain(entry) for entry in getattr(self, name)] for name in ("histograms", "curves", "findings")}


def _plain(entry: Artifact) -> dict[str, Any]:
    values = {part.name: getattr(entry, part.name) for part in fields(entry)}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
