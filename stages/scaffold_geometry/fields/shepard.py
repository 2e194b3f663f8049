"""The `normalised` ARBF field: Shepard's method on segments.

    s(x) = sum_i u_i k_i(d_i(x)) / sum_i k_i(d_i(x)),   k_i(r) = (r^2 + (c h_i)^2)^(-p/2) max(0, 1 - (r / (R h_i))^2)^2

over struts (u = +1) and channels (u = -1), with the distance d_i to segment i and the mesh's local edge length h_i: the
generalised inverse multiquadric with compact support. A point out of reach of all segments has s = -1 (void).

Shepard, "A two-dimensional interpolation function for irregularly-spaced data" (1968); Franke, Nielson, "Smooth
interpolation of large sets of scattered data", IJNME 15 (1980); the anisotropic distance is that of Liu, Guo, Yu.

Sums run over the segments in a fixed order, and a segment out of reach adds an exact zero: no bit depends on the lists
of segments or on the number of threads. This module computes the field at points, `shepard_grid` on voxels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.jit import kernel, parallel_kernel, prange, spread
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.memory import available_memory

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton


Power = tuple[None, ...]
"""p / 2 as a tuple of that length: numba compiles separate code for each length, without a branch."""

_LANES = 16
"""Points that are summed at once; the number is fixed, so that all are computed by the same instructions."""

_PARTS = 4
"""Parts of a box along each axis: points in the same part, or in neighbouring ones, are summed at once."""

FAST = frozenset({"contract", "nsz"})
"""Fused multiply-add and no signed zero. Nothing that reorders a sum: the order is part of the result."""

SLACK = np.float32(1.001)
"""Factor on the squared reach before a segment is skipped, so that rounding never skips a non-zero weight."""

LEAST_SHAPE = 1e-9
"""Least (c h)^2: with less, weights of p = 8 on the segments themselves overflow single precision."""

_SHORTEST = float(np.finfo(np.float32).tiny)
"""Least squared length of a segment with a direction: its reciprocal would overflow single precision."""

_ONE: Any = np.float32(1.0)  # a plain 1.0 would turn every expression into double precision
_ZERO: Any = np.float32(0.0)


@dataclass(frozen=True, eq=False)
class Segments:
    """Struts, then channels, in units of `unit` mm relative to `centre` (3,), as contiguous rows.

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

    @cached_property
    def table(self) -> Floats:
        """A row for each segment, (n, 11), with all the numbers that sums at points need."""
        squares = (self.steps**2).sum(axis=0)
        inverses = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > _SHORTEST)
        shapes = np.maximum(self.shapes, LEAST_SHAPE)
        columns = (inverses, shapes, 1.0 + shapes / self.reaches, 1.0 / self.reaches, np.sqrt(self.reaches))
        return np.stack([*self.starts, *self.steps, *columns], axis=1)


@dataclass(frozen=True, eq=False)
class Bins:
    """For each box of a grid, the segments that may reach into it, in ascending order.

    `members[offsets[b]:offsets[b + 1]]` are those of box b, boxes numbered with the last axis fastest; `origin` (3,) is
    the corner of the first box, `sizes` (3,) the edges of a box, `shape` (3,) the number of boxes along each axis.
    """

    offsets: Ints
    members: NDArray[np.int32]
    origin: Floats
    sizes: Floats
    shape: tuple[int, int, int]


def segments_of(
    skeleton: Skeleton, *, c: float, support: float, exponent: int, vertices_only: bool = False
) -> Segments:
    """Return struts and channels in mean edge lengths relative to the mesh's centre, which suits single precision.

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
    """Sort the segments into the boxes within their reach; `origin` and `sizes` (3,) in the segments' units.

    Raises `StageError` if the lists need more memory than is free.
    """
    ends, reaches = segments.starts + segments.steps, np.sqrt(segments.reaches * SLACK)
    first = (np.minimum(segments.starts, ends) - reaches - origin[:, None]) / sizes[:, None]
    last = (np.maximum(segments.starts, ends) + reaches - origin[:, None]) / sizes[:, None]
    most = np.array(shape)[:, None]
    ranges = np.stack([np.clip(np.floor(first), 0, most), np.clip(np.floor(last), -1, most - 1)]).astype(np.int32)
    arrays = (segments.starts, segments.steps, reaches, ranges, origin, sizes, np.array(shape))
    counts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    _sort_into_boxes(*arrays, counts, np.empty(0, np.int32))
    offsets = np.cumsum(counts)
    needed, free = int(offsets[-1]) * np.dtype(np.int32).itemsize, available_memory()
    if needed > free:
        raise StageError(
            f"support: the lists of struts and channels within reach need {needed / 2**30:.1f} GiB, but "
            f"{free / 2**30:.1f} GiB are free; lower support"
        )
    members = np.empty(offsets[-1], np.int32)
    _sort_into_boxes(*arrays, offsets[:-1].copy(), members)
    return Bins(offsets, members, origin, sizes, shape)


@parallel_kernel
def _sort_into_boxes(
    starts: Floats, steps: Floats, reaches: Floats, ranges: NDArray[np.int32], origin: Floats, sizes: Floats,
    shape: Ints, cursors: Ints, members: NDArray[np.int32],
) -> None:  # fmt: skip
    """Count each box's segments into `cursors[box + 1]`; if `members` is not empty, write them from `cursors[box]` on.

    `ranges` (2, 3, n) are the first and last box within a segment's reach along each axis. One thread does one layer
    of boxes.
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
    """Return the squared distance of a point to a segment, which may have length 0."""
    wx, wy, wz = x - starts[0, segment], y - starts[1, segment], z - starts[2, segment]
    dx, dy, dz = steps[0, segment], steps[1, segment], steps[2, segment]
    squared_length = dx * dx + dy * dy + dz * dz
    inverse_length = 1.0 / squared_length if squared_length > 0.0 else 0.0
    return _squared_offset(wx, wy, wz, dx, dy, dz, wx * dx + wy * dy + wz * dz, inverse_length)


