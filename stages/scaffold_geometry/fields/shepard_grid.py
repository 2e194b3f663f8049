"""The `normalised` ARBF field, which `shepard` defines, summed on all voxels of a grid.

The grid is divided into tiles of 16^3 samples, always at the same places, and a tile into 64 bricks of 4^3.
Each segment has an orthonormal frame (n, m, d), d along it and n horizontal. With half its length h and the coordinates
N, M, U of a sample relative to its midpoint,

    squared distance = N^2 + M^2 + max(|U| - h, 0)^2.

N, M and U are linear in the sample's coordinates, and N is constant along z. All 64 bricks are tested at once, and
those within reach are summed 64 samples at a time. Lengths are in voxels relative to the tile's first sample, so that
the samples have whole-number coordinates: single precision loses no digits, however far the tile is from the origin.

The four samples of a column in a brick share one division, the slowest operation: 1/a = b/(ab) and 1/b = a/(ab).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints, Singles
from scaffold_geometry.fields.shepard import FAST, LEAST_SHAPE, SLACK, Bins, Power, Segments, quotient, weight
from scaffold_geometry.jit import kernel, parallel_kernel, prange, spread

TILE = 16
"""Samples along each edge of a tile."""

Line = tuple[Any, ...]
"""nx, ny, N; mx, my, mz, M; dx, dy, dz, U; h: a segment's frame, the tile's first sample in it, half the length."""

_BRICK, _BRICKS = 4, 64
"""Samples along a brick's edge, and bricks in a tile."""

_LANES, _SAMPLES = np.uint64(16), np.uint64(64)
"""Columns of a brick and samples in it; unsigned, as a loop with a signed index is not vectorised."""

_ONE: Any = np.float32(1.0)  # a plain 1.0 would turn every expression into double precision
_ZERO: Any = np.float32(0.0)
_BIT, _NO_BIT, _NONE = np.uint64(1), np.uint64(0), np.uint32(0)

_BRICK_X, _BRICK_Y, _BRICK_Z = (_BRICK * np.indices((4, 4, 4)).reshape(3, -1)[[1, 2, 0]]).astype(np.float32)
"""The first sample of each brick in its tile, bricks with y fastest and z slowest."""

_COLUMN_X, _COLUMN_Y = np.indices((4, 4)).reshape(2, -1).astype(np.float32)
_X, _Y = (_BRICK_X[:, None] + _COLUMN_X).ravel(), (_BRICK_Y[:, None] + _COLUMN_Y).ravel()
_Z = np.repeat(_BRICK_Z, 16)
"""The first sample of each column of each brick in its tile, as vectors ready to load."""

_HALF = np.float32(TILE / 2)
_MIDDLE = np.float32((_BRICK - 1) / 2.0)
_CORNER = np.float32(np.sqrt(3.0) * (_BRICK - 1) / 2.0)
"""Distance from a brick's centre to its corner."""

_PRIME = np.uint64(67)
_POSITIONS = np.zeros(int(_PRIME), np.uint64)
_POSITIONS[[2**bit % int(_PRIME) for bit in range(64)]] = np.arange(64, dtype=np.uint64)
"""The position of a single bit, by its remainder modulo 67: 2 is a primitive root of 67."""


