"""Regular grids over a shape: the positions of samples, and which are inside."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints


def grid_over(bounds: Floats, spacing: float, margin: int) -> tuple[Floats, tuple[int, int, int]]:
    """Return origin (3,) and shape of the grid that covers `bounds` (2, 3) and `margin` samples more on each side.

    The grid is centred on the bounds, so that a symmetric shape gets a symmetric grid.
    """
    size = bounds[1] - bounds[0]
    intervals = np.ceil(size / spacing - 1e-9).astype(int) + 2 * margin
    origin = bounds.mean(axis=0) - spacing * intervals / 2.0
    return origin, (int(intervals[0]) + 1, int(intervals[1]) + 1, int(intervals[2]) + 1)


def samples_inside(vertices: Floats, faces: Ints, origin: Floats, spacing: float, shape: tuple[int, int, int]) -> Bools:
    """Return which samples of a grid are inside a closed surface, (nx, ny, nz).

    Samples exactly on it belong to the body above them on each axis. VTK's stencil gives the same for all others and
    takes up to 90 times as long (docs/decisions/libraries.md).
    """
    from scaffold_geometry.voxels.scan_conversion import add_turns, mark_inside

    turns, sums, inside = np.zeros(shape, np.int8), np.zeros(shape[:2], np.int32), np.zeros(shape, np.uint8)
    add_turns((vertices - origin) / spacing, np.asarray(faces, np.int64), turns, sums)
    mark_inside(turns, inside, 0, 1)
    return inside.view(np.bool_)


def dilate(inside: Bools, steps: int) -> Bools:
    """Return the samples within `steps` of those `inside`, diagonal neighbours included."""
    result = inside.copy()
    for axis in range(inside.ndim):
        before, line = result.copy(), np.moveaxis(result, axis, 0)
        given = np.moveaxis(before, axis, 0)
        for step in range(1, steps + 1):
            line[step:] |= given[:-step]
            line[:-step] |= given[step:]
    return result
