"""Rule `sliver`: triangles so flat that slicing programs drop or tear them."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.measures.printability.facets import aspects
from scaffold_geometry.measures.printability.places import apart_in, format_place, worst_apart
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_pipeline.artifacts import Finding, SurfaceMesh


def slivers(surface: SurfaceMesh, rules: PrintRules) -> Outcome:
    """Count the triangles without area or flatter than `min_aspect`, as a file of single precision holds them."""
    held = surface.vertices.astype(np.float32).astype(np.float64)
    ratios = aspects(held, surface.faces)
    flat = np.flatnonzero((ratios < rules.min_aspect) | (ratios == 0.0))
    values = {"sliver_triangles": len(flat)}
    if not len(flat):
        return Outcome({**values}, None)
    centres = held[surface.faces[flat]].mean(axis=1)
    named = worst_apart(centres, -ratios[flat], apart_in(surface), rules.most_places)
    message = (
        f"{len(flat)} of {len(surface.faces)} triangles are flatter than {rules.min_aspect:g} of their longest edge, "
        f"the flattest {ratios[flat].min():.2g} at {format_place(centres[named[0]])}; clean or simplify the surface"
    )
    return Outcome({**values}, Finding("sliver", message, centres[named]))
