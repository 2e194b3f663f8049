"""Scan conversion: the samples of a grid inside a closed surface, from the columns that its triangles cross.

A sample's winding number is the sum of the orientations of the triangles below it in its column. The samples below a
triangle are found row by row, by W. Randolph Franklin's crossings rule in the plane. Each edge is intersected with a
row from its lower to its upper end, so that both triangles of an edge get the same point to the last bit; so each
column is crossed once, even if samples are on edges or corners. Intervals are half-open: a sample on a face at the low
end of a body, on any axis, is inside, one on a face at the high end is outside, so adjacent bodies share no sample.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.jit import kernel


@kernel
def add_turns(vertices: Floats, faces: Ints, turns: NDArray[np.int8], sums: NDArray[np.int32]) -> None:
    """Add +1 (entering) or -1 (leaving) to `turns` (nx, ny, nz) at the first sample of a column above each crossing.

    `vertices` (n, 3) are in samples from the first one. `sums` (nx, ny) are the sums over all crossings of each column,
    also above its last sample: 0 if the surface of `faces` (m, 3) is closed.
    """
    nx, ny, nz = turns.shape
    corner = np.empty((3, 3))
    ends = np.empty(
        (2, 2)
    )  # x and z where the row leaves the triangle to the left of a rising edge, and of a falling one
    for face in range(len(faces)):
        for side in range(3):
            for axis in range(3):
                corner[side, axis] = vertices[faces[face, side], axis]
        low = min(corner[0, 1], corner[1, 1], corner[2, 1])
        high = max(corner[0, 1], corner[1, 1], corner[2, 1])
        for row in range(max(math.ceil(low), 0), min(math.ceil(high), ny)):
            _intersect_row(corner, row, ends)
            rises, falls = ends[0, 0], ends[1, 0]
            sign = -1 if rises > falls else 1
            first, last = math.ceil(min(rises, falls)), math.ceil(max(rises, falls))
            for column in range(max(first, 0), min(last, nx)):
                height = ends[1, 1] + (column - falls) / (rises - falls) * (ends[0, 1] - ends[1, 1])
                sums[column, row] += sign
                above = max(math.ceil(height), 0)
                if above < nz:
                    turns[column, row, above] += sign


@kernel(inline=True)
def _intersect_row(corner: Floats, row: int, ends: Floats) -> None:
    """Intersect a row with the two edges of a triangle that go from on or below it to above it."""
    for side in range(3):
        start, end = side, (side + 1) % 3
        if (corner[start, 1] <= row) == (corner[end, 1] <= row):
            continue
        is_falling = 0 if corner[start, 1] <= row else 1
        below, over = (end, start) if is_falling else (start, end)
        share = (row - corner[below, 1]) / (corner[over, 1] - corner[below, 1])
        ends[is_falling, 0] = corner[below, 0] + share * (corner[over, 0] - corner[below, 0])
        ends[is_falling, 1] = corner[below, 2] + share * (corner[over, 2] - corner[below, 2])


@kernel
def mark_inside(turns: NDArray[np.int8], phases: NDArray[np.uint8], within: int, phase: int) -> None:
    """Set `phase` at the samples of `phases` (nx, ny, nz) that are inside and have the phase `within`."""
    nx, ny, nz = turns.shape
    for i in range(nx):
        for j in range(ny):
            winding = 0
            for k in range(nz):
                winding += turns[i, j, k]
                if winding > 0 and phases[i, j, k] == within:
                    phases[i, j, k] = phase
