"""The part of an outer shape that is a box: where porosity and cross-section are well defined."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.measures.cuboids import largest_cuboid
from scaffold_geometry.voxels.image import OUTSIDE, VoxelImage

_BLOCKS = 128
"""Blocks along the longest side of an image among which the largest box is sought."""


class InscribedBox(NamedTuple):
    """A box of voxels: the first, (3,), those after the last, (3,), and its share of the outer shape's volume."""

    first: Ints
    end: Ints
    share: float

    @property
    def sides(self) -> Ints:
        """Return the voxels along each side, (3,)."""
        return self.end - self.first

    def bounds(self, image: VoxelImage) -> Floats:
        """Return the box's lower and upper corner, (2, 3) mm."""
        return np.asarray(image.origin + image.spacing * (np.stack([self.first, self.end]) - 0.5))


def inscribed_box(image: VoxelImage) -> InscribedBox | None:
    """Return the largest axis-aligned box of voxels within the outer shape; None where the shape has no voxel.

    Exact in images of up to 128 voxels a side. In larger ones the largest box is that of blocks wholly inside, grown
    by whole layers of voxels while they are inside: it cannot grow on any side, and falls short of the largest by less
    than two blocks a side.
    """
    size = -(-max(image.phases.shape) // _BLOCKS)
    blocks: Ints = largest_cuboid(_blocks_inside(image, size))
    found = size * blocks if blocks.any() else _one_voxel(image)
    if found is None:
        return None
    _grow(image, found)
    inside = image.phases.size - np.count_nonzero(image.is_phase(OUTSIDE))
    return InscribedBox(found[0], found[1], float(np.prod(found[1] - found[0]) / inside))


def _blocks_inside(image: VoxelImage, size: int) -> Bools:
    """Return which blocks of `size` voxels a side lie wholly inside; those cut by the end of the image do not."""
    counts = [length // size for length in image.phases.shape]
    blocks = np.empty(counts, bool)
    for i in range(counts[0]):
        slab = image.phases[i * size : (i + 1) * size, : counts[1] * size, : counts[2] * size] != OUTSIDE
        blocks[i] = slab.reshape(size, counts[1], size, counts[2], size).all(axis=(0, 2, 4))
    return blocks


def _one_voxel(image: VoxelImage) -> Ints | None:
    """Return the first voxel inside as a box: where no block fits, the shape is thin, and any box of it small."""
    first = int(np.argmax(image.phases != OUTSIDE))
    place = np.array(np.unravel_index(first, image.phases.shape))
    return np.stack([place, place + 1]) if image.phases[tuple(place)] != OUTSIDE else None


def _grow(image: VoxelImage, box: Ints) -> None:
    """Move the sides of `box` (2, 3) out, one layer each in turn, until none can move: so all grow alike."""
    grown = True
    while grown:
        grown = False
        for axis in range(3):
            for side, step in ((0, -1), (1, 1)):
                layer = [slice(low, high) for low, high in box.T]
                at = box[0, axis] - 1 if side == 0 else box[1, axis]
                layer[axis] = slice(at, at + 1)
                if 0 <= at < image.phases.shape[axis] and (image.phases[tuple(layer)] != OUTSIDE).all():
                    box[side, axis] += step
                    grown = True