def field_on_tiles(
    segments: Segments, bins: Bins, origin: Floats, spacing: float, active: Ints, inside: NDArray[np.bool_],
    values: Singles,
) -> int:  # fmt: skip
    """Fill the tiles numbered in `active`, last axis fastest, of `values` (nx, ny, nz) with the field.

    The boxes of `bins` are whole numbers of tiles. `origin` (3,) is the position of sample (0, 0, 0), in the segments'
    units. Returns the number of samples of `inside` (nx, ny, nz) out of reach of struts or of channels.
    """
    tiles = -(-np.array(values.shape) // TILE)
    tiles_per_box = np.rint(bins.sizes / (TILE * spacing)).astype(np.int64)
    half_reached = np.zeros(len(active), np.int64)
    _fill_tiles(
        _table(segments, origin, spacing), segments.struts, (None,) * segments.power, bins.offsets, bins.members,
        np.array(bins.shape), tiles_per_box, tiles, spread(active), inside, values, half_reached,
    )  # fmt: skip
    return int(half_reached.sum())


def _table(segments: Segments, origin: Floats, spacing: float) -> Floats:
    """Return a row for each segment, (n, 16), in voxels from the first sample.

    Midpoint (3), n (2: it is horizontal), m (3), d (3), half the length, (c h)^2, 1 + (c / R)^2, 1 / (R h)^2 and R h.
    """
    starts, steps = (segments.starts - origin[:, None]) / spacing, segments.steps / spacing
    lengths, seen_along_z = np.linalg.norm(steps, axis=0), np.hypot(*steps[:2])
    upright = np.array([0.0, 0.0, 1.0])[:, None]
    d = np.where(lengths > 0.0, steps / np.where(lengths > 0.0, lengths, 1.0), upright)
    level = np.stack([d[1], -d[0]]) / np.where(seen_along_z > 0.0, np.hypot(d[0], d[1]), 1.0)
    n = np.where(seen_along_z > 0.0, level, np.array([1.0, 0.0])[:, None])
    m = np.stack([-d[2] * n[1], d[2] * n[0], d[0] * n[1] - d[1] * n[0]])
    shapes, reaches = np.maximum(segments.shapes / spacing**2, LEAST_SHAPE), segments.reaches / spacing**2
    return np.stack(
        [*(starts + steps / 2.0), *n, *m, *d, lengths / 2.0, shapes, 1.0 + shapes / reaches, 1.0 / reaches,
         np.sqrt(reaches)], axis=1,
    )  # fmt: skip


@parallel_kernel(fastmath=FAST)
def _fill_tiles(
    table: Floats, struts: int, power: Power, offsets: Ints, members: NDArray[np.int32], boxes: Ints,
    tiles_per_box: Ints, tiles: Ints, active: Ints, inside: NDArray[np.bool_], values: Singles, half_reached: Ints,
) -> None:  # fmt: skip
    for number in prange(len(active)):
        tile = active[number]
        i, j, k = tile // (tiles[1] * tiles[2]), (tile // tiles[2]) % tiles[1], tile % tiles[2]
        box_i, box_j, box_k = i // tiles_per_box[0], j // tiles_per_box[1], k // tiles_per_box[2]
        box = (box_i * boxes[1] + box_j) * boxes[2] + box_k
        near = members[offsets[box] : offsets[box + 1]]
        middle = np.searchsorted(near, struts)
        x, y, z = TILE * i, TILE * j, TILE * k
        sums = np.zeros((2, TILE**3), np.float32)
        _add_weights(table, near[:middle], power, x, y, z, sums[0])
        _add_weights(table, near[middle:], power, x, y, z, sums[1])
        ours = slice(x, x + TILE), slice(y, y + TILE), slice(z, z + TILE)
        half_reached[number] = _divide(sums, inside[ours], values[ours])


@kernel(fastmath=FAST)
def _add_weights(table: Floats, near: NDArray[np.int32], power: Power, x: int, y: int, z: int, sums: Singles) -> None:
    """Add the weights of the segments `near` to `sums` (16^3,) of the tile whose first sample is x, y, z."""
    for member in near:
        line, shape, c1, inverse_reach, reach = _in_tile(table[member], x, y, z)
        bricks = _bricks_within(line, reach + _CORNER)
        while bricks != _NO_BIT:
            others = bricks & (bricks - _BIT)
            brick = _POSITIONS[(bricks ^ others) % _PRIME]
            _add_to_brick(line, shape, c1, inverse_reach, power, brick, sums)
            bricks = others


@kernel(fastmath=FAST, inline=True)
def _in_tile(row: Floats, x: int, y: int, z: int) -> tuple[Line, Any, Any, Any, Any]:
    """Return a row of `_table` in single precision, its line relative to the tile's first sample x, y, z."""
    wx, wy, wz = x - row[0], y - row[1], z - row[2]
    line = (
        np.float32(row[3]), np.float32(row[4]), np.float32(wx * row[3] + wy * row[4]),
        np.float32(row[5]), np.float32(row[6]), np.float32(row[7]),
        np.float32(wx * row[5] + wy * row[6] + wz * row[7]),
        np.float32(row[8]), np.float32(row[9]), np.float32(row[10]),
        np.float32(wx * row[8] + wy * row[9] + wz * row[10]),
        np.float32(row[11]),
    )  # fmt: skip
    return line, np.float32(row[12]), np.float32(row[13]), np.float32(row[14]), np.float32(row[15])


@kernel(fastmath=FAST, inline=True)
def _bricks_within(line: Line, distance: Any) -> Any:  # noqa: ANN401 - np.float32, np.uint64
    """Return the bricks, one bit each, whose centre lies within `distance` of the segment.

    The bricks of the tile's lower and upper half share N; each half has a word of 32 bits, as wide as a float32.
    """
    nx, ny, n0, mx, my, mz, m0, dx, dy, dz, d0, half = line
    furthest = distance * distance * SLACK
    lower, upper = _NONE, _NONE
    for brick in range(_BRICKS // 2):
        x, y, z = _BRICK_X[brick] + _MIDDLE, _BRICK_Y[brick] + _MIDDLE, _BRICK_Z[brick] + _MIDDLE
        n = nx * x + (ny * y + n0)
        left = furthest - n * n
        m, d = mx * x + (my * y + (mz * z + m0)), dx * x + (dy * y + (dz * z + d0))
        bit = np.uint32(1) << np.uint32(brick)
        lower = np.uint32(lower | (bit if _squared_bound(m, d, half) <= left else _NONE))
        upper = np.uint32(upper | (bit if _squared_bound(m + _HALF * mz, d + _HALF * dz, half) <= left else _NONE))
    return np.uint64(lower) | (np.uint64(upper) << np.uint64(_BRICKS // 2))


@kernel(fastmath=FAST, inline=True)
def _add_to_brick(
    line: Line, shape: float, c1: float, inverse_reach: float, power: Power, brick: int, sums: Singles
) -> None:
    """Add the weights of a segment to the 64 samples of a brick: a vector of 16 columns, four samples in each."""
    nx, ny, n0, mx, my, mz, m0, dx, dy, dz, d0, half = line
    first, base = brick * _LANES, brick * _SAMPLES
    for column in range(16):
        lane = np.uint64(column)
        x, y, z = _X[first + lane], _Y[first + lane], _Z[first + lane]
        n = nx * x + (ny * y + n0)
        a = n * n + shape
        m, d = mx * x + (my * y + (mz * z + m0)), dx * x + (dy * y + (dz * z + d0))
        q0 = a + _squared_bound(m, d, half)
        q1 = a + _squared_bound(m + mz, d + dz, half)
        q2 = a + _squared_bound(m + (mz + mz), d + (dz + dz), half)
        q3 = a + _squared_bound(m + (mz + mz + mz), d + (dz + dz + dz), half)
        low, high = q0 * q1, q2 * q3
        inverse = _ONE / (low * high)
        of_low, of_high = inverse * high, inverse * low
        place = base + lane
        sums[place] += weight(q0, of_low * q1, c1, inverse_reach, power)
        sums[place + _LANES] += weight(q1, of_low * q0, c1, inverse_reach, power)
        sums[place + _LANES + _LANES] += weight(q2, of_high * q3, c1, inverse_reach, power)
        sums[place + _LANES + _LANES + _LANES] += weight(q3, of_high * q2, c1, inverse_reach, power)


@kernel(fastmath=FAST, inline=True)
def _squared_bound(m: float, d: float, half: float) -> float:
    """Return M^2 + max(|U| - h, 0)^2."""
    beyond: float = max(abs(d) - half, _ZERO)
    return m * m + beyond * beyond


@kernel
def _divide(sums: Singles, inside: NDArray[np.bool_], values: Singles) -> int:
    """Write s from `sums` (2, 16^3) to `values` (nx, ny, nz); return the number of samples `inside` with a zero sum."""
    half_reached = 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                brick = (k // _BRICK * _BRICK + i // _BRICK) * _BRICK + j // _BRICK
                place = ((brick * _BRICK + k % _BRICK) * _BRICK + i % _BRICK) * _BRICK + j % _BRICK
                solid, void = sums[0, place], sums[1, place]
                values[i, j, k] = quotient(solid, void)
                half_reached += inside[i, j, k] and not (solid > _ZERO and void > _ZERO)
    return half_reached
