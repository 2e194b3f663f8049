"""Stage `mirror_outer`: a left bone from a right one."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.stages.contract import Params, stage


class MirrorOuterParams(Params):
    """Parameters of `mirror_outer`."""

    axis: Literal["x", "y", "z"] = "x"
    """Axis whose direction is reversed."""


@stage(writes="outer", version=1)
def mirror_outer(outer: OuterShape, *, params: MirrorOuterParams) -> OuterShape:
    """Mirror the outer shape in the plane normal to an axis through the centre of its bounding box."""
    flips = np.where(np.arange(3) == "xyz".index(params.axis), -1.0, 1.0)
    middle = outer.bounds.mean(axis=0)
    vertices = middle + flips * (outer.vertices - middle)
    outward = outer.faces[:, ::-1]  # a mirror image turns normals inwards
    return OuterShape(vertices, outward, (*outer.notes, f"mirrored along {params.axis}"), outer.facts)
