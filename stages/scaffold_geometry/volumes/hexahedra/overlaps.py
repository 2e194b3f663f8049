"""Cubes of a grid that overlap the solid inside a closed surface."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.voxels.grids import samples_inside

Shape: TypeAlias = tuple[int, int, int]

_TOUCHING = 1e-6
"""Share of a cube by which a triangle must enter it: a triangle in a side of the cube, up to rounding, does not."""

_MOST_PAIRS = 500_000
"""Pairs of triangle and cube that are tested together: about 200 MB."""


def find_overlapping_cubes(vertices: Floats, faces: Ints, origin: Floats, size: float, shape: Shape) -> Bools:
    """Return a mask, of `shape`, of the cubes that overlap the solid in a closed surface; the grid starts at `origin`.

    They are the cubes that the surface enters, and those whose centre is inside.
    """
    places = (vertices - origin) / size
    is_overlapping = samples_inside(vertices, faces, origin + size / 2.0, size, shape)
    corners = places[faces]
    low = np.clip(np.floor(corners.min(axis=1)).astype(np.int64), 0, np.array(shape) - 1)
    high = np.clip(np.floor(corners.max(axis=1)).astype(np.int64), 0, np.array(shape) - 1)
    counts = (high - low + 1).prod(axis=1)
    for some in np.split(np.arange(len(faces)), _chunks(counts)):
        owner, cube = _pairs(low[some], high[some], counts[some])
        is_entered = _enters(corners[some[owner]] - cube[:, None] - 0.5)
        is_overlapping[tuple(cube[is_entered].T)] = True
    return is_overlapping


def _chunks(counts: Ints) -> Ints:
    """Return where to split a list of triangles so that each part has about `_MOST_PAIRS`."""
    return np.flatnonzero(np.diff(np.cumsum(counts) // _MOST_PAIRS)) + 1


def _pairs(low: Ints, high: Ints, counts: Ints) -> tuple[Ints, Ints]:
    """Return the cubes (p, 3) of each triangle's box, and the triangle of each (p,)."""
    owner = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    _, ny, nz = (high - low + 1)[owner].T
    return owner, low[owner] + np.stack([step // (ny * nz), step // nz % ny, step % nz], axis=1)


def _enters(corners: Floats) -> Bools:
    """Return a mask of the triangles (p, 3, 3) that enter the unit cube around the origin, (p,).

    Separating axes: T. Akenine-Moller, "Fast 3D triangle-box overlap testing", J. Graphics Tools 6 (2001).
    """
    sides = np.roll(corners, -1, axis=1) - corners
    units = np.eye(3)
    axes = [np.broadcast_to(unit, corners[:, 0].shape) for unit in units]
    axes += [np.cross(sides[:, 0], sides[:, 1])]
    axes += [np.cross(sides[:, side], unit) for side in range(3) for unit in units]
    is_apart = np.zeros(len(corners), dtype=bool)
    for axis in axes:
        along = np.einsum("pci,pi->pc", corners, axis)
        reach = (0.5 - _TOUCHING) * np.abs(axis).sum(axis=1)
        is_apart |= (along.min(axis=1) > reach) | (along.max(axis=1) < -reach)
    return ~is_apart
