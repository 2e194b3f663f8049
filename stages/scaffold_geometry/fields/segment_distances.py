"""Squared distances, mm^2, between points and segments, as functions of scalars; a segment may have length 0.

A point is three scalars, a segment six: its start, then its end.
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.jit import kernel

ENDPOINT, ENDPOINT_TO_SEGMENT, EXACT = range(3)

DISTANCE_DEFINITIONS = {"endpoint": ENDPOINT, "endpoint-to-segment": ENDPOINT_TO_SEGMENT, "exact": EXACT}
"""The definitions of the distance between two segments, and their numbers in kernels."""


@kernel(inline=True)
def squared_point_point(px: float, py: float, pz: float, qx: float, qy: float, qz: float) -> float:
    """Return the squared distance of points p and q."""
    dx, dy, dz = px - qx, py - qy, pz - qz
    return dx * dx + dy * dy + dz * dz


@kernel(inline=True)
def squared_point_segment(
    px: float, py: float, pz: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> float:
    """Return the squared distance of point p from the nearest point of segment ab."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    wx, wy, wz = px - ax, py - ay, pz - az
    length2 = ux * ux + uy * uy + uz * uz
    t = (wx * ux + wy * uy + wz * uz) / (length2 if length2 > 0.0 else 1.0)
    t = min(max(t, 0.0), 1.0)
    return squared_point_point(wx, wy, wz, t * ux, t * uy, t * uz)


def frames_of(starts: Floats, ends: Floats) -> Floats:
    """Return an orthonormal frame for each segment of `starts` and `ends` (n, 3), mm, as rows of (12, n).

    0 to 2: the start (the midpoint would be rounded). 3 and 4: x and y of the axis `beside`, which is horizontal. 5 to
    7: the axis `over`. 8 to 10: the axis along the segment. 11: the length. A segment of length 0 has the coordinate
    axes.
    """
    steps = ends - starts
    scales = np.abs(steps).max(axis=1, keepdims=True, initial=0.0)
    steps = np.where(scales > 0.0, steps / np.where(scales > 0.0, scales, 1.0), (0.0, 0.0, 1.0))
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    along = steps / lengths
    level = np.hypot(along[:, :1], along[:, 1:2])
    tilt = np.where(level > 0.0, along[:, :2] / np.where(level > 0.0, level, 1.0), (0.0, -1.0))
    beside = np.column_stack([-tilt[:, 1], tilt[:, 0], np.zeros(len(tilt))])
    frames = [starts, beside[:, :2], np.cross(along, beside), along, scales * lengths]
    return np.ascontiguousarray(np.concatenate(frames, axis=1).T)


@kernel(inline=True, fastmath=frozenset({"contract"}))
def squared_in_frame(beside2: float, over: float, along: float, length: float) -> float:
    """Return the squared distance of a point from a segment, from the point's coordinates in the segment's frame.

    The first coordinate is passed squared: it is constant along a grid row in z.
    """
    beyond = max(along - length, min(along, 0.0))
    return beside2 + over * over + beyond * beyond


@kernel(inline=True)
def squared_endpoint(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the least squared distance of an end of segment ab from an end of cd, as in the paper's text."""
    return min(
        squared_point_point(ax, ay, az, cx, cy, cz),
        squared_point_point(ax, ay, az, dx, dy, dz),
        squared_point_point(bx, by, bz, cx, cy, cz),
        squared_point_point(bx, by, bz, dx, dy, dz),
    )


@kernel(inline=True)
def squared_endpoint_to_segment(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the least squared distance of an end of either segment, ab or cd, from the other segment.

    The paper's authors computed with it. It is the true distance unless the nearest points are both interior.
    """
    return min(
        squared_point_segment(ax, ay, az, cx, cy, cz, dx, dy, dz),
        squared_point_segment(bx, by, bz, cx, cy, cz, dx, dy, dz),
        squared_point_segment(cx, cy, cz, ax, ay, az, bx, by, bz),
        squared_point_segment(dx, dy, dz, ax, ay, az, bx, by, bz),
    )


@kernel(inline=True)
def squared_exact(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the squared distance of segments ab and cd.

    |a + s (b - a) - c - t (d - c)|^2 is convex over the unit square of s and t: its minimum is on the boundary,
    where an end is nearest, or where both derivatives are zero. For nearly parallel segments that point is
    ill-conditioned, but the distance of any point of ab from cd is never less than the true distance.
    """
    least = squared_endpoint_to_segment(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = dx - cx, dy - cy, dz - cz
    wx, wy, wz = cx - ax, cy - ay, cz - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    determinant = uu * vv - uv * uv
    if determinant <= 0.0:
        return least
    s = ((ux * wx + uy * wy + uz * wz) * vv - (vx * wx + vy * wy + vz * wz) * uv) / determinant
    s = min(max(s, 0.0), 1.0)
    inner = squared_point_segment(ax + s * ux, ay + s * uy, az + s * uz, cx, cy, cz, dx, dy, dz)
    return min(least, inner)


@kernel(inline=True)
def squared_segment_segment(
    distance_definition: int,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the squared distance of segments ab and cd by one of the `DISTANCE_DEFINITIONS`."""
    if distance_definition == ENDPOINT:
        return squared_endpoint(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
    if distance_definition == ENDPOINT_TO_SEGMENT:
        return squared_endpoint_to_segment(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
    return squared_exact(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
