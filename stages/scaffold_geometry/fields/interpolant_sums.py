"""Sums over points and segments, s(x) = sum_i w_i phi(d(x, element_i)), on a grid and at scattered points.

The points of a grid row along z share the terms that depend on x and y only. With an orthonormal frame for each segment
(`frames_of`), a pair then takes 20 vector operations, or 14 if the element is a point; except for the thin-plate
spline, none is a square root or a division.

Every sum runs over the elements in their order, and every lane is computed by the same instructions: no bit depends on
the number of threads or on the division of the points into blocks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.fields.radial_bases import (
    GAUSSIAN,
    INVERSE_MULTIQUADRIC,
    MULTIQUADRIC,
    THIN_PLATE_SPLINE,
    summand,
)
from scaffold_geometry.fields.segment_distances import squared_in_frame
from scaffold_geometry.jit import kernel, parallel_kernel, prange

LANES = 16
"""Points that are summed at once; the number is fixed, so that the loops over them are compiled to whole vectors."""

_AT_ONCE = 64 * LANES
"""Scattered points that a thread takes at once."""

_CACHE_LINE = 64
"""Bytes; vectors across two cache lines took 1.5 times as long."""

_FUSED = frozenset({"contract"})
"""Fused multiply-add; nothing that reorders a sum."""


@parallel_kernel
def fill_rows(
    rows: Ints, xs: Floats, ys: Floats, zs: Floats, near: Bools,
    points: Floats, frames: Floats, weights: Floats, basis: int, shift: float, c: float, values: NDArray[Any],
) -> None:  # fmt: skip
    """Write s into `values` (nx, ny, nz) where `near` (nx, ny, nz) is true, in the `rows` i * ny + j, in parallel.

    `points` are (3, p), `frames` (12, h) and `weights` (p + h,); `shift` is added to every squared distance.
    """
    for number in prange(len(rows)):
        i, j = rows[number] // len(ys), rows[number] % len(ys)
        places = np.flatnonzero(near[i, j])
        across = np.empty((3, len(weights)))
        _look_across(xs[i], ys[j], points, frames, shift, across)
        scratch = _allocate_aligned(2 * LANES)
        for low in range(0, len(places), LANES):
            for lane in range(LANES):
                scratch[lane] = zs[places[min(low + lane, len(places) - 1)]]
            _sum_in_row(scratch, across, points, frames, weights, basis, c)
            for n in range(low, min(low + LANES, len(places))):
                values[i, j, places[n]] = scratch[LANES + n - low]


@parallel_kernel
def fill_points(
    xyz: Floats,
    points: Floats, frames: Floats, weights: Floats, basis: int, shift: float, c: float, values: Floats,
) -> None:  # fmt: skip
    """Write s at the points `xyz` (3, n) into `values` (n,); other arguments as in `fill_rows`."""
    for number in prange((len(values) + _AT_ONCE - 1) // _AT_ONCE):
        scratch = _allocate_aligned(4 * LANES)
        high = min((number + 1) * _AT_ONCE, len(values))
        for low in range(number * _AT_ONCE, high, LANES):
            for axis in range(3):
                for lane in range(LANES):
                    scratch[axis * LANES + lane] = xyz[axis, min(low + lane, high - 1)]
            _sum_at_points(scratch, points, frames, weights, basis, shift, c)
            for n in range(low, min(low + LANES, high)):
                values[n] = scratch[3 * LANES + n - low]


@kernel
def _allocate_aligned(count: int) -> Floats:
    """Return an array (count,) that starts at the beginning of a cache line."""
    room = np.empty(count + _CACHE_LINE // 8)
    first = -room.ctypes.data % _CACHE_LINE // 8
    return room[first : first + count]


@kernel(fastmath=_FUSED)
def _look_across(x: float, y: float, points: Floats, frames: Floats, shift: float, across: Floats) -> None:
    """Fill `across` (3, p + h) with the parts of the distances that depend on x and y only.

    Row 0: for a point, the squared distance in the xy plane; for a segment, `beside` squared; plus `shift`. Rows 1 and
    2: the segments' `over` and `along`, without the part of z.
    """
    first = points.shape[1]
    for n in range(first):
        wx, wy = x - points[0, n], y - points[1, n]
        across[0, n] = wx * wx + wy * wy + shift
    for n in range(frames.shape[1]):
        wx, wy = x - frames[0, n], y - frames[1, n]
        beside = wx * frames[3, n] + wy * frames[4, n]
        across[0, first + n] = beside * beside + shift
        across[1, first + n] = wx * frames[5, n] + wy * frames[6, n]
        across[2, first + n] = wx * frames[8, n] + wy * frames[9, n]


@kernel
def _sum_in_row(
    scratch: Floats, across: Floats, points: Floats, frames: Floats, weights: Floats, basis: int, c: float
) -> None:
    """Sum as `_sum_row` does, with the basis as a constant in each copy, so that its loops are vectorised."""
    if basis == GAUSSIAN:
        _sum_row(scratch, across, points, frames, weights, GAUSSIAN, c)
    elif basis == MULTIQUADRIC:
        _sum_row(scratch, across, points, frames, weights, MULTIQUADRIC, c)
    elif basis == INVERSE_MULTIQUADRIC:
        _sum_row(scratch, across, points, frames, weights, INVERSE_MULTIQUADRIC, c)
    else:
        _sum_row(scratch, across, points, frames, weights, THIN_PLATE_SPLINE, c)


@kernel(inline=True, fastmath=_FUSED)
def _sum_row(
    scratch: Floats, across: Floats, points: Floats, frames: Floats, weights: Floats, basis: int, c: float
) -> None:
    """Write s of `LANES` points of a row into the second half of `scratch` (2 LANES,); their z is in the first half.

    One array holds both: LLVM then knows that they do not overlap, and keeps the sums in registers.
    """
    first = points.shape[1]
    for lane in range(LANES):
        scratch[LANES + lane] = 0.0
    for n in range(first):
        pz, offset, weight = points[2, n], across[0, n], weights[n]
        for lane in range(LANES):
            wz = scratch[lane] - pz
            scratch[LANES + lane] += weight * summand(basis, offset + wz * wz, c)
    for n in range(frames.shape[1]):
        sz, oz, az, length = frames[2, n], frames[7, n], frames[10, n], frames[11, n]
        beside2, over, along = across[0, first + n], across[1, first + n], across[2, first + n]
        weight = weights[first + n]
        for lane in range(LANES):
            wz = scratch[lane] - sz
            squared = squared_in_frame(beside2, over + wz * oz, along + wz * az, length)
            scratch[LANES + lane] += weight * summand(basis, squared, c)


@kernel
def _sum_at_points(
    scratch: Floats, points: Floats, frames: Floats, weights: Floats, basis: int, shift: float, c: float
) -> None:
    """Sum as `_sum_points` does, with the basis as a constant in each copy, so that its loops are vectorised."""
    if basis == GAUSSIAN:
        _sum_points(scratch, points, frames, weights, GAUSSIAN, shift, c)
    elif basis == MULTIQUADRIC:
        _sum_points(scratch, points, frames, weights, MULTIQUADRIC, shift, c)
    elif basis == INVERSE_MULTIQUADRIC:
        _sum_points(scratch, points, frames, weights, INVERSE_MULTIQUADRIC, shift, c)
    else:
        _sum_points(scratch, points, frames, weights, THIN_PLATE_SPLINE, shift, c)


@kernel(inline=True, fastmath=_FUSED)
def _sum_points(
    scratch: Floats, points: Floats, frames: Floats, weights: Floats, basis: int, shift: float, c: float
) -> None:
    """Write s of `LANES` points into the last quarter of `scratch` (4 LANES,); their x, y and z are in the others."""
    first = points.shape[1]
    for lane in range(LANES):
        scratch[3 * LANES + lane] = 0.0
    for n in range(first):
        px, py, pz, weight = points[0, n], points[1, n], points[2, n], weights[n]
        for lane in range(LANES):
            wx, wy, wz = scratch[lane] - px, scratch[LANES + lane] - py, scratch[2 * LANES + lane] - pz
            scratch[3 * LANES + lane] += weight * summand(basis, wx * wx + wy * wy + shift + wz * wz, c)
    for n in range(frames.shape[1]):
        sx, sy, sz, length, weight = frames[0, n], frames[1, n], frames[2, n], frames[11, n], weights[first + n]
        bx, by, ox, oy, oz = frames[3, n], frames[4, n], frames[5, n], frames[6, n], frames[7, n]
        ax, ay, az = frames[8, n], frames[9, n], frames[10, n]
        for lane in range(LANES):
            wx, wy, wz = scratch[lane] - sx, scratch[LANES + lane] - sy, scratch[2 * LANES + lane] - sz
            beside = wx * bx + wy * by
            over, along = wx * ox + wy * oy + wz * oz, wx * ax + wy * ay + wz * az
            squared = squared_in_frame(beside * beside + shift, over, along, length)
            scratch[3 * LANES + lane] += weight * summand(basis, squared, c)
