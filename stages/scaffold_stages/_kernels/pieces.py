"""How large the pieces of a labelled image are, and where."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_stages._kernels._jit import kernel

Floats = NDArray[np.float64]


@kernel
def piece_sums(labels: NDArray[np.int32], phases: NDArray[np.uint8], phase: int, count: int) -> Floats:
    """Return for each label (count + 1, 4) how many voxels have it and the phase, and the sums of their indices."""
    sums = np.zeros((count + 1, 4))
    nx, ny, nz = labels.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if phases[i, j, k] == phase:
                    piece = sums[labels[i, j, k]]
                    piece[0] += 1.0
                    piece[1] += i
                    piece[2] += j
                    piece[3] += k
    return sums
