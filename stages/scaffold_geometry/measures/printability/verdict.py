"""What all rules say of a solid."""

from __future__ import annotations

from dataclasses import dataclass

from scaffold_geometry.measures.printability.islands import islands
from scaffold_geometry.measures.printability.loose_shells import loose_shells
from scaffold_geometry.measures.printability.overhangs import overhangs
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_geometry.measures.printability.thin_walls import thin_walls
from scaffold_geometry.measures.surface_tree import SurfaceTree
from scaffold_pipeline.artifacts import Fact, Finding, SurfaceMesh
from scaffold_pipeline.errors import StageError


@dataclass(frozen=True)
class Printability:
    """The numbers of all rules, and a finding for each that is broken, in the order of the rules."""

    values: dict[str, Fact]
    findings: tuple[Finding, ...]


def lint(solid: SurfaceMesh, rules: PrintRules, tree: SurfaceTree | None = None) -> Printability:
    """Hold a closed surface, as its file has it, against what a printer can do.

    `tree` finds its triangles, where there is one already. The same surface has the same findings. Five million
    triangles take half a minute on a core and 1.8 GB, two thirds of either for the walls. Raises `StageError` where it
    encloses nothing.
    """
    if solid.volume <= 0.0:
        raise StageError(
            f"print rules: need a closed surface about a volume, got {len(solid.faces)} triangles of "
            f"{solid.volume:.6g} mm^3; close it, and turn its normals out"
        )
    outcomes: list[Outcome] = [
        thin_walls(solid, tree or SurfaceTree(solid.vertices, solid.faces), rules),
        overhangs(solid, rules),
        islands(solid, rules),
        *loose_shells(solid, rules),
    ]
    values = {name: value for outcome in outcomes for name, value in outcome.values.items()}
    return Printability(values, tuple(outcome.finding for outcome in outcomes if outcome.finding))
