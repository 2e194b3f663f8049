"""Voxel images that the tests make themselves, and what scipy makes of them by the plain definitions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, generate_binary_structure, label

from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT, VoxelImage

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def image_of(is_strut: Bools, spacing: float = 1.0, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> VoxelImage:
    """Return the image of an array of struts and pores, with a layer of OUTSIDE around it, that begins at `origin`."""
    phases = np.pad(np.where(is_strut, STRUT, PORE).astype(np.uint8), 1)
    return VoxelImage(phases, np.array(origin), spacing)


def places(shape: tuple[int, int, int]) -> NDArray[np.float64]:
    """Return the places of voxels about the middle of an array, (nx, ny, nz, 3)."""
    middle = (np.array(shape) - 1) / 2.0
    return np.moveaxis(np.indices(shape), 0, -1) - middle


def gyroid(count: int, level: float, periods: float = 2.0) -> Bools:
    x, y, z = np.moveaxis((places((count, count, count)) + 0.3) * periods * 2.0 * np.pi / count, -1, 0)
    return np.asarray(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) > level)


def blobs(count: int, share: float, seed: int, size: float = 2.5) -> Bools:
    """Return blobs that fill a share of a cube."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(count, count, count)), size, mode="wrap")
    return np.asarray(noise > np.quantile(noise, 1.0 - share))


def squared(mask: Bools) -> Ints:
    """Return the squared distances to the nearest voxel that is not in the mask."""
    return np.asarray(np.rint(distance_transform_edt(mask) ** 2), np.int64)


def covered(mask: Bools, capacity: Ints, seeds_at: Any) -> Ints:  # noqa: ANN401 - a function of a level
    """Return the greatest level whose balls, about the seeds of that level, cover each voxel of the mask."""
    greatest = np.zeros(mask.shape, np.int64)
    for level in np.unique(capacity[mask & (capacity > 0)])[::-1]:
        seeds = seeds_at(level)
        if seeds.any():
            greatest[(squared(~seeds) < level) & (greatest == 0)] = level
    return np.where(mask, greatest, 0)


def thickness_oracle(mask: Bools) -> Ints:
    """Return the squared radius of the greatest ball in the mask over each voxel: an opening for every size."""
    depth = squared(np.pad(mask, 1))[1:-1, 1:-1, 1:-1]
    return covered(mask, depth, lambda level: depth >= level)


def access_oracle(phases: NDArray[np.uint8], connectivity: int = 3, *, whole_radii: bool = False) -> Ints:
    """Return the squared radius of the greatest ball that reaches each pore voxel: an opening for every size."""
    is_pore = phases == PORE
    depth = squared(phases != STRUT)
    if whole_radii:
        depth = np.floor(np.sqrt(depth)).astype(np.int64) ** 2

    def seeds_at(level: int) -> Bools:
        ways = generate_binary_structure(3, connectivity if level > 1 else 1)
        labels, _ = label((is_pore & (depth >= level)) | (phases == OUTSIDE), ways)
        return np.asarray(is_pore & (labels == labels[0, 0, 0]))

    return covered(is_pore, depth, seeds_at)
