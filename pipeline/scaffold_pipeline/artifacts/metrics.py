"""Measured values of a result: numbers, verdict, distributions, curves, and findings with their places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats
from scaffold_pipeline.errors import StageError


@dataclass(frozen=True, eq=False)
class Histogram(Artifact):
    """A distribution: `shares` (n,) of the whole between `edges` (n + 1,), in `unit`."""

    name: str
    title: str
    unit: str
    edges: Floats
    shares: Floats

    def __post_init__(self) -> None:
        self.own_array("edges", np.float64, (None,))
        self.own_array("shares", np.float64, (max(len(self.edges) - 1, 0),))
        if not (np.diff(self.edges) > 0.0).all():
            raise StageError(f"Histogram.edges: must be ascending, those of {self.name} are not")
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Curve(Artifact):
    """A measured function: `y` (n,) over ascending `x` (n,), each with a title that includes its unit."""

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
            raise StageError(f"Curve.x: must be ascending, that of {self.name} is not")
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Finding(Artifact):
    """Something to inspect before printing: the `rule` that found it, a line about it, its `places` (n, 3) mm."""

    rule: str
    message: str
    places: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        self.own_array("places", np.float64, (None, 3))
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class Metrics(Artifact):
    """The metrics of a result, and the quality gates that it failed, one line for each.

    Without `has_gates` there is no verdict. `strut_thickness` (n,) mm is the local thickness at each vertex of the
    solid, without NaN; empty if it was not measured.
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
        """Return histograms, curves and findings as plain values for `measures.json`."""
        return {name: [_plain(entry) for entry in getattr(self, name)] for name in ("histograms", "curves", "findings")}


def _plain(entry: Artifact) -> dict[str, Any]:
    values = {part.name: getattr(entry, part.name) for part in fields(entry)}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
