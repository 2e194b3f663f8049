"""The voxel image of a scaffold for volumetric measures: outside, pore or strut on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats

OUTSIDE, PORE, STRUT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class VoxelImage:
    """The phase of each voxel: `phases` (nx, ny, nz) uint8, `OUTSIDE` (of the outer shape), `PORE` or `STRUT`.

    Voxel [i, j, k] is a cube of edge `spacing`, mm, about `origin + spacing * (i, j, k)`, mm. The outermost layer of
    voxels is `OUTSIDE`.
    """

    phases: NDArray[np.uint8]
    origin: Floats
    spacing: float

    def is_phase(self, phase: int) -> Bools:
        """Return which voxels have `phase`, (nx, ny, nz)."""
        return np.equal(self.phases, phase)

    def place(self, voxel: tuple[int, ...]) -> Floats:
        """Return the centre of a voxel, (3,) mm."""
        return np.asarray(self.origin + self.spacing * np.asarray(voxel))
