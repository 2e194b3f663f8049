"""The `normalised` ARBF field: Shepard's method on segments.

    s(x) = sum_i u_i k_i(d_i(x)) / sum_i k_i(d_i(x)),   k_i(r) = (r^2 + (c h_i)^2)^(-p/2) max(0, 1 - (r / (R h_i))^2)^2

over struts (u = +1) and channels (u = -1), d_i the distance to segment i and h_i the edge length of the mesh around
it: the generalised inverse multiquadric with compact support. A point that no segment reaches has s = -1 (void).

Shepard, "A two-dimensional interpolation function for irregularly-spaced data" (1968); Franke, Nielson, "Smooth
interpolation of large sets of scattered data", IJNME 15 (1980); the anisotropic distance is that of Liu, Guo, Yu.

Sums run over the segments in one fixed order, and a segment out of reach adds an exact zero: how the grid is cut into
blocks and how many threads work on it changes no bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import StageError
from scaffold_pipeline.memory import available_memory
from scaffold_stages._kernels._jit import kernel, parallel_kernel, prange

if TYPE_CHECKING:
    from scaffold_stages._kernels.skeleton import Skeleton

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LANES = 16
"""Samples that are summed at once, along the last axis of a grid: always as many, so that none is a remainder and each
is computed by the same instructions. 32 took a tenth longer, more of them being out of reach; 8 become no vector."""

_FAST = frozenset({"contract", "nsz"})
"""Fused multiply-add and no signed zero. Nothing that reorders a sum: the order is part of the result."""

_SLACK = np.float32(1.001)
"""Reach, squared, is widened by this much before a segment is skipped, so that rounding never skips a non-zero."""

LEAST_SHAPE = 1e-9
"""Least (c h)^2: with less, weights of p = 8 on the segments themselves would leave single precision."""

_SHORTEST = float(np.finfo(np.float32).tiny)
"""Least squared length of a segment that has a direction: 1 / of less would leave single precision."""

_STRIDE = 64
"""Blocks are worked on in this stride, so that the equal shares of all threads take equal time."""

_ONE: Any = np.float32(1.0)  # a plain 1.0 would make everything that it meets double precision
_ZERO: Any = np.float32(0.0)
_AT_ONCE = 100_000


@dataclass(frozen=True, eq=False)
class Segments:
    """Struts, then channels, in units of `unit` mm about `centre` (3,), as contiguous rows.

    `starts` and `steps` (3, n), a segment runs from start to start + step; `shapes` (n,) is (c h)^2, taken to be at
    least `LEAST_SHAPE`; `reaches` (n,) is (R h)^2; the first `struts` segments have u = +1; `power` is p/2.
    """

    starts: Floats
    steps: Floats
    shapes: Floats
    reaches: Floats
    struts: int
    power: int
    centre: Floats
    unit: float


@dataclass(frozen=True, eq=False)
class Bins:
    """For each box of a grid of boxes, the segments that may reach into it, ascending.

    `members[offsets[b]:offsets[b + 1]]` are those of box b, counted with the last axis fastest; `origin` (3,) is the
    corner of the first box, `sizes` (3,) the edges of a box, `shape` (3,) their number.
    """

    offsets: Ints
    members: NDArray[np.int32]
    origin: Floats
    sizes: Floats
    shape: tuple[int, int, int]


def segments_of(
    skeleton: Skeleton, *, c: float, support: float, exponent: int, vertices_only: bool = False
) -> Segments:
    """Return struts and channels in mean edge lengths about the mesh's centre: single precision keeps its digits.

    `c` and `support` are in local edge lengths, `exponent` is p; `vertices_only` puts +1 on vertices instead of edges.
    """
    struts = np.repeat(skeleton.vertices[:, None], 2, axis=1) if vertices_only else skeleton.vertices[skeleton.edges]
    strut_lengths = skeleton.local_lengths if vertices_only else skeleton.edge_lengths
    unit, centre = skeleton.mean_edge_length, (skeleton.vertices.min(axis=0) + skeleton.vertices.max(axis=0)) / 2.0
    starts = np.concatenate([struts[:, 0], skeleton.channel_starts])
    steps = np.concatenate([struts[:, 1], skeleton.channel_ends]) - starts
    local = np.concatenate([strut_lengths, skeleton.channel_lengths]) / unit
    return Segments(
        starts=np.ascontiguousarray(((starts - centre) / unit).T),
        steps=np.ascontiguousarray((steps / unit).T),
        shapes=(c * local) ** 2,
        reaches=(support * local) ** 2,
        struts=len(struts),
        power=exponent // 2,
        centre=centre,
        unit=unit,
    )


def bin_segments(segments: Segments, origin: Floats, sizes: Floats, shape: tuple[int, int, int]) -> Bins:
    """Sort the segments into the boxes that they may reach; `origin` and `sizes` (3,) in the segments' units.

    Raises `StageError` where the lists need more memory than there is.
    """
    ends, reaches = segments.starts + segments.steps, np.sqrt(segments.reaches * _SLACK)
    first = (np.minimum(segments.starts, ends) - reaches - origin[:, None]) / sizes[:, None]
    last = (np.maximum(segments.starts, ends) + reaches - origin[:, None]) / sizes[:, None]
    most = np.array(shape)[:, None]
    ranges = np.stack([np.clip(np.floor(first), 0, most), np.clip(np.floor(last), -1, most - 1)]).astype(np.int32)
    arrays = (segments.starts, segments.steps, reaches, ranges, origin, sizes, np.array(shape))
    counts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    _sort_into_boxes(*arrays, counts, np.empty(0, np.int32))
    offsets = np.cumsum(counts)
    needed, there = int(offsets[-1]) * np.dtype(np.int32).itemsize, available_memory()
    if needed > there:
        raise StageError(
            f"support: the lists of struts and channels within reach need {needed / 2**30:.1f} GiB, but "
            f"{there / 2**30:.1f} GiB are free; lower support"
        )
    members = np.empty(offsets[-1], np.int32)
    _sort_into_boxes(*arrays, offsets[:-1].copy(), members)
    return Bins(offsets, members, origin, sizes, shape)


@parallel_kernel
def _sort_into_boxes(
    starts: Floats, steps: Floats, reaches: Floats, ranges: NDArray[np.int32], origin: Floats, sizes: Floats,
    shape: Ints, cursors: Ints, members: NDArray[np.int32],
) -> None:  # fmt: skip
    """Count each box's segments into `cursors[box + 1]`, or write them from `cursors[box]` on where there is room.

    `ranges` (2, 3, n) are the first and last box that a segment may reach along each axis. A layer of boxes is one
    thread's.
    """
    diagonal = np.sqrt((sizes * sizes).sum()) / 2.0
    low, high = ranges
    for i in prange(shape[0]):
        x = origin[0] + (i + 0.5) * sizes[0]
        for segment in range(starts.shape[1]):
            if not low[0, segment] <= i <= high[0, segment]:
                continue
            furthest = (reaches[segment] + diagonal) ** 2
            for j in range(low[1, segment], high[1, segment] + 1):
                y = origin[1] + (j + 0.5) * sizes[1]
                for k in range(low[2, segment], high[2, segment] + 1):
                    z = origin[2] + (k + 0.5) * sizes[2]
                    if _squared_distance(x, y, z, starts, steps, segment) > furthest:
                        continue
                    box = (i * shape[1] + j) * shape[2] + k
                    if members.size:
                        members[cursors[box]] = segment
                        cursors[box] += 1
                    else:
                        cursors[box + 1] += 1


@kernel(inline=True)
def _squared_distance(x: float, y: float, z: float, starts: Floats, steps: Floats, segment: int) -> float:
    """Return the squared distance of a point to a segment, which may have no length."""
    wx, wy, wz = x - starts[0, segment], y - starts[1, segment], z - starts[2, segment]
    dx, dy, dz = steps[0, segment], steps[1, segment], steps[2, segment]
    squared_length = dx * dx + dy * dy + dz * dz
    inverse_length = 1.0 / squared_length if squared_length > 0.0 else 0.0
    return _squared_offset(wx, wy, wz, dx, dy, dz, wx * dx + wy * dy + wz * dz, inverse_length)


@kernel(fastmath=_FAST, inline=True)
def _squared_offset(
    wx: float, wy: float, wz: float, dx: float, dy: float, dz: float, along: float, inverse_length: float
) -> float:
    """Return the squared distance of a + w to the segment from a to a + d; `along` is w.d, `inverse_length` 1 / d.d."""
    t: float = min(max(along * inverse_length, _ZERO), _ONE)
    ex, ey, ez = wx - t * dx, wy - t * dy, wz - t * dz
    return ex * ex + ey * ey + ez * ez


@kernel(fastmath=_FAST, inline=True)
def _weight(squared_distance: float, shape: float, inverse_reach: float, power: int) -> float:
    """Return k of a squared distance; `shape` = (c h)^2, `inverse_reach` = 1 / (R h)^2, `power` = p / 2."""
    taper: float = max(_ZERO, _ONE - squared_distance * inverse_reach)
    q: float = _ONE / (squared_distance + shape)
    k = q
    if power == 2:  # noqa: PLR2004 - of q
        k = q * q
    elif power == 3:  # noqa: PLR2004 - of q
        k = q * q * q
    elif power == 4:  # noqa: PLR2004 - of q
        k = (q * q) * (q * q)
    return k * (taper * taper)


def _table(segments: Segments) -> Floats:
    """Return a row for each segment, (n, 10), with all that the sums need of it side by side."""
    squares = segments.steps**2
    lengths, seen_along_z = squares.sum(axis=0), squares[:2].sum(axis=0)
    inverses = [np.divide(1.0, s, out=np.zeros_like(s), where=s > _SHORTEST) for s in (lengths, seen_along_z)]
    shapes = np.maximum(segments.shapes, LEAST_SHAPE)
    return np.stack(
        [*segments.starts, *segments.steps, inverses[0], shapes, 1.0 / segments.reaches, inverses[1]], axis=1
    )


def field_on_blocks(
    segments: Segments, bins: Bins, origin: Floats, spacing: float, active: Ints, inside: NDArray[np.bool_],
    values: NDArray[np.float32],
) -> int:  # fmt: skip
    """Fill the blocks numbered in `active` of `values` (nx, ny, nz) with the field.

    The blocks are the boxes of `bins`, a whole number of samples each along x and y and `LANES` along z; sample
    (0, 0, 0) lies at `origin` (3,), `spacing` apart, in the segments' units. Returns how many samples of
    `inside` (nx, ny, nz) are not reached by segments of both signs.
    """
    xs, ys, zs = ((x + spacing * np.arange(n)).astype(np.float32) for x, n in zip(origin, values.shape, strict=True))
    rows = np.array([round(size / spacing) for size in bins.sizes[:2]])
    half_reached = np.zeros(len(active), np.int64)
    spread = active[np.argsort(np.arange(len(active)) % _STRIDE, kind="stable")]
    _fill_blocks(
        _table(segments).astype(np.float32), segments.struts, segments.power, bins.offsets, bins.members,
        np.array(bins.shape), rows, spread, xs, ys, zs, inside, values, half_reached,
    )  # fmt: skip
    return int(half_reached.sum())


@parallel_kernel(fastmath=_FAST)
def _fill_blocks(
    table: NDArray[np.float32], struts: int, power: int, offsets: Ints, members: NDArray[np.int32], boxes: Ints,
    rows: Ints, active: Ints, xs: NDArray[np.float32], ys: NDArray[np.float32], zs: NDArray[np.float32],
    inside: NDArray[np.bool_], values: NDArray[np.float32], half_reached: Ints,
) -> None:  # fmt: skip
    for number in prange(len(active)):
        block = active[number]
        i, j, k = block // (boxes[1] * boxes[2]), (block // boxes[2]) % boxes[1], block % boxes[2]
        x, y, z = slice(i * rows[0], (i + 1) * rows[0]), slice(j * rows[1], (j + 1) * rows[1]), k * LANES
        near = members[offsets[block] : offsets[block + 1]]
        middle = np.searchsorted(near, struts)
        sums, lanes = np.zeros((2, rows[0], rows[1], LANES), np.float32), np.empty(LANES, np.float32)
        for lane in range(LANES):
            lanes[lane] = zs[min(z + lane, len(zs) - 1)]
        _add_weights(table, near[:middle], power, xs[x], ys[y], lanes, sums[0])
        _add_weights(table, near[middle:], power, xs[x], ys[y], lanes, sums[1])
        half_reached[number] = _divide(sums, inside[x, y, z : z + LANES], values[x, y, z : z + LANES])


@kernel(fastmath=_FAST)
def _add_weights(
    table: NDArray[np.float32], near: NDArray[np.int32], power: int, xs: NDArray[np.float32], ys: NDArray[np.float32],
    zs: NDArray[np.float32], sums: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add the weights of the segments `near` to `sums` (nx, ny, LANES) at the samples of axes `xs`, `ys` and `zs`.

    A segment that, seen along z, misses a column by more than its reach adds nothing there and is skipped. One segment
    meets all columns before the next is read: the other order took half as long again.
    """
    for n in range(len(near)):
        row = table[near[n]]
        dx, dy, dz, inverse_length, shape, inverse_reach = row[3], row[4], row[5], row[6], row[7], row[8]
        for i in range(len(xs)):
            for j in range(len(ys)):
                wx, wy = xs[i] - row[0], ys[j] - row[1]
                along = wx * dx + wy * dy
                if _squared_offset(wx, wy, _ZERO, dx, dy, _ZERO, along, row[9]) * inverse_reach > _SLACK:
                    continue
                for lane in range(LANES):
                    wz = zs[lane] - row[2]
                    squared = _squared_offset(wx, wy, wz, dx, dy, dz, along + wz * dz, inverse_length)
                    sums[i, j, lane] += _weight(squared, shape, inverse_reach, power)


