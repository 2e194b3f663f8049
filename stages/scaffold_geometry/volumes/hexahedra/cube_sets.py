"""Cores: sets of cubes, as masks (nx, ny, nz), whose boundary can be coated with a layer of cells.

At each corner of the grid the boundary faces of the set must not face both ways along any axis. Then they form one fan,
one direction points away from all of them, and the boundary is a manifold.
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints

_OCTANTS = list(np.ndindex(2, 2, 2))
_SAME = 1e-9
"""Difference of depths, in cubes, that counts as rounding: mirrored cubes are then treated alike."""


def outward_directions(cubes: Bools) -> tuple[Ints, Bools]:
    """Return the outward direction at each corner, (nx+1, ny+1, nz+1, 3), -1, 0 or 1, and a mask of corners without."""
    corners = tuple(np.array(cubes.shape) + 1)
    padded = np.pad(cubes, 1)
    around = {o: padded[tuple(slice(i, i + n) for i, n in zip(o, corners, strict=True))] for o in _OCTANTS}
    ways, is_bad = np.zeros((*corners, 3), np.int64), np.zeros(corners, bool)
    for axis in range(3):
        pairs = [(around[o], around[_across(o, axis)]) for o in _OCTANTS if not o[axis]]
        is_up = np.logical_or.reduce([low & ~high for low, high in pairs])
        is_down = np.logical_or.reduce([high & ~low for low, high in pairs])
        ways[..., axis] = is_up.astype(np.int64) - is_down
        is_bad |= is_up & is_down
    return ways, is_bad


def _across(octant: tuple[int, ...], axis: int) -> tuple[int, ...]:
    return tuple(1 if i == axis else side for i, side in enumerate(octant))


def make_core_manifold(cubes: Bools, depths: Floats, shallowest: float) -> Bools:
    """Return the cubes with some added or removed so that every corner has an outward direction.

    At each corner without one the deepest free cube is added, by `depths`; if none is as deep as `shallowest`, the
    shallowest cube of the set is removed.
    """
    core = cubes.copy()
    for adds in (True, False):
        while (is_bad := outward_directions(core)[1]).any():
            changing = _at_corners(core, depths, is_bad, shallowest if adds else None)
            if not changing.any():
                break
            core ^= changing
    return core


def _at_corners(cubes: Bools, depths: Floats, is_bad: Bools, shallowest: float | None) -> Bools:
    """Return the deepest free cubes at each bad corner or, without `shallowest`, the shallowest cubes of the set."""
    around = np.argwhere(is_bad)[:, None] - 1 + np.array(_OCTANTS)
    padded = tuple((around + 1).transpose(2, 0, 1))
    is_taken, depth = np.pad(cubes, 1)[padded], np.pad(depths, 1, constant_values=-np.inf)[padded]
    if shallowest is None:
        depth = np.where(is_taken, -depth, -np.inf)
        is_candidate = is_taken
    else:
        is_candidate = ~is_taken & (depth >= shallowest)
        depth = np.where(is_candidate, depth, -np.inf)
    is_chosen = is_candidate & (depth >= depth.max(axis=1, keepdims=True) - _SAME)
    changing = np.zeros_like(cubes)
    changing[tuple(around[is_chosen].T)] = True
    return changing
