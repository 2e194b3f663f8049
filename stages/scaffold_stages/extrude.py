"""Stage `extrude`: a planar contour as a printable plate."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.artifacts import Contour, Fact, Solid
from scaffold_pipeline.stages.contract import Millimetres, Params, stage


class ExtrudeParams(Params):
    """Parameters of `extrude`."""

    height: Millimetres = Field(gt=0.0)
    """Thickness of the plate, along z from the contour's plane."""


@stage(writes="solid", version=2)
def extrude(contour: Contour, *, params: ExtrudeParams) -> Solid:
    """Extrude a contour to a plate, `height` mm thick, from the contour's plane upwards.

    All pieces are kept. Raises `StageError` if details are lost in single precision.
    """
    from scaffold_geometry.planar import regions
    from scaffold_geometry.surfaces.float32 import snap_to_float32

    surface = regions.prism(contour.solid.rings, contour.z, contour.z + params.height)
    rounded = snap_to_float32(*surface, "plate")
    facts: dict[str, Fact] = {"height_mm": params.height, "pieces": contour.pieces, "holes": contour.holes}
    return Solid(rounded.vertices, rounded.faces, params.height * _pore_areas(contour), facts)


def _pore_areas(contour: Contour) -> Floats:
    """Return the area of each connected pore inside the outline, the greatest first, mm^2."""
    from scaffold_geometry.planar.regions import pieces_of, to_region

    pores = to_region(contour.outline.rings) - to_region(contour.solid.rings)
    return np.array(sorted((piece.area() for piece in pieces_of(pores)), reverse=True))