@kernel
def _divide(sums: NDArray[np.float32], inside: NDArray[np.bool_], values: NDArray[np.float32]) -> int:
    """Put s into `values` (nx, ny, nz), of sums (2, ...); return how many samples `inside` lack one of the signs."""
    half_reached = 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                solid, void = sums[0, i, j, k], sums[1, i, j, k]
                values[i, j, k] = _quotient(solid, void)
                half_reached += inside[i, j, k] and not (solid > _ZERO and void > _ZERO)
    return half_reached


@kernel(inline=True)
def _quotient(solid: float, void: float) -> float:
    """Return s of the sums of weights of each sign, void where there are none."""
    total = solid + void
    return (solid - void) / total if total > _ZERO else -_ONE


def field_at(segments: Segments, bins: Bins, points: Floats) -> Floats:
    """Return s at `points` (n, 3), in the segments' units and within the boxes of `bins`, in double precision."""
    cells = np.clip(((points - bins.origin) / bins.sizes).astype(np.int64), 0, np.array(bins.shape) - 1)
    boxes = (cells[:, 0] * bins.shape[1] + cells[:, 1]) * bins.shape[2] + cells[:, 2]
    order = np.argsort(boxes, kind="stable")
    used, firsts = np.unique(boxes[order], return_index=True)
    values, (xs, ys, zs) = np.empty(len(points)), np.ascontiguousarray(points[order].T)
    _fill_points(
        _table(segments), segments.struts, segments.power, bins.offsets, bins.members, used,
        np.append(firsts, len(points)), xs, ys, zs, order, values,
    )  # fmt: skip
    return values