@kernel(fastmath=FAST, inline=True)
def _squared_offset(
    wx: float, wy: float, wz: float, dx: float, dy: float, dz: float, along: float, inverse_length: float
) -> float:
    """Return the squared distance of a + w to the segment from a to a + d; `along` is w.d, `inverse_length` 1 / d.d."""
    t: float = min(max(along * inverse_length, _ZERO), _ONE)
    ex, ey, ez = wx - t * dx, wy - t * dy, wz - t * dz
    return ex * ex + ey * ey + ez * ez


@kernel(fastmath=FAST, inline=True)
def weight(q: float, inverse: float, c1: float, inverse_reach: float, power: Power) -> float:
    """Return k from q = r^2 + (c h)^2, `inverse` = 1 / q, c1 = 1 + (c / R)^2 and `inverse_reach` = 1 / (R h)^2.

    It uses (1 - (r / R h)^2) / q = c1 / q - 1 / (R h)^2.
    """
    g: float = max(c1 * inverse - inverse_reach, _ZERO)
    if len(power) == 1:
        return g * g * q
    if len(power) == 3:  # p = 6
        return g * g * inverse
    if len(power) == 4:  # p = 8
        return (g * inverse) * (g * inverse)
    return g * g


@kernel(inline=True)
def quotient(solid: float, void: float) -> float:
    """Return s from the sums of the weights of struts and of channels; void if both are zero."""
    total = solid + void
    return (solid - void) / total if total > _ZERO else -_ONE


def field_at(segments: Segments, bins: Bins, points: Floats, precision: type[np.floating[Any]] = np.float64) -> Floats:
    """Return s at `points` (n, 3), in the segments' units, summed in `precision`; void outside the boxes of `bins`."""
    order, firsts = np.empty(len(points), np.int64), np.zeros(len(bins.offsets), np.int64)
    _sort_by_box(points, bins.origin, bins.sizes, np.array(bins.shape), order, firsts)
    values = np.full(len(points), -1.0, precision)
    _fill_points(
        segments.table.astype(precision, copy=False), segments.struts, (None,) * segments.power, bins.offsets,
        bins.members, spread(np.flatnonzero(np.diff(firsts))), firsts, points, bins.origin, bins.sizes, order, values,
    )  # fmt: skip
    return values.astype(np.float64)


@kernel
def _sort_by_box(points: Floats, origin: Floats, sizes: Floats, shape: Ints, order: Ints, firsts: Ints) -> None:
    """Write the numbers of the points in boxes, sorted by box, to `order` (n,), and each box's start to `firsts`."""
    boxes = np.empty(len(points), np.int64)
    for n in range(len(points)):
        boxes[n] = 0
        for axis in range(3):
            cell = math.floor((points[n, axis] - origin[axis]) / sizes[axis])
            is_out = boxes[n] < 0 or not 0 <= cell < shape[axis]
            boxes[n] = -1 if is_out else boxes[n] * shape[axis] + cell
        if boxes[n] >= 0:
            firsts[boxes[n] + 1] += 1
    cursors = firsts.cumsum()
    firsts[:] = cursors
    for n in range(len(points)):
        if boxes[n] >= 0:
            order[cursors[boxes[n]]] = n
            cursors[boxes[n]] += 1


