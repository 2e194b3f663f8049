"""The `normalised` ARBF field: Shepard's method on segments.

    s(x) = sum_i u_i k_i(d_i(x)) / sum_i k_i(d_i(x)),   k_i(r) = (r^2 + (c h_i)^2)^(-p/2) max(0, 1 - (r / (R h_i))^2)^2

over struts (u = +1) and channels (u = -1), d_i the distance to segment i and h_i the edge length of the mesh around
it: the generalised inverse multiquadric with compact support. A point that no segment reaches has s = -1 (void).

Shepard, "A two-dimensional interpolation function for irregularly-spaced data" (1968); Franke, Nielson, "Smooth
interpolation of large sets of scattered data", IJNME 15 (1980); the anisotropic distance is that of Liu, Guo, Yu.

Sums run over the segments in one fixed order, and a segment out of reach adds an exact zero: how segments are listed
and how many threads work changes no bit. This file has the field at points, `shepard_grid` that on voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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

Power = tuple[None, ...]
"""p / 2 as so many Nones: a length is part of a type, so that each has machine code of its own without a branch."""

_GROUP, _LANES = 64, 16
"""Points that are skipped at once, where they are out of reach, and that are summed at once: these are always as many,
so that each is computed by the same instructions."""

FAST = frozenset({"contract", "nsz"})
"""Fused multiply-add and no signed zero. Nothing that reorders a sum: the order is part of the result."""

SLACK = np.float32(1.001)
"""Reach, squared, is widened by this much before a segment is skipped, so that rounding never skips a non-zero."""

LEAST_SHAPE = 1e-9
"""Least (c h)^2: with less, weights of p = 8 on the segments themselves would leave single precision."""

_SHORTEST = float(np.finfo(np.float32).tiny)
"""Least squared length of a segment that has a direction: 1 / of less would leave single precision."""

_ONE: Any = np.float32(1.0)  # a plain 1.0 would make everything that it meets double precision
_ZERO: Any = np.float32(0.0)


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

    @cached_property
    def table(self) -> Floats:
        """A row for each segment, (n, 11), with all that sums at points need of it side by side."""
        squares = (self.steps**2).sum(axis=0)
        inverses = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > _SHORTEST)
        shapes = np.maximum(self.shapes, LEAST_SHAPE)
        columns = (inverses, shapes, 1.0 + shapes / self.reaches, 1.0 / self.reaches, np.sqrt(self.reaches))
        return np.stack([*self.starts, *self.steps, *columns], axis=1)


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
    ends, reaches = segments.starts + segments.steps, np.sqrt(segments.reaches * SLACK)
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
    """Return k where q = r^2 + (c h)^2, `inverse` = 1 / q, c1 = 1 + (c / R)^2 and `inverse_reach` = 1 / (R h)^2.

    With them (1 - (r / R h)^2) / q = c1 / q - 1 / (R h)^2.
    """
    g: float = max(c1 * inverse - inverse_reach, _ZERO)
    if len(power) == 1:
        return g * g * q
    if len(power) == 3:  # noqa: PLR2004 - of the inverse
        return g * g * inverse
    if len(power) == 4:  # noqa: PLR2004 - of the inverse
        return (g * inverse) * (g * inverse)
    return g * g


@kernel(inline=True)
def quotient(solid: float, void: float) -> float:
    """Return s of the sums of weights of each sign, void where there are none."""
    total = solid + void
    return (solid - void) / total if total > _ZERO else -_ONE


def field_at(segments: Segments, bins: Bins, points: Floats, precision: type[np.floating[Any]] = np.float64) -> Floats:
    """Return s at `points` (n, 3), in the segments' units and within the boxes of `bins`, summed in a precision."""
    order, used, firsts = _sorted_by_box(points, bins)
    values = np.empty(len(points), precision)
    _fill_points(
        segments.table.astype(precision, copy=False), segments.struts, (None,) * segments.power, bins.offsets,
        bins.members, used, firsts, points.astype(precision), order, values,
    )  # fmt: skip
    return values.astype(np.float64)


def _sorted_by_box(points: Floats, bins: Bins) -> tuple[Ints, Ints, Ints]:
    """Return an order of the points (n,) by box and eighth of it, the boxes that hold any, and the first of each."""
    shape = np.array(bins.shape)
    eighths, order = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    counts = np.zeros(8 * shape.prod() + 1, np.int64)
    _count_in_eighths(points, bins.origin, bins.sizes, shape, eighths, counts)
    firsts = counts.cumsum()
    _sort_by_eighth(eighths, firsts[:-1].copy(), order)
    used = np.flatnonzero(np.diff(firsts[::8]))
    return order, used, np.append(firsts[8 * used], len(points))


