"""How much of a body is pore, how much of that is open to the outside, and what is shut in.

Pores hang together across the faces of voxels, struts across faces, edges and corners: two diagonals of the same four
voxels would otherwise cross. T. Y. Kong, A. Rosenfeld, "Digital topology: introduction and survey", Computer Vision,
Graphics and Image Processing 48 (1989).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_stages._measures.image import PORE, STRUT, Bools, Floats, VoxelImage


class Void(NamedTuple):
    """A pore that is shut in: its volume, mm^3, and its middle, (3,) mm, the mean of its voxels."""

    volume: float
    place: Floats


class Porosity(NamedTuple):
    """Shares of the volume of the outer shape, pieces, and the closed pores, largest first.

    `total` is the share of pore, `open` of pore with a way out, `closed` the rest of it; `solid` is 1 - total, BV/TV.
    `pore_pieces` are the pieces of the pore space within the outer shape, a way around outside not counted;
    `strut_pieces` those of the struts.
    """

    total: float
    open: float
    closed: float
    solid: float
    pore_pieces: int
    strut_pieces: int
    voids: tuple[Void, ...]


def porosity(image: VoxelImage) -> Porosity:
    """Return the porosity of an image with a voxel of either phase; each share is off as its volume, see `voxelise`.

    A pore that is open by less than a voxel may be closed in the image, and a wall thinner than a voxel may be open.
    Takes 10 bytes a voxel.
    """
    voids = _voids(image)
    pores, struts = (int(np.count_nonzero(image.is_phase(phase))) for phase in (PORE, STRUT))
    whole = max(pores + struts, 1)
    shut = round(sum(void.volume for void in voids) / image.spacing**3)
    return Porosity(
        total=pores / whole,
        open=(pores - shut) / whole,
        closed=shut / whole,
        solid=struts / whole,
        pore_pieces=_pieces(image.is_phase(PORE), 1)[1],
        strut_pieces=_pieces(image.is_phase(STRUT), 3)[1],
        voids=voids,
    )


def _voids(image: VoxelImage) -> tuple[Void, ...]:
    """Return the pores that do not hang together with the image's outermost layer through anything but struts."""
    from scaffold_stages._kernels.pieces import piece_sums

    labels, count = _pieces(~image.is_phase(STRUT), 1)
    sums = piece_sums(labels, image.phases, PORE, count)
    sums[labels[0, 0, 0]] = 0.0
    shut = sums[sums[:, 0] > 0.0]
    shut = shut[np.argsort(-shut[:, 0], kind="stable")]
    volumes = shut[:, 0] * image.spacing**3
    places = image.origin + image.spacing * shut[:, 1:] / shut[:, :1]
    return tuple(Void(float(volume), place) for volume, place in zip(volumes, places, strict=True))


def _pieces(mask: Bools, connectivity: int) -> tuple[NDArray[np.int32], int]:
    """Label the pieces of a mask that hang together across faces (1), or faces, edges and corners (3)."""
    from scipy.ndimage import generate_binary_structure, label

    labels, count = label(mask, generate_binary_structure(3, connectivity))
    return labels, int(count)