@parallel_kernel(fastmath=FAST)
def _fill_points(
    table: Floats, struts: int, power: Power, offsets: Ints, members: NDArray[np.int32], boxes: Ints, firsts: Ints,
    points: Floats, origin: Floats, sizes: Floats, order: Ints, values: Floats,
) -> None:  # fmt: skip
    """Compute s at the points of each of the `boxes`, `_LANES` at once; `order` lists the points by box."""
    for number in prange(len(boxes)):
        box = boxes[number]
        near = members[offsets[box] : offsets[box + 1]]
        middle = np.searchsorted(near, struts)
        solid, void = _gather_columns(table, near[:middle]), _gather_columns(table, near[middle:])
        beyond, chosen = np.empty(len(near), table.dtype), np.empty(len(near), np.int64)
        xyz, sums = np.empty((3, _LANES), table.dtype), np.empty((2, _LANES), table.dtype)
        ours = _by_part(points, order[firsts[box] : firsts[box + 1]], origin, sizes)
        for first in range(0, len(ours), _LANES):
            after = min(first + _LANES, len(ours))
            for lane in range(_LANES):
                n = ours[min(first + lane, after - 1)]
                xyz[0, lane], xyz[1, lane], xyz[2, lane] = points[n, 0], points[n, 1], points[n, 2]
            ball = _ball_around(xyz)
            _sum_weights(solid, chosen[: _within(solid, ball, beyond, chosen)], power, xyz, sums[0])
            _sum_weights(void, chosen[: _within(void, ball, beyond, chosen)], power, xyz, sums[1])
            for n in range(first, after):
                values[ours[n]] = quotient(sums[0, n - first], sums[1, n - first])


@kernel
def _gather_columns(table: Floats, near: NDArray[np.int32]) -> Floats:
    """Return the rows `near` of `table` as columns, (11, n): contiguous numbers can be read as a vector."""
    columns = np.empty((table.shape[1], len(near)), table.dtype)
    for n in range(len(near)):
        for column in range(len(columns)):
            columns[column, n] = table[near[n], column]
    return columns


@kernel
def _by_part(points: Floats, ours: Ints, origin: Floats, sizes: Floats) -> Ints:
    """Return the points' numbers `ours` (n,), all of one box, in the order of its parts."""
    parts = np.empty(len(ours), np.int64)
    cursors = np.zeros(_PARTS**3 + 1, np.int64)
    for n in range(len(ours)):
        part = 0
        for axis in range(3):
            place = _PARTS * (points[ours[n], axis] - origin[axis]) / sizes[axis]
            part = part * _PARTS + int(place) % _PARTS
        parts[n] = part
        cursors[part + 1] += 1
    cursors = cursors.cumsum()
    sorted_ones = np.empty_like(ours)
    for n in range(len(ours)):
        sorted_ones[cursors[parts[n]]] = ours[n]
        cursors[parts[n]] += 1
    return sorted_ones


@kernel
def _ball_around(xyz: Floats) -> tuple[float, float, float, float]:
    """Return centre and radius of a ball that contains the points `xyz` (3, n)."""
    half = xyz.dtype.type(0.5)
    low_x, high_x, low_y, high_y = xyz[0].min(), xyz[0].max(), xyz[1].min(), xyz[1].max()
    low_z, high_z = xyz[2].min(), xyz[2].max()
    x, y, z = half * (low_x + high_x), half * (low_y + high_y), half * (low_z + high_z)
    return x, y, z, np.sqrt((high_x - x) ** 2 + (high_y - y) ** 2 + (high_z - z) ** 2)


@kernel(fastmath=FAST)
def _within(rows: Floats, ball: tuple[float, float, float, float], beyond: Floats, chosen: Ints) -> int:
    """Write the numbers of the `rows` that reach into a ball to `chosen`; return their count. `beyond` is scratch."""
    x, y, z, radius = ball
    for number in range(rows.shape[1]):
        n = np.uint64(number)
        wx, wy, wz = x - rows[0, n], y - rows[1, n], z - rows[2, n]
        dx, dy, dz, reach = rows[3, n], rows[4, n], rows[5, n], rows[10, n] + radius
        away = _squared_offset(wx, wy, wz, dx, dy, dz, wx * dx + wy * dy + wz * dz, rows[6, n])
        beyond[n] = away - reach * reach * SLACK
    count = 0
    for number in range(rows.shape[1]):
        chosen[count] = number
        count += beyond[number] <= _ZERO
    return count


@kernel(fastmath=FAST)
def _sum_weights(rows: Floats, chosen: Ints, power: Power, xyz: Floats, sums: Floats) -> None:
    """Write the summed weights of the `chosen` of `rows` at the points `xyz` (3, `_LANES`) to `sums`."""
    sums[:] = _ZERO
    for n in chosen:
        ax, ay, az, dx, dy, dz, inverse_length = (
            rows[0, n], rows[1, n], rows[2, n], rows[3, n], rows[4, n], rows[5, n], rows[6, n],
        )  # fmt: skip
        shape, c1, inverse_reach = rows[7, n], rows[8, n], rows[9, n]
        for offset in range(_LANES):
            lane = np.uint64(offset)
            vx, vy, vz = xyz[0, lane] - ax, xyz[1, lane] - ay, xyz[2, lane] - az
            along = vx * dx + vy * dy + vz * dz
            q = shape + _squared_offset(vx, vy, vz, dx, dy, dz, along, inverse_length)
            sums[lane] += weight(q, _ONE / q, c1, inverse_reach, power)
