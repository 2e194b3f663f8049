"""Rule `unsupported_island`: parts of the solid that start in mid-air when it is built up layer by layer."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.measures.printability.facets import cone_angles
from scaffold_geometry.measures.printability.merge_tree import part_heights
from scaffold_geometry.measures.printability.places import format_place
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_pipeline.artifacts import Finding, SurfaceMesh


def islands(surface: SurfaceMesh, rules: PrintRules) -> Outcome:
    """Count the lowest points, off the plate, of parts that stand free for more than a layer before they are joined.

    A part starts at a vertex lower than all around it, from which the solid widens. How far it stands free is how far
    its surface rises before it meets that of a part which started lower; the places of those that stand free for
    longest come first. A pore's floor is lower than all around it, too, but there it is the pore that widens.
    """
    heights = surface.vertices @ rules.up
    rises = part_heights(surface.faces, heights)
    is_lowest = (rises > rules.layer) & (heights > heights.min() + rules.layer)
    starts = np.flatnonzero(cone_angles(surface.vertices, surface.faces, rules.up, is_lowest) < 0.0)
    values = {"unsupported_islands": len(starts)}
    if not len(starts):
        return Outcome({**values}, None)
    starts = starts[np.argsort(-rises[starts], kind="stable")]
    places = surface.vertices[starts]
    message = (
        f"{len(starts)} parts start in mid-air and stand free for more than a layer of {rules.layer:g} mm, that at "
        f"{format_place(places[0])} for {_free(float(rises[starts[0]]))}; support them, or turn the solid"
    )
    return Outcome({**values}, Finding("unsupported_island", message, places[: rules.most_places]))


def _free(rise: float) -> str:
    return f"{rise:.3g} mm" if np.isfinite(rise) else "ever: it is a piece of its own"