@parallel_kernel(fastmath=_FAST)
def _fill_points(
    table: Floats, struts: int, power: int, offsets: Ints, members: NDArray[np.int32], boxes: Ints, firsts: Ints,
    xs: Floats, ys: Floats, zs: Floats, order: Ints, values: Floats,
) -> None:  # fmt: skip
    """Sum over the points of each box, `LANES` at once; points are sorted by box and `order` says whose they are."""
    for number in prange(len(boxes)):
        near = members[offsets[boxes[number]] : offsets[boxes[number] + 1]]
        middle = np.searchsorted(near, struts)
        lanes, solid, void = np.empty((3, LANES)), np.empty(LANES), np.empty(LANES)
        for first in range(firsts[number], firsts[number + 1], LANES):
            last = min(first + LANES, firsts[number + 1]) - 1
            for lane in range(LANES):
                n = min(first + lane, last)
                lanes[0, lane], lanes[1, lane], lanes[2, lane] = xs[n], ys[n], zs[n]
            _sum_points(table, near[:middle], power, lanes, solid)
            _sum_points(table, near[middle:], power, lanes, void)
            for n in range(first, last + 1):
                values[order[n]] = _quotient(solid[n - first], void[n - first])


@kernel(fastmath=_FAST)
def _sum_points(table: Floats, near: NDArray[np.int32], power: int, points: Floats, sums: Floats) -> None:
    """Put the weights of the segments `near` at `points` (3, LANES) into `sums`."""
    sums[:] = 0.0
    for n in range(len(near)):
        row = table[near[n]]
        dx, dy, dz, inverse_length, shape, inverse_reach = row[3], row[4], row[5], row[6], row[7], row[8]
        for lane in range(LANES):
            wx, wy, wz = points[0, lane] - row[0], points[1, lane] - row[1], points[2, lane] - row[2]
            along = wx * dx + wy * dy + wz * dz
            squared = _squared_offset(wx, wy, wz, dx, dy, dz, along, inverse_length)
            sums[lane] += _weight(squared, shape, inverse_reach, power)
