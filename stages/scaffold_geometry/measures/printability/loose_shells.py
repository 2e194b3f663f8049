"""Rules `enclosed_void` and `island_piece`: closed pores, which keep powder or resin, and pieces that fall off."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.measures.printability.facets import shell_sums
from scaffold_geometry.measures.printability.places import format_place
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_geometry.surfaces.triangles import face_pieces
from scaffold_pipeline.artifacts import Finding, SurfaceMesh


def loose_shells(surface: SurfaceMesh, rules: PrintRules) -> tuple[Outcome, Outcome]:
    """Return what is wrong with the shells of a closed surface: its closed pores, and its pieces but the greatest.

    A shell is what hangs together by edges; one that faces inwards, so that its volume is negative, is a closed pore.
    Places are the centroids of what the shells enclose.
    """
    shells = face_pieces(surface.faces)
    volumes, centres = shell_sums(surface.vertices, surface.faces, shells, int(shells.max()) + 1)
    is_void = volumes < 0.0
    is_loose = volumes > 0.0
    is_loose[np.argmax(volumes)] = False
    voids = _Shells(-volumes[is_void], centres[is_void])
    pieces = _Shells(volumes[is_loose], centres[is_loose])
    return (
        voids.outcome("enclosed_void", "closed pores keep what the printer fills", _VOID_REMEDY, rules.most_places),
        pieces.outcome("island_piece", "pieces beside the greatest fall off", _PIECE_REMEDY, rules.most_places),
    )


_VOID_REMEDY = "let intersect_outer fill them (min_closed_pore), or open them by more porosity"
_PIECE_REMEDY = "keep the greatest piece only, or lower porosity"


class _Shells:
    """Shells of one kind: `volumes` (k,), mm^3, and `centres` (k, 3), greatest first."""

    def __init__(self, volumes: Floats, centres: Floats) -> None:
        order = np.argsort(-volumes, kind="stable")
        self.volumes, self.centres = volumes[order], centres[order]

    def outcome(self, rule: str, what: str, remedy: str, most: int) -> Outcome:
        """Return their count and volume, and a finding where there are any."""
        count, volume = len(self.volumes), float(self.volumes.sum())
        values = {f"{rule}s": count, f"{rule}_mm3": volume}
        if not count:
            return Outcome({**values}, None)
        message = (
            f"{count} {what}, {volume:.4g} mm^3 in all, the greatest of {self.volumes[0]:.4g} mm^3 at "
            f"{format_place(self.centres[0])}; {remedy}"
        )
        return Outcome({**values}, Finding(rule, message, self.centres[:most]))
