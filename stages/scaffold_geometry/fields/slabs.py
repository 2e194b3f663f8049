"""The normalised field on voxels: in one piece, or in slabs of whole tiles along x that other processes compute.

A tile is computed by the same operations in any slab: no bit depends on the division of the grid.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Singles
from scaffold_geometry.fields.sampling import Voxels
from scaffold_geometry.fields.shepard import Segments, bin_segments
from scaffold_geometry.fields.shepard_grid import TILE, field_on_tiles

VOXELS_AT_ONCE = 2**24
"""Approximate number of voxels in a slab: seconds of work, and 80 MB to transfer."""


def compute_slab(segments: Segments, voxels: Voxels, box: float, layers: slice = slice(None)) -> tuple[Singles, int]:
    """Return the field on the `layers` along x of `voxels`, -1 away from the outer shape, and a count.

    The count is the number of samples inside the outer shape within reach of struts only or of channels only. `box` is
    the edge of the boxes that segments are sorted into, in mean edge lengths.
    """
    first, step = (voxels.origin - segments.centre) / segments.unit, voxels.spacing / segments.unit
    samples = TILE * max(round(box / (TILE * step)), 1)
    nx, ny, nz = (-(-count // samples) for count in voxels.inside.shape)
    bins = bin_segments(segments, first - step / 2.0, np.full(3, samples * step), (nx, ny, nz))
    values = np.empty(voxels.inside.shape, np.float32)
    values[layers] = -1.0
    active = _active_tiles(voxels.near, TILE)
    return values[layers], field_on_tiles(segments, bins, first, step, active, voxels.inside, values)


def compute_in_slabs(segments: Segments, voxels: Voxels, box: float, executor: Executor) -> tuple[Singles, int]:
    """Return the result of `compute_slab`, computed in slabs by `executor`."""
    count, layer = voxels.inside.shape[0], voxels.inside[0].size
    thickness = TILE * max(round(VOXELS_AT_ONCE / (TILE * layer)), 1)
    slabs = [slice(start, min(start + thickness, count)) for start in range(0, count, thickness)]
    segments.__dict__.pop("table", None)  # it can be computed again, and need not be transferred
    bare = replace(voxels, inside=np.empty(0, bool), near=np.empty(0, bool))
    futures = [
        executor.submit(_slab, segments, bare, box, (slab, count), voxels.inside[slab], voxels.near[slab])
        for slab in slabs
    ]
    values, half_reached = np.empty(voxels.inside.shape, np.float32), 0
    for slab, future in zip(slabs, futures, strict=True):
        values[slab], some = future.result()
        half_reached += some
    return values, half_reached


def _slab(
    segments: Segments, bare: Voxels, box: float, place: tuple[slice, int], inside: Bools, near: Bools
) -> tuple[Singles, int]:
    """Compute a slab at its place in a grid that is void elsewhere; the system allocates no memory for the void."""
    slab, count = place
    masks = [np.zeros((count, *inside.shape[1:]), bool) for _ in range(2)]
    for mask, part in zip(masks, (inside, near), strict=True):
        mask[slab] = part
    return compute_slab(segments, replace(bare, inside=masks[0], near=masks[1]), box, slab)


def _active_tiles(near: Bools, size: int) -> NDArray[np.int64]:
    """Return the numbers of the tiles of `size` samples with a sample in `near` (nx, ny, nz), last axis fastest."""
    for axis, count in enumerate(near.shape):
        near = np.logical_or.reduceat(near, np.arange(0, count, size), axis=axis)
    return np.flatnonzero(near)
