"""Rule `knife_edge`: rims so sharp that the solid runs out to nothing, and prints ragged or not at all."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.measures.printability.places import apart_in, format_place, worst_apart
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_geometry.measures.printability.sharp_edges import SharpEdges, sharp_edges
from scaffold_pipeline.artifacts import Finding, SurfaceMesh


def sharp_rims(surface: SurfaceMesh, rules: PrintRules) -> SharpEdges:
    """Return the edges sharper than twice `knife_angle`: as a rim bends it is now above it, now below."""
    return sharp_edges(surface.vertices, surface.faces, np.radians(2.0 * rules.knife_angle))


def knife_edges(surface: SurfaceMesh, rims: SharpEdges, rules: PrintRules) -> Outcome:
    """Measure how long the edges of a closed surface sharper than `knife_angle` are, of those of `sharp_rims`."""
    is_knife = rims.angles < np.radians(rules.knife_angle)
    angles, ends = np.degrees(rims.angles[is_knife]), surface.vertices[rims.edges[is_knife]]
    length = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
    values = {"knife_edge_mm": length}
    if rules.max_knife_edge is None or length <= rules.max_knife_edge:
        return Outcome({**values}, None)
    middles = ends.mean(axis=1)
    named = worst_apart(middles, -angles, apart_in(surface), rules.most_places)
    message = (
        f"{length:.3g} mm of rims are sharper than {rules.knife_angle:g} degrees, the sharpest of "
        f"{angles[named[0]]:.2g} degrees at {format_place(middles[named[0]])}; at most {rules.max_knife_edge:g} mm may "
        "be: smooth the solid, or give it a skin"
    )
    return Outcome({**values}, Finding("knife_edge", message, middles[named]))
