"""The pore space as a body: the outer shape without the solid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.solids.checks import VOLUME_TOLERANCE
from scaffold_pipeline.artifacts import OuterShape, Solid
from scaffold_pipeline.errors import StageError

INSETS = (4, 16, 64)
"""Distance of the pore space from the outer shape, in float32 steps at its farthest vertex, see `pore_space`."""


class PoreSpace(NamedTuple):
    """The pore space, and the distance of its openings below the outer shape, mm."""

    body: Solid
    inset: float


def pore_space(outer: OuterShape, solid: Solid) -> PoreSpace:
    """Return the outer shape without the solid, with all its pieces, exact in float32.

    The solid is on the outer facets except for the rounding of its vertices. A cut at the facets would leave films of
    that thickness, so the cut is a few roundings below them. Raises `StageError` if nothing is left, it cannot be
    rounded, or the pore space and the solid do not fill the outer shape.
    """
    from igl import per_vertex_normals

    from scaffold_geometry.surfaces.booleans import from_manifold, to_manifold
    from scaffold_geometry.surfaces.float32 import snap_to_float32

    taken = to_manifold(solid.vertices, solid.faces, "solid")
    normals = per_vertex_normals(outer.vertices, outer.faces)
    step = float(np.spacing(np.float32(np.abs(outer.vertices).max())))
    failures: list[StageError] = []
    for inset in (steps * step for steps in INSETS):
        room = to_manifold(outer.vertices - inset * normals, outer.faces, "outer shape") - taken
        if room.is_empty():
            raise StageError(
                "the pore space is empty: the solid fills the outer shape; raise porosity, or set void off"
            )
        try:
            rounded = snap_to_float32(*from_manifold(room), "pore space")
        except StageError as error:
            failures.append(error)
            continue
        return PoreSpace(_body(rounded.vertices, rounded.faces, outer, solid), inset)
    raise failures[-1]


def _body(vertices: Floats, faces: Ints, outer: OuterShape, solid: Solid) -> Solid:
    body = Solid(vertices, faces)
    together = body.volume + solid.volume
    if not abs(together - outer.volume) <= VOLUME_TOLERANCE * outer.volume:
        raise StageError(
            f"pore space and solid must fill the outer shape to {VOLUME_TOLERANCE:g}, but take {together:.9g} of "
            f"{outer.volume:.9g} mm^3; void needs the outer shape that intersect_outer cut the solid to, and one not "
            "far from the origin"
        )
    return body
