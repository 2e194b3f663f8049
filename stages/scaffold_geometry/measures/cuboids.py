"""The largest box of set voxels, by exhaustive search: for every range of layers, the largest rectangle."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Ints
from scaffold_geometry.jit import kernel


@kernel
def largest_cuboid(inside: Bools) -> Ints:
    """Return the box of most voxels in `inside` (nx, ny, nz): its first voxels and those after its last, (2, 3).

    Every range of layers along x is tried; over it a voxel column is free where all are inside, and the largest
    rectangle of free columns is that below the skyline of their runs (the classic of stacks of bars). Time goes with
    nx^2 ny nz. Of boxes alike in volume the first counts, in the order of x, then y. All zero where nothing is inside.
    """
    nx, ny, nz = inside.shape
    best = np.zeros((2, 3), np.int64)
    most = 0
    for low in range(nx):
        free = np.ones((ny, nz), np.bool_)
        for high in range(low, nx):
            for j in range(ny):
                for k in range(nz):
                    free[j, k] &= inside[high, j, k]
            volume = _largest_rectangle(free, most // (high - low + 1), best[:, 1:]) * (high - low + 1)
            if volume > most:
                most = volume
                best[0, 0] = low
                best[1, 0] = high + 1
    return best


@kernel
def _largest_rectangle(free: Bools, to_beat: int, best: Ints) -> int:
    """Return the area of the largest rectangle in `free` and write its place to `best`, (2, 2), where above `to_beat`.

    The stack holds bars of growing height: one is closed, and its rectangle known, by the first lower bar.
    """
    ny, nz = free.shape
    heights = np.zeros(nz + 1, np.int64)
    starts = np.empty(nz + 1, np.int64)
    levels = np.empty(nz + 1, np.int64)
    largest = to_beat
    for j in range(ny):
        depth = 0
        for k in range(nz + 1):
            if k < nz:
                heights[k] = heights[k] + 1 if free[j, k] else 0
            start = k
            while depth > 0 and levels[depth - 1] >= heights[k]:
                depth -= 1
                start = starts[depth]
                area = levels[depth] * (k - start)
                if area > largest:
                    largest = area
                    best[0, 0], best[0, 1] = j + 1 - levels[depth], start
                    best[1, 0], best[1, 1] = j + 1, k
            starts[depth] = start
            levels[depth] = heights[k]
            depth += 1
    return largest if largest > to_beat else 0
