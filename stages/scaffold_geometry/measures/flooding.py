"""The widest path from outside to each voxel of an image: the largest ball that gets there, and its throat.

The widest path from one place to all, whose narrowest place is the widest that there is: M. Pollack, "The maximum
capacity through a network", Operations Research 8 (1960). Here the places are voxels and the capacity of each is its
squared distance, a whole number, so that a list for each number serves as the queue.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Ints, Singles
from scaffold_geometry.jit import kernel

_NONE = -1


@kernel
def flood(squared: Singles, following: NDArray[np.int32], top: int) -> tuple[Ints, Ints]:
    """Flood an image from its first voxel: turn `squared` (nx, ny, nz) where the flood comes, to minus the widest way.

    `squared` is a voxel's capacity, a whole number up to `top`, inf where anything passes, 0 in a wall. A way goes on
    across faces; across edges and corners also, where a ball of the root of 2 or more fits in. `following`, as many
    flat places, is room to work in. Returns for each capacity (top + 1,) how many voxels the widest of its throats
    lets in at once, and where that is, a flat index: a throat is the voxel at which a way becomes so narrow.
    """
    gains, places = np.zeros(top + 1, np.int64), np.full(top + 1, _NONE, np.int64)
    heads = np.full(top + 1, _NONE, np.int32)
    flat = squared.reshape(-1)
    flat[0] = -np.inf
    following[0] = _NONE
    _spread(0, squared, following, heads, np.inf)
    for level in range(top, 0, -1):
        while heads[level] != _NONE:
            throat = heads[level]
            heads[level] = following[throat]
            following[throat] = _NONE
            gain = _spread(throat, squared, following, heads, float(level))
            if gain > gains[level]:
                gains[level], places[level] = gain, throat
    return gains, places


@kernel
def _spread(start: int, squared: Singles, following: NDArray[np.int32], heads: NDArray[np.int32], level: float) -> int:
    """Flood what lies behind a voxel and is as wide as `level`; queue what is narrower. Return the voxels flooded."""
    nx, ny, nz = squared.shape
    stack, flooded = start, 0
    while stack != _NONE:
        at = stack
        stack = following[at]
        flooded += 1
        k, j, i = at % nz, at // nz % ny, at // nz // ny
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    width = min(squared[a, b, c], level)
                    if width <= 0.0 or (width < 2.0 and abs(a - i) + abs(b - j) + abs(c - k) > 1):
                        continue
                    squared[a, b, c] = -width
                    voxel = (a * ny + b) * nz + c
                    if width < level:
                        following[voxel] = heads[int(width)]
                        heads[int(width)] = voxel
                    else:
                        following[voxel] = stack
                        stack = voxel
    return flooded