@kernel
def _count_in_eighths(points: Floats, origin: Floats, sizes: Floats, shape: Ints, eighths: Ints, counts: Ints) -> None:
    """Put eight times each point's box and the eighth of it into `eighths` (n,), how many lie in each into `counts`."""
    for n in range(len(points)):
        box, eighth = 0, 0
        for axis in range(3):
            place = (points[n, axis] - origin[axis]) / sizes[axis]
            cell = min(max(int(place), 0), shape[axis] - 1)
            box = box * shape[axis] + cell
            eighth = 2 * eighth + (place - cell > 0.5)  # noqa: PLR2004 - the middle
        eighths[n] = 8 * box + eighth
        counts[eighths[n] + 1] += 1


@kernel
def _sort_by_eighth(eighths: Ints, cursors: Ints, order: Ints) -> None:
    for n in range(len(eighths)):
        order[cursors[eighths[n]]] = n
        cursors[eighths[n]] += 1


@parallel_kernel(fastmath=FAST)
def _fill_points(
    table: Floats, struts: int, power: Power, offsets: Ints, members: NDArray[np.int32], boxes: Ints, firsts: Ints,
    points: Floats, order: Ints, values: Floats,
) -> None:  # fmt: skip
    """Sum over the points of each box, `_GROUP` at once; `order` has them by box."""
    for number in prange(len(boxes)):
        near = members[offsets[boxes[number]] : offsets[boxes[number] + 1]]
        middle = np.searchsorted(near, struts)
        xyz, sums = np.empty((3, _GROUP), table.dtype), np.empty((2, _GROUP), table.dtype)
        for first in range(firsts[number], firsts[number + 1], _GROUP):
            after = min(first + _GROUP, firsts[number + 1])
            lanes = -(-(after - first) // _LANES) * _LANES
            for lane in range(lanes):
                n = order[min(first + lane, after - 1)]
                xyz[0, lane], xyz[1, lane], xyz[2, lane] = points[n, 0], points[n, 1], points[n, 2]
            _sum_points(table, near[:middle], power, xyz, lanes, sums[0])
            _sum_points(table, near[middle:], power, xyz, lanes, sums[1])
            for n in range(first, after):
                values[order[n]] = quotient(sums[0, n - first], sums[1, n - first])


@kernel(fastmath=FAST)
def _sum_points(table: Floats, near: NDArray[np.int32], power: Power, xyz: Floats, lanes: int, sums: Floats) -> None:
    """Put the weights of the segments `near` at the first `lanes` points of `xyz` (3, _GROUP) into `sums`."""
    sums[:] = _ZERO
    x, y, z, radius = _ball_around(xyz[:, :lanes])
    for member in near:
        row = table[member]
        ax, ay, az, dx, dy, dz, inverse_length = row[0], row[1], row[2], row[3], row[4], row[5], row[6]
        shape, c1, inverse_reach = row[7], row[8], row[9]
        wx, wy, wz = x - ax, y - ay, z - az
        away = _squared_offset(wx, wy, wz, dx, dy, dz, wx * dx + wy * dy + wz * dz, inverse_length)
        if away > (row[10] + radius) * (row[10] + radius) * SLACK:
            continue
        for vector in range(lanes // _LANES):
            for offset in range(_LANES):
                lane = np.uint64(vector * _LANES + offset)
                vx, vy, vz = xyz[0, lane] - ax, xyz[1, lane] - ay, xyz[2, lane] - az
                along = vx * dx + vy * dy + vz * dz
                q = shape + _squared_offset(vx, vy, vz, dx, dy, dz, along, inverse_length)
                sums[lane] += weight(q, _ONE / q, c1, inverse_reach, power)


@kernel
def _ball_around(xyz: Floats) -> tuple[float, float, float, float]:
    """Return middle and radius of a ball that holds the points `xyz` (3, n)."""
    half = xyz.dtype.type(0.5)
    low_x, high_x, low_y, high_y = xyz[0].min(), xyz[0].max(), xyz[1].min(), xyz[1].max()
    low_z, high_z = xyz[2].min(), xyz[2].max()
    x, y, z = half * (low_x + high_x), half * (low_y + high_y), half * (low_z + high_z)
    return x, y, z, np.sqrt((high_x - x) ** 2 + (high_y - y) ** 2 + (high_z - z) ** 2)
