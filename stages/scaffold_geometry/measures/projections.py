"""Projected areas of the triangles of a surface along directions."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.jit import parallel_kernel, prange


@parallel_kernel
def projected_areas(x: Floats, y: Floats, z: Floats, directions: Floats) -> Floats:
    """Return the sum of the triangles' projections along each of `directions` (n, 3), front and back, (n,).

    `x`, `y`, `z` (m,): normals as long as the triangles' areas. One thread sums a direction, in the order of the
    triangles, so that the sums do not depend on the number of threads.
    """
    sums = np.zeros(len(directions))
    for n in prange(len(directions)):
        u, v, w = directions[n]
        total = 0.0
        for i in range(len(x)):
            total += abs(u * x[i] + v * y[i] + w * z[i])
        sums[n] = total
    return sums
