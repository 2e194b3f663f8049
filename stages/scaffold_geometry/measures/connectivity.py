"""The connectivity of a solid: Euler number, pieces, cavities, loops and connectivity density."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Ints


class Connectivity(NamedTuple):
    """The topology of a solid: its Euler number is pieces - loops + cavities.

    `pieces`: connected parts; `cavities`: closed pores; `loops`: number of independent loops, summed over the pieces
    (the genus of its surfaces, the first Betti number).
    """

    pieces: int
    cavities: int
    loops: int

    @property
    def euler_number(self) -> int:
        """Return the Euler number of the solid, not of its surface, which has twice that."""
        return self.pieces - self.loops + self.cavities

    def density(self, total_volume: float) -> float:
        """Return Conn.D, mm^-3: (1 - Euler number) in a `total_volume`, mm^3, of the outer shape.

        A. Odgaard, H. J. G. Gundersen, Bone 14 (1993) 173-182. A piece apart or a cavity lowers it: it is the number
        of loops only of one piece without cavities. Of a whole body, so without BoneJ's correction for the edges of a
        sample that was cut out of one.
        """
        return (1 - self.euler_number) / total_volume


def connectivity(faces: Ints, pieces: int, cavities: int) -> Connectivity:
    """Return the connectivity of a solid with these numbers of pieces and cavities; `faces` (m, 3) are closed.

    From vertices - edges + faces of the surface, where three edges belong to two faces, which is twice the solid's
    Euler number: exact, of what the file holds, where voxels close gaps and break struts thinner than they are.
    """
    of_surface = len(np.unique(faces)) - len(faces) // 2
    return Connectivity(pieces, cavities, pieces + cavities - of_surface // 2)
