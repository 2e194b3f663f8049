"""How a solid hangs together: its Euler number, pieces, cavities and loops, and the density of its connections."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_stages._kernels.triangles import (
    corner_fans,
    edge_faults,
    euler_characteristic,
    face_pieces,
    piece_volumes,
)
from scaffold_stages._measures.image import STRUT, VoxelImage

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_PLANES = 16
"""Planes of voxels that are counted at once."""


class Connectivity(NamedTuple):
    """The topology of a solid: its Euler number is pieces - loops + cavities.

    `pieces`: parts that do not hang together; `cavities`: closed pores; `loops`: struts that could be cut before a
    piece falls apart, summed over the pieces (the genus of its surfaces, the first Betti number).
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


def connectivity(vertices: Floats, faces: Ints) -> Connectivity | None:
    """Return how a closed solid, (n, 3) mm and (m, 3), hangs together; None where its surface is not closed.

    From vertices - edges + faces of the surface, which is twice the solid's Euler number: exact, of what the file
    holds, where voxels close gaps and break struts thinner than they are. Parts of the surface that touch in a vertex
    count as apart there. A surface with an edge of one face, or of more than two, bounds nothing that could be
    counted.
    """
    if any(edge_faults(faces)) or not len(faces):
        return None
    apart = corner_fans(faces)
    volumes = piece_volumes(vertices, faces, face_pieces(faces))
    pieces, cavities = int((volumes > 0.0).sum()), int((volumes < 0.0).sum())
    return Connectivity(pieces, cavities, pieces + cavities - euler_characteristic(apart) // 2)


def euler_number(image: VoxelImage) -> int:
    """Return the Euler number of the struts of a voxel image: voxels that touch in a corner hang together.

    Vertices - edges + faces - cubes of the closed voxels, those that share a corner, edge or face counted once (26
    neighbours to a voxel, 6 for the pores; as BoneJ and scikit-image count). 16 planes at a time: a fifth of the
    image's size is needed beside it at 512^3.
    """
    return sum(_of_slab(image.phases, first) for first in range(0, len(image.phases) - 1, _PLANES))


def _of_slab(phases: NDArray[np.uint8], first: int) -> int:
    """Return the share of planes `first` to `first + _PLANES` in the Euler number; the outermost voxels are no strut.

    What lies between two voxels belongs to the slab of the voxel before it.
    """
    voxels = phases[first : first + _PLANES + 1] == STRUT
    planes = voxels[:_PLANES]
    number = 0
    for x_joined, part in ((False, planes), (True, voxels[:-1] | voxels[1:])):
        for y_joined in (False, True):
            rows = part[:, :-1] | part[:, 1:] if y_joined else part
            for z_joined in (False, True):
                cells = rows[:, :, :-1] | rows[:, :, 1:] if z_joined else rows
                joined = x_joined + y_joined + z_joined
                number += (1 if joined % 2 else -1) * int(np.count_nonzero(cells))
    return number
