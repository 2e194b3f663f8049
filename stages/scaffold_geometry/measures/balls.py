"""Balls about the voxels of an image, each with a radius of its own: what the greatest ball over each voxel is.

A ball of squared radius s, in voxels, about a voxel holds the voxels whose middles are nearer than the root of s; with
s the squared distance to the nearest voxel of another phase, it is the greatest ball in the phase. Squared distances
between middles are whole numbers, so that nothing here is rounded.

Balls within others are left out by a table of which balls hold which about a neighbour: E. Remy and E. Thiel, "Exact
medial axis with Euclidean distance", Image and Vision Computing 23 (2005).
"""

from __future__ import annotations

import math

import numpy as np

from scaffold_geometry.arrays import Bools, Ints, Singles
from scaffold_geometry.jit import kernel, parallel_kernel, prange

_LAYERS = 16
"""Layers of the image that a thread fills at a time."""

MOST_PAINTED = 4e10
"""Voxels painted for one image at most, each as often as balls hold it: a minute or two of two cores."""

TABLE_END = 4096
"""Squared radius up to which balls are compared voxel by voxel; above, as if they were round."""


def greatest_balls(squared: Singles) -> Singles:
    """Return the squared radius of the greatest ball over each voxel, of `squared` (nx, ny, nz) about each, 0 for none.

    Exact where the balls hold fewer than `MOST_PAINTED` voxels in all. Above, they are painted on voxels twice as
    large, and so on: each then reaches half a diagonal of these further, so that no voxel gets too small a value, and
    one nearer than a diagonal to a greater ball may get its: 512^3 voxels with struts of 135 of them gave 139.
    """
    coarse, step = squared, 1
    while True:
        needed = np.empty(coarse.shape, bool)
        mark_maximal_balls(coarse if step == 1 else np.floor(coarse), containment_table(TABLE_END), needed)
        centres = np.flatnonzero(needed)
        values = coarse.ravel()[centres]
        if 4.0 / 3.0 * math.pi * float((values.astype(np.float64) ** 1.5).sum()) <= MOST_PAINTED:
            break
        coarse, step = _halve_resolution(coarse), 2 * step
    greatest = coarse.copy()
    reaches = values if step == 1 else np.ceil((np.sqrt(values) + np.float32(math.sqrt(0.75))) ** 2)
    paint_balls(centres, reaches, values, greatest)
    return greatest if step == 1 else _refine_resolution(greatest, step, squared)


def _halve_resolution(squared: Singles) -> Singles:
    """Return the greatest of each 2 x 2 x 2 voxels, in voxels twice as large."""
    even = np.pad(squared, [(0, count % 2) for count in squared.shape])
    for axis in range(3):
        pairs = np.moveaxis(even, axis, 0)
        even = np.moveaxis(np.maximum(pairs[::2], pairs[1::2]), 0, axis)
    return np.ascontiguousarray(even / np.float32(4.0))


def _refine_resolution(greatest: Singles, step: int, squared: Singles) -> Singles:
    """Return the values of voxels `step` times as large, where there are balls, on the voxels themselves."""
    fine = squared.copy()
    for x in range(step):
        for y in range(step):
            for z in range(step):
                part = fine[x::step, y::step, z::step]
                found = greatest[: part.shape[0], : part.shape[1], : part.shape[2]] * np.float32(step**2)
                np.maximum(part, found, out=part, where=part > 0.0)
    return fine


@kernel
def containment_table(end: int) -> Singles:
    """Return (4, end + 1): at [n, s], the least squared radius about a neighbour that holds the ball of s.

    n is 1, 2 or 3 for a neighbour across a face, an edge or a corner: its squared distance.
    """
    table = np.zeros((4, end + 1), np.float32)
    reach = math.ceil(math.sqrt(end))
    for x in range(-reach, reach + 1):
        for y in range(-reach, reach + 1):
            for z in range(-reach, reach + 1):
                within = x * x + y * y + z * z + 1
                if within > end:
                    continue
                for steps in range(1, 4):
                    needed = (x + 1) ** 2 + (y + (steps > 1)) ** 2 + (z + (steps > 2)) ** 2 + 1
                    table[steps, within] = max(table[steps, within], needed)
    for steps in range(1, 4):
        for s in range(1, end + 1):
            table[steps, s] = max(table[steps, s], table[steps, s - 1])
    return table


@parallel_kernel
def mark_maximal_balls(squared: Singles, table: Singles, needed: Bools) -> None:
    """Tell at which voxels the ball of `squared` (nx, ny, nz) is in no neighbour's, nor in all of theirs together.

    0 is no ball. The balls that are left cover all that the others did, but for the other's middle, with balls at
    least as great.
    """
    nx, ny, nz = squared.shape
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                needed[i, j, k] = squared[i, j, k] > 0.0 and _is_maximal(squared, table, i, j, k)


@kernel
def _is_maximal(squared: Singles, table: Singles, i: int, j: int, k: int) -> bool:
    nx, ny, nz = squared.shape
    own = squared[i, j, k]
    is_amid = True
    for x in range(-1, 2):
        for y in range(-1, 2):
            for z in range(-1, 2):
                steps = abs(x) + abs(y) + abs(z)
                if steps == 0:
                    continue
                a, b, c = i + x, j + y, k + z
                if not (0 <= a < nx and 0 <= b < ny and 0 <= c < nz):
                    is_amid = False
                    continue
                other = squared[a, b, c]
                if other < own:
                    is_amid = False
                elif own < table.shape[1]:
                    if other >= table[steps, int(own)]:
                        return False
                elif math.sqrt(other) >= math.sqrt(own) + math.sqrt(steps):
                    return False
    return not is_amid


@parallel_kernel
def paint_balls(centres: Ints, reaches: Singles, values: Singles, greatest: Singles) -> None:
    """Raise `greatest` (nx, ny, nz) to the value of each ball over it.

    `centres` (n,) are flat indices, rising; `reaches` (n,) squared radii, in whole numbers. Each thread paints layers
    of its own.
    """
    nx, ny, nz = greatest.shape
    farthest = _reach(reaches.max()) if len(reaches) else 0
    for slab in prange((nx + _LAYERS - 1) // _LAYERS):
        low, high = slab * _LAYERS, min((slab + 1) * _LAYERS, nx)
        first = np.searchsorted(centres, (low - farthest) * ny * nz)
        last = np.searchsorted(centres, (high + farthest) * ny * nz)
        for ball in range(first, last):
            _paint(centres[ball], reaches[ball], values[ball], low, high, greatest)


@kernel
def _paint(centre: int, squared: float, value: float, low: int, high: int, greatest: Singles) -> None:
    _, ny, nz = greatest.shape
    k = centre % nz
    j = centre // nz % ny
    i = centre // nz // ny
    reach = _reach(squared)
    for x in range(max(i - reach, low), min(i + reach + 1, high)):
        left = squared - (x - i) * (x - i)
        across = _reach(left)
        for y in range(max(j - across, 0), min(j + across + 1, ny)):
            along = _reach(left - (y - j) * (y - j))
            row = greatest[x, y, max(k - along, 0) : min(k + along + 1, nz)]
            for z in range(len(row)):
                row[z] = max(row[z], value)


@kernel(inline=True)
def _reach(squared: float) -> int:
    """Return the greatest whole number whose square is below `squared`, a whole number; -1 for 0."""
    if squared <= 0.0:
        return -1
    return int(math.sqrt(squared - 1.0))
