"""How thick struts and how wide channels are in a solid: balls about points of their axes that fit in."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.measures.declarations import place_metrics
from scaffold_pipeline.artifacts import Metric

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton


_HOW = "along each strut and channel of the mesh, the least ball about the axis that fits in, at nine points of it"

METRICS = (
    Metric(
        "thinnest_strut_mm",
        "mm",
        "Thinnest strut",
        "The least ball about a mesh edge that fits into the solid.",
        "Struts",
        method=_HOW,
    ),
    *place_metrics("thinnest_strut", "Place of the thinnest strut", "The middle of that ball.", _HOW),
    Metric(
        "struts_interrupted",
        "",
        "Struts interrupted",
        "Mesh edges that leave the solid in the file itself.",
        "Struts",
        method=_HOW,
    ),
    Metric(
        "narrowest_throat_mm",
        "mm",
        "Narrowest throat",
        "The least ball about a channel that fits into the pores.",
        "Pores",
        method=_HOW,
    ),
    *place_metrics("narrowest_throat", "Place of the narrowest throat", "The middle of that ball.", _HOW),
    Metric(
        "channels_interrupted",
        "",
        "Channels interrupted",
        "Passages that meet solid in the file itself.",
        "Connectivity",
        method=_HOW,
    ),
)
"""What `thinnest_strut` and `narrowest_throat` are told as."""

_SAMPLES = 9
"""Points along each axis, both ends included."""

_INSIDE = 0.5
"""Winding number between that of points outside, 0, and inside, 1."""


class Narrowest(NamedTuple):
    """The least diameter, mm, of a ball about an axis, its middle (3,), mm, and how many axes leave their side."""

    diameter: float
    place: Floats
    interrupted: int


def thinnest_strut(
    skeleton: Skeleton, solid: tuple[Floats, Ints], outer: tuple[Floats, Ints], on_outer: float
) -> Narrowest | None:
    """Return the thinnest place of the struts of a closed `solid` that was cut to `outer`, both as (n, 3), (m, 3).

    Points count where the wall nearest to them is that of a pore: a strut at the surface ends where the clip cuts it,
    which says nothing of its thickness. A wall nearer than `on_outer` mm to the outer shape is the clip's. A strut
    with a point in a pore is interrupted, its diameter 0. None where no point counts.
    """
    ends = skeleton.vertices[skeleton.edges]
    points = _along(ends[:, 0], ends[:, 1])
    within = np.flatnonzero(_signed_distance(points, *outer)[0] < 0.0)
    depths, walls = _signed_distance(points[within], *solid)
    of_pores = np.abs(_signed_distance(walls, *outer)[0]) > on_outer
    radii = np.full(len(points), np.inf)
    radii[within[of_pores]] = -depths[of_pores]
    return _narrowest(radii, points)


def narrowest_throat(
    skeleton: Skeleton, solid: tuple[Floats, Ints], outer: tuple[Floats, Ints], skin: float
) -> Narrowest | None:
    """Return the narrowest place of the channels through a closed `solid`; one with a point in it is interrupted.

    Under a `skin`, mm, points less deep in the `outer` shape do not count, nor do channels that would leave the mesh.
    """
    points = _along(skeleton.channel_starts, skeleton.channel_ends)
    radii, _ = _signed_distance(points, *solid)
    if skin > 0.0:
        leaves = np.bincount(skeleton.channel_faces)[skeleton.channel_faces] == 1
        is_in_skin = _signed_distance(points, *outer)[0] > -skin
        radii = np.where(is_in_skin | np.repeat(leaves, _SAMPLES), np.inf, radii)
    return _narrowest(radii, points)


def _narrowest(radii: Floats, points: Floats) -> Narrowest | None:
    least = int(radii.argmin())
    if np.isinf(radii[least]):
        return None
    interrupted = int((radii.reshape(-1, _SAMPLES) <= 0.0).any(axis=1).sum())
    return Narrowest(2.0 * max(float(radii[least]), 0.0), points[least], interrupted)


def _along(starts: Floats, ends: Floats) -> Floats:
    """Return points on each segment `starts`-`ends` (n, 3), (n * _SAMPLES, 3)."""
    shares = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    return (starts[:, None] + shares * (ends - starts)[:, None]).reshape(-1, 3)


def _signed_distance(points: Floats, vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Return the distance of `points` (n, 3) from a closed surface, negative inside, (n,), and where it is nearest.

    The sign is that of the winding number: beside slivers, which a clip leaves, igl's angle-weighted normals point to
    the wrong side.
    """
    import igl

    if not len(points):
        return np.empty(0), np.empty((0, 3))
    places = np.ascontiguousarray(points)
    squared, _, nearest = igl.point_mesh_squared_distance(places, vertices, faces)
    is_inside = igl.fast_winding_number(vertices, faces, places) > _INSIDE
    return np.where(is_inside, -1.0, 1.0) * np.sqrt(squared), np.asarray(nearest)
