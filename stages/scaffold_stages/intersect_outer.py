"""Stage `intersect_outer`: the porous surface cut to the outer shape, one printable solid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from scaffold_pipeline.artifacts import Fact, Floats, IsoSurface, OuterShape, Solid
from scaffold_pipeline.contract import Millimetres, Params, Share, stage
from scaffold_pipeline.errors import StageError
from scaffold_stages._kernels.contours import inward_offset

if TYPE_CHECKING:
    from scaffold_stages._kernels.solids import Body, Shells


class IntersectOuterParams(Params):
    """Parameters of `intersect_outer`."""

    skin: Millimetres = Field(default=0.0, ge=0.0)
    """Thickness of a solid shell that is kept under the outer surface; 0 leaves the pores open there."""

    min_closed_pore: Share = Field(default=0.001, ge=0.0, le=1.0)
    """Closed pores below this share of the pore volume are filled: nothing can be cleared out of them."""


@stage(writes="solid", version=1)
def intersect_outer(porous: IsoSurface, outer: OuterShape, *, params: IntersectOuterParams) -> Solid:
    """Cut the porous surface to the outer shape, with a solid skin where asked for, and keep the one main piece.

    The outer surface of the solid lies on the outer shape's own facets. Raises `StageError` where either surface is
    not a closed manifold, the skin leaves no pore, or nothing remains.
    """
    from scaffold_stages._kernels.solids import clipped, in_single_precision, shells_of, to_body

    _require_counted(porous, params.skin)
    shape = to_body(outer.vertices, outer.faces, "outer shape")
    core = _core(outer, params.skin)
    solid, void = clipped(to_body(porous.vertices, porous.faces, "porous surface"), shape, core)
    shells, pores = shells_of(solid), _volumes(shells_of(void).pieces)
    if not shells.pieces:
        raise StageError("nothing remains inside the outer shape; lower porosity or iso")
    kept, facts = _one_piece(shells, params.min_closed_pore * float(pores.sum()))
    vertices, faces = in_single_precision(kept, "clipped solid")
    return Solid(vertices, faces, pores, facts)


def _require_counted(porous: IsoSurface, skin: float) -> None:
    """Require that a porosity was solved with the skin that is made, or it would not be met."""
    if porous.porosity_requested is not None and porous.skin != skin:
        raise StageError(
            f"skin {skin:g} mm: the porosity was solved for a skin of {porous.skin:g} mm; leave isosurface.skin out, "
            "so that it follows"
        )


def _core(outer: OuterShape, skin: float) -> Body | None:
    from scaffold_stages._kernels.solids import to_body

    if skin == 0.0:
        return None
    vertices, faces = inward_offset(outer.vertices, outer.faces, skin)
    if not len(faces):
        raise StageError(f"skin {skin:g} mm: the outer shape is nowhere so thick, and no pore would remain")
    return to_body(vertices, faces, f"inward offset by {skin:g} mm")


def _volumes(bodies: tuple[Body, ...]) -> Floats:
    """Return the volume of each body, greatest first."""
    return np.sort(np.array([body.volume() for body in bodies], float))[::-1]


def _one_piece(shells: Shells, least_cavity: float) -> tuple[Body, dict[str, Fact]]:
    """Return the greatest piece with the closed pores that stay, and what was removed and filled."""
    from scaffold_stages._kernels.solids import joined

    cavities = [shell for shell in shells.cavities if -shell.volume() >= least_cavity]
    filled = len(shells.cavities) - len(cavities)
    floating = _volumes(shells.pieces[1:])
    facts: dict[str, Fact] = {
        "pieces_removed": len(floating),
        "volume_removed_mm3": float(floating.sum()),
        "closed_pores": len(cavities),
        "closed_pores_filled": filled,
    }
    return joined((shells.pieces[0], *cavities)) if cavities else shells.pieces[0], facts
