"""Rule `overhang`: faces that look down so flatly that nothing below holds them while they are printed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.measures.printability.facets import facing, label_connected_faces
from scaffold_geometry.measures.printability.places import format_place
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_pipeline.artifacts import Finding, SurfaceMesh

_ROUNDING = 1e-4
"""Cosine by which single precision may turn a face: one as steep as the rule asks for must not break it."""

_LEVEL = 1e-6
"""Share of the solid's height that is none: what rounding leaves of a level edge."""


@dataclass(frozen=True, eq=False)
class _Regions:
    """Overhangs, largest first: `areas` (k,), mm^2, and centroids `centres` (k, 3), mm."""

    areas: Floats
    centres: Floats


def overhangs(surface: SurfaceMesh, rules: PrintRules) -> Outcome:
    """Measure what looks down less steeply than `overhang_angle` and neither lies on the plate nor is a bridge.

    Faces within a layer of the lowest point lie on the plate. Those that share a vertex are one overhang.
    """
    areas, cosines = facing(surface.vertices, surface.faces, rules.up)
    looks_down = np.flatnonzero(cosines < -np.cos(np.radians(rules.overhang_angle)) - _ROUNDING)
    heights = surface.vertices @ rules.up
    is_off_plate = heights[surface.faces[looks_down]].max(axis=1) > heights.min() + rules.layer
    hanging = looks_down[is_off_plate]
    regions = _regions(surface, hanging, areas[hanging], rules)
    area, whole = float(regions.areas.sum()), float(areas.sum())
    values = {
        "overhang_area_mm2": area,
        "overhang_fraction": area / whole,
        "overhang_regions": len(regions.areas),
        "overhang_largest_mm2": float(regions.areas[:1].sum()),
    }
    if rules.max_overhang_area is None or area <= rules.max_overhang_area:
        return Outcome({**values}, None)
    message = (
        f"{area:.4g} mm^2, {area / whole:.1%} of the surface, look down at less than {rules.overhang_angle:g} degrees "
        f"from the horizontal in {len(regions.areas)} places, the largest of {regions.areas[0]:.4g} mm^2 at "
        f"{format_place(regions.centres[0])}; at most {rules.max_overhang_area:g} mm^2 may: support them, or turn the "
        "solid"
    )
    return Outcome({**values}, Finding("overhang", message, regions.centres[: rules.most_places]))


def _regions(surface: SurfaceMesh, hanging: Ints, areas: Floats, rules: PrintRules) -> _Regions:
    """Part the hanging faces, (h,) indices with their areas, into regions that no bridge spans."""
    if not len(hanging):
        return _Regions(np.empty(0), np.empty((0, 3)))
    faces = surface.faces[hanging]
    numbers = label_connected_faces(faces, len(surface.vertices))
    sums: Floats = np.bincount(numbers, areas).astype(np.float64)
    middles = surface.vertices[faces].mean(axis=1)
    centres = np.stack([np.bincount(numbers, areas * middles[:, axis]) for axis in range(3)], axis=1) / sums[:, None]
    order: Ints = np.argsort(-sums, kind="stable")
    if rules.bridge > 0.0:
        order = order[_spans(surface, hanging, numbers, sums, rules.up)[order] > rules.bridge]
    return _Regions(sums[order], centres[order])


def _spans(surface: SurfaceMesh, hanging: Ints, numbers: Ints, areas: Floats, up: Floats) -> Floats:
    """Return how far each region spans, (k,) mm: four times its area by the length of the rim from which it is held.

    That is the width of a square or a disc held all around, twice the span of a strip held at both ends, four times
    the reach of one held at one end, and never less than the diameter of the greatest disc in a convex region. A rim
    holds where the face beyond it goes down.
    """
    faces = surface.faces[hanging]
    keys, lengths = _edges(surface, faces)
    _, edges, uses = np.unique(keys, return_inverse=True, return_counts=True)
    is_rim = (uses[edges] == 1) & np.isin(keys, _edges_above(surface, hanging, up))
    rims = np.bincount(np.repeat(numbers, 3)[is_rim], lengths[is_rim], minlength=len(areas))
    return np.asarray(np.divide(4.0 * areas, rims, out=np.full(len(areas), np.inf), where=rims > 0.0))


def _edges(surface: SurfaceMesh, faces: Ints) -> tuple[Ints, Floats]:
    """Return a number for the edge from each corner of the faces to the next, and its length, (3 k,) both."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(tails, heads) * len(surface.vertices) + np.maximum(tails, heads)
    return keys, np.linalg.norm(surface.vertices[heads] - surface.vertices[tails], axis=1)


def _edges_above(surface: SurfaceMesh, hanging: Ints, up: Floats) -> Ints:
    """Return the numbers of the edges from which a face goes down that shares two vertices with those that hang."""
    is_of_hanging = np.zeros(len(surface.vertices), bool)
    is_of_hanging[surface.faces[hanging]] = True
    is_beside = is_of_hanging[surface.faces].sum(axis=1) > 1
    is_beside[hanging] = False
    beside = surface.faces[is_beside]
    heights = surface.vertices @ up
    ends = heights[beside]
    opposite, middles = np.roll(ends, 1, axis=1), (ends + np.roll(ends, -1, axis=1)) / 2.0
    goes_down = opposite < middles - _LEVEL * float(np.ptp(heights))
    keys, _ = _edges(surface, beside)
    return np.asarray(keys[goes_down.ravel()])
