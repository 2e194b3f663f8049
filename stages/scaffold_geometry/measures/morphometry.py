"""Morphometry of struts and pores, and throats, measured on voxels.

Names are those of this project; beside them stand BoneJ's (R. Domander, A. A. Felder, M. Doube, Wellcome Open Research
6 (2021) 37): Tb.Th strut thickness, Tb.Sp pore size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints, Singles
from scaffold_geometry.measures.accessibility import Accessibility, accessibility, reachable_share
from scaffold_geometry.measures.declarations import place_facts, place_metrics
from scaffold_geometry.measures.local_thickness import (
    LEAST_RESOLVED,
    PERCENTILES,
    Distribution,
    distribution,
    is_resolved,
    local_thickness,
    thickness_at,
)
from scaffold_geometry.voxels.image import PORE, STRUT, VoxelImage
from scaffold_geometry.voxels.voxelising import finest_spacing, voxelise
from scaffold_pipeline.artifacts import Curve, Fact, Histogram, Metric, SurfaceMesh
from scaffold_pipeline.errors import warn

MOST_VOXELS = 512**3
"""Most voxels of an image: thickness and accessibility need 2 GB of memory for these."""

_USUAL_VOXELS = 1e7
"""Most voxels by default: ten seconds on two cores."""

_FINER = 4.0
"""Voxels across the mean strut or pore that a refinement aims at, where there were fewer than three."""

_CURVE_POINTS = 200

_BALLS = (
    "greatest ball over each voxel (Hildebrand, R\u00fcegsegger): a voxel at most, half a voxel in the mean; the outer "
    "shape is a wall"
)
_WAYS = (
    "widest ball that reaches that share of the pores from outside, and the neck that stops a wider one; the share "
    "that a ball of `probes` reaches: a voxel"
)


def _metrics_of_balls(
    name: str, title: str, symbol: str, section: str, phase: str, less: str, more: str
) -> tuple[Metric, ...]:
    """Return the declarations of a distribution of local thickness."""

    def metric(key: str, what: str, meaning: str, *, is_shown: bool = True) -> Metric:
        heading = section if is_shown else ""
        return Metric(f"{name}_{key}", "mm", f"{title}, {what}", meaning, heading, symbol=symbol, method=_BALLS)

    mean = metric("mean", "mean", f"The greatest ball in the {phase} about each point, on average; {symbol}.")
    return (
        replace(mean, shown_in=("headline",)),
        metric("median", "median", f"Half of the {phase} is {less}."),
        metric("mad", "median deviation", "Half of all is nearer to the median.", is_shown=False),
        metric("p5", "5th percentile", f"A twentieth of the {phase} is {less}."),
        metric("p25", "25th percentile", f"A quarter of the {phase} is {less}.", is_shown=False),
        metric("p75", "75th percentile", f"A quarter of the {phase} is {more}.", is_shown=False),
        metric("p95", "95th percentile", f"A twentieth of the {phase} is {more}."),
    )


METRICS = (
    *_metrics_of_balls("strut_thickness", "Strut thickness", "Tb.Th", "Struts", "solid", "thinner", "thicker"),
    *_metrics_of_balls("pore_size", "Pore size", "Tb.Sp", "Pores", "pore space", "narrower", "wider"),
    Metric(
        "throat_50",
        "mm",
        "Throat to half of the pores",
        "The largest ball that reaches half of the pore space.",
        "Pores",
        method=_WAYS,
    ),
    Metric(
        "throat_90",
        "mm",
        "Throat to nine tenths of the pores",
        "The largest ball that reaches nine tenths of it.",
        "Pores",
        method=_WAYS,
    ),
    Metric(
        "throat_99",
        "mm",
        "Throat to nearly all pores",
        "The largest ball that reaches 99 % of it.",
        "Pores",
        method=_WAYS,
    ),
    *place_metrics(
        "throat_{share}", "Place of the throat to {share} % of the pores", "The neck that stops a wider ball.", _WAYS
    ),
    Metric(
        "accessible_to_{probe}_mm",
        "",
        "Pores open to {probe} mm",
        "Share of the pore space that a ball of this diameter reaches from outside.",
        "Pores",
        method=_WAYS,
    ),
)
"""The metrics of `morphometry`, except the next."""

VOXEL_SIZE = Metric(
    "measure_voxel_size",
    "mm",
    "Voxel size of the measures",
    "Thicknesses and sizes are off by one at most.",
    "How it was computed",
)


class Morphometry(NamedTuple):
    """Numbers, distributions and curves, the strut thickness at the points asked for, (n,) mm, and the image."""

    values: dict[str, Fact]
    histograms: tuple[Histogram, ...]
    curves: tuple[Curve, ...]
    strut_thickness: Floats
    image: VoxelImage


class _Phases(NamedTuple):
    """An image, the local thickness of its struts, (nx, ny, nz) mm, and how it is distributed, as that of its pores."""

    image: VoxelImage
    thickness: Singles
    struts: Distribution | None
    pores: Distribution | None

    @property
    def finest(self) -> float:
        """The lesser of both means, mm."""
        return min((found.mean for found in (self.struts, self.pores) if found), default=np.inf)


def usual_spacing(outer: SurfaceMesh, of_field: float) -> float:
    """Return half the spacing of the field that a solid was made of, or more where that makes too many voxels.

    A surface lies between a field's samples: finer voxels still tell more of it. Never more than the field's own, mm.
    """
    return min(of_field, max(of_field / 2.0, finest_spacing(outer.bounds, _USUAL_VOXELS)))


def morphometry(
    solid: SurfaceMesh, outer: SurfaceMesh, spacing: float, *, may_refine: bool, probes: Sequence[float], at: Floats
) -> Morphometry:
    """Measure struts and pores of a `solid` in its `outer` shape on voxels of `spacing` mm, 512^3 at most.

    Where the mean strut or pore has fewer than three voxels, finer ones are taken if they may and are few enough;
    otherwise unresolved values are None, with a `PipelineWarning`. `probes` are diameters, mm, for the accessible share
    of the pore space; `at` (n, 3) mm are points at which the strut thickness is returned.
    """
    phases = _resolve_phases(solid, outer, spacing, may_refine=may_refine)
    image = phases.image
    ways = accessibility(image)
    values: dict[str, Fact] = {"measure_voxel_size": image.spacing}
    histograms = []
    for name, title, found in (
        ("strut_thickness", "Strut thickness (Tb.Th)", phases.struts),
        ("pore_size", "Pore size (Tb.Sp)", phases.pores),
    ):
        told = found if found is not None and _is_told(name, found, image.spacing) else None
        values |= _facts(name, told)
        if told is not None:
            histograms.append(Histogram(name, title, "mm", told.edges, told.shares))
    at_points = thickness_at(image, phases.thickness, at)
    return Morphometry(values | _ways_facts(ways, probes), tuple(histograms), tuple(_curves(ways)), at_points, image)


def _resolve_phases(solid: SurfaceMesh, outer: SurfaceMesh, spacing: float, *, may_refine: bool) -> _Phases:
    """Return the phases on voxels of `spacing`, or as much finer as they have to be for both."""
    finest = finest_spacing(outer.bounds, MOST_VOXELS)
    spacing = max(spacing, finest)
    while True:
        phases = _phases(solid, outer, spacing)
        finer = max(phases.finest / _FINER, finest)
        if not may_refine or is_resolved(phases.finest, spacing) or finer >= spacing:
            return phases
        spacing = finer


def _phases(solid: SurfaceMesh, outer: SurfaceMesh, spacing: float) -> _Phases:
    image = voxelise((solid.vertices, solid.faces), (outer.vertices, outer.faces), spacing)
    pores = distribution(image, PORE, local_thickness(image.is_phase(PORE), spacing))
    thickness = local_thickness(image.is_phase(STRUT), spacing)
    return _Phases(image, thickness, distribution(image, STRUT, thickness), pores)


def _is_told(name: str, found: Distribution, spacing: float) -> bool:
    if is_resolved(found.mean, spacing):
        return True
    warn(
        f"{name}: not measured, as its mean of {found.mean:.3g} mm is {found.mean / spacing:.2g} voxels of "
        f"{spacing:.3g} mm, where {LEAST_RESOLVED:g} are needed; set voxel_size of measure to "
        f"{found.mean / LEAST_RESOLVED:.2g} mm"
    )
    return False


def _facts(name: str, found: Distribution | None) -> dict[str, Fact]:
    """Return the facts of a distribution, mm; None where it is not told."""
    keys = ("mean", "median", "mad", *(f"p{percentile:g}" for percentile in PERCENTILES))
    if found is None:
        return dict.fromkeys(f"{name}_{key}" for key in keys)
    told = (found.mean, found.median, found.deviation, *found.percentiles.tolist())
    return {f"{name}_{key}": fact for key, fact in zip(keys, told, strict=True)}


def _ways_facts(ways: Accessibility, probes: Sequence[float]) -> dict[str, Fact]:
    values: dict[str, Fact] = {}
    for throat in ways.throats:
        name = f"throat_{100 * throat.share:g}"
        values |= {name: throat.diameter, **place_facts(name, throat.place)}
    for probe, share in zip(probes, reachable_share(ways, np.array(probes, float)).tolist(), strict=True):
        values[f"accessible_to_{probe:g}_mm"] = share
    return values


def _curves(ways: Accessibility) -> Iterator[Curve]:
    """Yield the curve of accessible porosity, thinned out to as many points as a page can show."""
    count = len(ways.diameters)
    if count:
        chosen: Ints = np.unique(np.linspace(0, count - 1, _CURVE_POINTS).round().astype(np.int64))
        yield Curve(
            "accessible_porosity",
            "Accessible porosity",
            "probe diameter, mm",
            "share of the pore space reached",
            ways.diameters[chosen],
            ways.shares[chosen],
        )
