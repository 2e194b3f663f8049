"""Thickness of struts and width of channels along the axes of the mesh, and interrupted struts and channels.

All triangles of the solid that an axis crosses are found exactly, so that no gap is missed. The thickness at a point of
an axis is the diameter of the largest inscribed ball across it: its centre is in the plane normal to the axis, and the
ball comes within half a voxel of the axis, as an iso-surface on voxels has this error, so that the axis is not central
in its strut. A ball centred on the axis would measure the distance of the axis from the wall, not the thickness.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.measures.axes import Axes
from scaffold_geometry.measures.declarations import place_metrics
from scaffold_pipeline.artifacts import Metric

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton
    from scaffold_geometry.measures.surface_tree import SurfaceTree

_BATCH = 256
"""Points per batch; a later batch is skipped if all its points are too far from a wall."""

_HOW = "along the mesh: the largest inscribed ball across an axis, at most half a voxel too large; counts are exact"

METRICS = (
    Metric(
        "thinnest_strut_mm",
        "mm",
        "Thinnest strut",
        "Diameter at the thinnest place of all struts that are whole in the file.",
        "Struts",
        method=_HOW,
    ),
    *place_metrics("thinnest_strut", "Place of the thinnest strut", "The centre of that ball.", _HOW),
    Metric(
        "struts_interrupted",
        "",
        "Struts interrupted",
        "Mesh edges with a gap in the file.",
        "Struts",
        method=_HOW,
    ),
    Metric(
        "narrowest_throat_mm",
        "mm",
        "Narrowest throat",
        "Diameter at the narrowest place of all channels that are open in the file.",
        "Pores",
        method=_HOW,
    ),
    *place_metrics("narrowest_throat", "Place of the narrowest throat", "The centre of that ball.", _HOW),
    Metric(
        "channels_interrupted",
        "",
        "Channels interrupted",
        "Channels that are closed in the file.",
        "Connectivity",
        method=_HOW,
    ),
)
"""The metrics of `thinnest_strut` and `narrowest_throat`."""

_WAYS = 8
"""Directions across an axis in which a ball is moved."""

_FINEST = 1.0 / 64.0
"""Last step of a ball, as a share of half a voxel."""

_TOUCHES = 1.0 / 16.0
"""Distance from a wall at which a ball counts as touching, as a share of half a voxel: steps are finite."""


class Narrowest(NamedTuple):
    """The number of interrupted axes, and the least diameter along the others, mm, with its ball's centre (3,), mm.

    Both are None if no axis is whole, or no point of one counts.
    """

    interrupted: int
    diameter: float | None
    place: Floats | None


def thinnest_strut(
    skeleton: Skeleton, solid: SurfaceTree, outer: SurfaceTree, spacing: float, on_outer: float
) -> Narrowest:
    """Return how many struts a closed `solid` that was cut to `outer` interrupts, and the thinnest of the others.

    Points count that lie more than `on_outer` mm within the outer shape, and balls that do not touch it: a strut at the
    surface ends where the clip cuts it, which says nothing of its thickness. A strut is interrupted where it passes
    such a wall, or lies in a pore. Points lie half of `spacing` mm, the voxels of the field, apart, so that the
    diameter is too great by half a voxel at most.
    """
    ends = skeleton.vertices[skeleton.edges]
    axes = Axes(ends[:, 0], ends[:, 1], spacing / 2.0)
    crossings = solid.crossings(axes)
    depths = outer.signed_distances(axes.points)
    is_within = depths < -on_outer
    leaves = crossings.axes[(outer.distances(crossings.points)[0] > on_outer) & (crossings.shares <= 1.0)]
    is_broken = axes.any(is_within & ~crossings.is_solid(axes))
    is_broken[leaves] = True
    counted = np.flatnonzero(is_within & ~axes.at_points(is_broken))
    radii = solid.distances(axes.points[counted])[0]
    is_of_pore = -depths[counted] > radii + on_outer
    return _narrowest(axes, is_broken, (counted[is_of_pore], radii[is_of_pore]), solid, outer)


def narrowest_throat(
    skeleton: Skeleton, solid: SurfaceTree, outer: SurfaceTree, spacing: float, skin: float
) -> Narrowest:
    """Return how many channels a closed `solid` closes, and the narrowest throat of the others, as `thinnest_strut`.

    Under a `skin`, mm, points less deep in the `outer` shape do not count, nor do channels that would leave the mesh.
    """
    axes = Axes(skeleton.channel_starts, skeleton.channel_ends, spacing / 2.0)
    crossings = solid.crossings(axes)
    counts = np.ones(len(axes.points), bool)
    is_crossed = crossings.shares <= 1.0
    if skin > 0.0:
        leaves = np.bincount(skeleton.channel_faces)[skeleton.channel_faces] == 1
        within = -(skin + spacing / 2.0)  # the skin's inner wall is found on a grid: channels that end on it are open
        counts = ~axes.at_points(leaves) & (outer.signed_distances(axes.points) <= within)
        is_crossed &= ~leaves[crossings.axes] & (outer.signed_distances(crossings.points) <= within)
    is_closed = axes.any(counts & crossings.is_solid(axes))
    is_closed[crossings.axes[is_crossed]] = True
    counted = np.flatnonzero(counts & ~axes.at_points(is_closed))
    return _narrowest(axes, is_closed, (counted, solid.distances(axes.points[counted])[0]), solid, None)


def _narrowest(
    axes: Axes, is_interrupted: Bools, counted: tuple[Ints, Floats], solid: SurfaceTree, outer: SurfaceTree | None
) -> Narrowest:
    """Return the least of the greatest balls across axes at the points `counted` (k,), so many mm from a wall, (k,).

    A ball across an axis is at least as great as that about it: what lies deeper than the least found is left out, as
    are balls that touch `outer`.
    """
    indices, radii = counted
    order = np.argsort(radii, kind="stable")
    least, place, slack = np.inf, None, axes.spacing
    for first in range(0, len(order), _BATCH):
        batch = order[first : first + _BATCH]
        if radii[batch[0]] >= least:
            break
        chosen = indices[batch]
        grown, middles = grow_across(
            axes.points[chosen], axes.directions[axes.owners[chosen]], radii[batch], solid, slack
        )
        if outer is not None:
            grown[outer.distances(middles)[0] <= grown + _TOUCHES * slack] = np.inf
        thinnest = int(grown.argmin())
        if grown[thinnest] < least:
            least, place = float(grown[thinnest]), middles[thinnest]
    return Narrowest(int(is_interrupted.sum()), 2.0 * least if place is not None else None, place)


def grow_across(
    points: Floats, directions: Floats, radii: Floats, walls: SurfaceTree, slack: float
) -> tuple[Floats, Floats]:
    """Return the radius of the greatest ball across axes at `points` (k, 3), mm, (k,), and its middle, (k, 3).

    `radii` (k,) are those of the balls about the points themselves, which grow by moving at right angles to the unit
    `directions` (k, 3), while they come within `slack` mm of the points. A step is no longer than the radius, so that a
    ball stays on its side of the walls. Found to a `_FINEST` of `slack`.
    """
    ways = _ways_across(directions)
    middles, grown = points.copy(), radii.copy()
    steps = np.full(len(points), slack)
    while (open_ := np.flatnonzero(steps > _FINEST * slack)).size:
        reach = np.minimum(steps[open_], 0.9 * grown[open_])
        tried = middles[open_, None] + reach[:, None, None] * ways[open_]
        found = walls.distances(tried.reshape(-1, 3))[0].reshape(len(open_), -1)
        off = np.linalg.norm(tried - points[open_, None], axis=2)
        found[off > found + slack] = 0.0
        best = found.argmax(axis=1)
        rows = np.arange(len(open_))
        is_better = found[rows, best] > grown[open_]
        better = open_[is_better]
        middles[better], grown[better] = (found_[rows, best][is_better] for found_ in (tried, found))
        steps[open_[~is_better]] /= 2.0
    return grown, middles


def _ways_across(directions: Floats) -> Floats:
    """Return `_WAYS` unit vectors at right angles to each direction (k, 3), evenly turned about it, (k, _WAYS, 3)."""
    least = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(directions, first)
    turns = 2.0 * np.pi / _WAYS * np.arange(_WAYS)
    return np.asarray(np.cos(turns)[:, None] * first[:, None] + np.sin(turns)[:, None] * second[:, None])
