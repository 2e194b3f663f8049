"""The value of the nearest voxel that has one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Singles
from scaffold_geometry.jit import kernel

_REACH = 2
"""Search distance from a point, voxels."""


@kernel
def nearest_values(values: Singles, points: Floats) -> Floats:
    """Return the value of the nearest voxel above 0 at each point (n, 3), in voxels; 0 if none is near."""
    nearest = np.zeros(len(points))
    for point in range(len(points)):
        at = np.empty(3, np.int64)
        for axis in range(3):
            at[axis] = round(points[point, axis])
        nearest[point] = _nearest(values, at, points[point])
    return nearest


@kernel
def _nearest(values: Singles, at: NDArray[np.int64], point: Floats) -> float:
    least, value = np.inf, 0.0
    for i in range(max(at[0] - _REACH, 0), min(at[0] + _REACH + 1, values.shape[0])):
        for j in range(max(at[1] - _REACH, 0), min(at[1] + _REACH + 1, values.shape[1])):
            for k in range(max(at[2] - _REACH, 0), min(at[2] + _REACH + 1, values.shape[2])):
                apart = (i - point[0]) ** 2 + (j - point[1]) ** 2 + (k - point[2]) ** 2
                if values[i, j, k] > 0.0 and apart < least:
                    least, value = apart, float(values[i, j, k])
    return value
