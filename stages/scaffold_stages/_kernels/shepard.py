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

import numpy as np
from numpy.typing import NDArray

from scaffold_stages._kernels._jit import kernel, parallel_kernel, prange

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LANES = 16
"""Samples along the last axis that are summed at once: a block's rows always hold as many, so none is a remainder."""

_SLACK = np.float32(1.001)
"""Reach, squared, is widened by this much before a segment is skipped, so that rounding never skips a non-zero."""

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_INTERVALS = 8
_REFINED = 1000
_REFINEMENTS = 20


@dataclass(frozen=True, eq=False)
class Segments:
    """Struts, then channels, in units of `unit` mm about `centre` (3,), as contiguous rows.

    `starts` and `steps` (3, n), a segment runs from start to start + step; `shapes` (n,) is (c h)^2; `reaches` (n,)
    is (R h)^2; the first `struts` segments have u = +1; `power` is p/2.
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


def bin_segments(segments: Segments, origin: Floats, sizes: Floats, shape: tuple[int, int, int]) -> Bins:
    """Sort the segments into the boxes that they may reach; `origin` and `sizes` (3,) in the segments' units."""
    counts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    nothing = np.empty(0, np.int32)
    arrays = (segments.starts, segments.steps, segments.reaches, origin, sizes, np.array(shape))
    _sort_into_boxes(*arrays, counts, nothing)
    offsets = np.cumsum(counts)
    members = np.empty(offsets[-1], np.int32)
    _sort_into_boxes(*arrays, offsets[:-1].copy(), members)
    return Bins(offsets, members, origin, sizes, shape)


@kernel
def _sort_into_boxes(
    starts: Floats, steps: Floats, reaches: Floats, origin: Floats, sizes: Floats, shape: Ints, cursors: Ints,
    members: NDArray[np.int32],
) -> None:  # fmt: skip
    """Count each box's segments into `cursors[box + 1]`, or write them from `cursors[box]` on where there is room."""
    diagonal = np.sqrt((sizes * sizes).sum()) / 2.0
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for segment in range(starts.shape[1]):
        reach = np.sqrt(reaches[segment] * _SLACK)
        for axis in range(3):
            first, last = starts[axis, segment], starts[axis, segment] + steps[axis, segment]
            low[axis] = max(0, int(np.floor((min(first, last) - reach - origin[axis]) / sizes[axis])))
            high[axis] = min(shape[axis] - 1, int(np.floor((max(first, last) + reach - origin[axis]) / sizes[axis])))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    x = origin[0] + (i + 0.5) * sizes[0]
                    y = origin[1] + (j + 0.5) * sizes[1]
                    z = origin[2] + (k + 0.5) * sizes[2]
                    if _squared_distance(x, y, z, starts, steps, segment) > (reach + diagonal) ** 2:
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
    along = wx * dx + wy * dy + wz * dz
    t = 0.0
    if along >= squared_length > 0.0:
        t = 1.0
    elif along > 0.0:
        t = along / squared_length
    ex, ey, ez = wx - t * dx, wy - t * dy, wz - t * dz
    return ex * ex + ey * ey + ez * ez


@kernel(fastmath=frozenset({"contract", "nsz"}), inline=True)
def _weight(squared_distance: float, shape: float, inverse_reach: float, power: int) -> float:
    """Return k of a squared distance; `shape` = (c h)^2, `inverse_reach` = 1 / (R h)^2, `power` = p / 2."""
    taper = max(_ZERO, _ONE - squared_distance * inverse_reach)
    q = _ONE / (squared_distance + shape)
    k = q
    if power == 2:
        k = q * q
    elif power == 3:
        k = q * q * q
    elif power == 4:
        k = (q * q) * (q * q)
    return k * (taper * taper)


def field_on_blocks(
    segments: Segments, bins: Bins, origin: Floats, spacing: float, active: Ints, inside: NDArray[np.bool_],
    values: NDArray[np.float32],
) -> int:  # fmt: skip
    """Fill the blocks numbered in `active` of `values` (nx, ny, nz) with the field.

    The blocks are the boxes of `bins`, a whole number of samples each along x and y and `LANES` along z; sample
    (0, 0, 0) lies at `origin` (3,), `spacing` apart, in the segments' units. Returns how many samples of
    `inside` (nx, ny, nz) are not reached by segments of both signs.
    """
    squared_lengths = (segments.steps**2).sum(axis=0)
    inverse_lengths = np.divide(1.0, squared_lengths, out=np.zeros_like(squared_lengths), where=squared_lengths > 0.0)
    table = np.stack([*segments.starts, *segments.steps, inverse_lengths, segments.shapes, 1.0 / segments.reaches])
    axes = [np.float32(origin[axis] + spacing * np.arange(values.shape[axis])) for axis in range(3)]
    rows = np.array([round(size / spacing) for size in bins.sizes[:2]])
    half_reached = np.zeros(len(active), np.int64)
    _fill_blocks(
        table.astype(np.float32), segments.struts, segments.power, bins.offsets, bins.members,
        np.array(bins.shape), rows, active, *axes, inside, values, half_reached,
    )  # fmt: skip
    return int(half_reached.sum())


@parallel_kernel(fastmath=frozenset({"contract", "nsz"}))
def _fill_blocks(
    table: NDArray[np.float32], struts: int, power: int, offsets: Ints, members: NDArray[np.int32], boxes: Ints,
    rows: Ints, active: Ints, xs: NDArray[np.float32], ys: NDArray[np.float32], zs: NDArray[np.float32],
    inside: NDArray[np.bool_], values: NDArray[np.float32], half_reached: Ints,
) -> None:  # fmt: skip
    for number in prange(len(active)):
        block = active[number]
        i, j, k = block // (boxes[1] * boxes[2]), (block // boxes[2]) % boxes[1], block % boxes[2]
        near = members[offsets[block] : offsets[block + 1]]
        solid, void, lanes = np.empty(LANES, np.float32), np.empty(LANES, np.float32), np.empty(LANES, np.float32)
        first, count = k * LANES, min(LANES, len(zs) - k * LANES)
        for lane in range(LANES):
            lanes[lane] = zs[min(first + lane, len(zs) - 1)]
        for ix in range(i * rows[0], min((i + 1) * rows[0], len(xs))):
            for iy in range(j * rows[1], min((j + 1) * rows[1], len(ys))):
                solid[:], void[:] = _ZERO, _ZERO
                for segment in near:
                    _add_row(table[:, segment], xs[ix], ys[iy], lanes, power, solid if segment < struts else void)
                for lane in range(count):
                    total = solid[lane] + void[lane]
                    values[ix, iy, first + lane] = (solid[lane] - void[lane]) / total if total > _ZERO else -_ONE
                    is_reached = solid[lane] > _ZERO and void[lane] > _ZERO
                    half_reached[number] += inside[ix, iy, first + lane] and not is_reached


@kernel(fastmath=frozenset({"contract", "nsz"}), inline=True)
def _add_row(
    segment: NDArray[np.float32], x: float, y: float, zs: NDArray[np.float32], power: int, sums: NDArray[np.float32]
) -> None:
    """Add the weight of one segment at the samples (x, y, zs) to `sums`."""
    ax, ay, az, dx, dy, dz, inverse_length, shape, inverse_reach = segment
    wx, wy = x - ax, y - ay
    along = wx * dx + wy * dy
    if not _reaches_column(wx, wy, dx, dy, inverse_reach):
        return
    for lane in range(LANES):
        wz = zs[lane] - az
        t = min(max((along + wz * dz) * inverse_length, _ZERO), _ONE)
        ex, ey, ez = wx - t * dx, wy - t * dy, wz - t * dz
        sums[lane] += _weight(ex * ex + ey * ey + ez * ez, shape, inverse_reach, power)


@kernel(fastmath=frozenset({"contract", "nsz"}), inline=True)
def _reaches_column(wx: float, wy: float, dx: float, dy: float, inverse_reach: float) -> bool:
    """Tell whether a segment, seen along z, comes near a column: what it misses there it misses in space."""
    squared_length = dx * dx + dy * dy
    t = _ZERO
    if squared_length > _ZERO:
        t = min(max((wx * dx + wy * dy) / squared_length, _ZERO), _ONE)
    ex, ey = wx - t * dx, wy - t * dy
    return (ex * ex + ey * ey) * inverse_reach <= _SLACK


def field_at(segments: Segments, bins: Bins, points: Floats) -> Floats:
    """Return s at `points` (n, 3), in the segments' units and within the boxes of `bins`, in double precision."""
    values = np.empty(len(points))
    _fill_points(*_arguments(segments, bins), np.ascontiguousarray(points), values)
    return values


def extremes_along(segments: Segments, bins: Bins, starts: Floats, ends: Floats, sign: int) -> Floats:
    """Return the greatest (`sign` = 1) or least (-1) s found on each segment `starts`-`ends` (n, 3), (n,).

    Each is sampled at 9 points; the few that come out most extreme also between the neighbours of their best point,
    by golden section.
    """
    extremes, places = np.empty(len(starts)), np.empty(len(starts))
    arguments = (*_arguments(segments, bins), starts, ends, sign)
    _sample_along(*arguments, np.arange(len(starts)), extremes, places)
    closest = np.sort(np.argsort(-sign * extremes, kind="stable")[:_REFINED])
    _refine_along(*arguments, closest, extremes, places)
    return extremes


def _arguments(segments: Segments, bins: Bins) -> tuple[object, ...]:
    return (
        segments.starts, segments.steps, segments.shapes, 1.0 / segments.reaches, segments.struts, segments.power,
        bins.offsets, bins.members, bins.origin, bins.sizes, np.array(bins.shape),
    )  # fmt: skip


@kernel
def _value_at(
    x: float, y: float, z: float, starts: Floats, steps: Floats, shapes: Floats, inverse_reaches: Floats, struts: int,
    power: int, offsets: Ints, members: NDArray[np.int32], origin: Floats, sizes: Floats, boxes: Ints,
) -> float:  # fmt: skip
    i = min(max(int((x - origin[0]) / sizes[0]), 0), boxes[0] - 1)
    j = min(max(int((y - origin[1]) / sizes[1]), 0), boxes[1] - 1)
    k = min(max(int((z - origin[2]) / sizes[2]), 0), boxes[2] - 1)
    box = (i * boxes[1] + j) * boxes[2] + k
    solid, void = 0.0, 0.0
    for segment in members[offsets[box] : offsets[box + 1]]:
        squared_distance = _squared_distance(x, y, z, starts, steps, segment)
        k_i = _weight(squared_distance, shapes[segment], inverse_reaches[segment], power)
        if segment < struts:
            solid += k_i
        else:
            void += k_i
    total = solid + void
    return (solid - void) / total if total > 0.0 else -1.0


@parallel_kernel
def _fill_points(
    starts: Floats, steps: Floats, shapes: Floats, inverse_reaches: Floats, struts: int, power: int, offsets: Ints,
    members: NDArray[np.int32], origin: Floats, sizes: Floats, boxes: Ints, points: Floats, values: Floats,
) -> None:  # fmt: skip
    for n in prange(len(points)):
        values[n] = _value_at(
            points[n, 0], points[n, 1], points[n, 2], starts, steps, shapes, inverse_reaches, struts, power, offsets,
            members, origin, sizes, boxes,
        )  # fmt: skip


@kernel
def _value_along(
    starts: Floats, steps: Floats, shapes: Floats, inverse_reaches: Floats, struts: int, power: int, offsets: Ints,
    members: NDArray[np.int32], origin: Floats, sizes: Floats, boxes: Ints, a: Floats, b: Floats, t: float,
) -> float:  # fmt: skip
    return _value_at(
        a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2]), starts, steps, shapes,
        inverse_reaches, struts, power, offsets, members, origin, sizes, boxes,
    )  # fmt: skip


@parallel_kernel
def _sample_along(
    starts: Floats, steps: Floats, shapes: Floats, inverse_reaches: Floats, struts: int, power: int, offsets: Ints,
    members: NDArray[np.int32], origin: Floats, sizes: Floats, boxes: Ints, from_points: Floats, to_points: Floats,
    sign: int, wanted: Ints, extremes: Floats, places: Floats,
) -> None:  # fmt: skip
    """Put the most extreme of evenly spaced samples into `extremes` and where it lies, 0..1, into `places`."""
    for number in prange(len(wanted)):
        n = wanted[number]
        best, place = -np.inf, 0.0
        for trial in range(_INTERVALS + 1):
            t = trial / _INTERVALS
            value = sign * _value_along(
                starts, steps, shapes, inverse_reaches, struts, power, offsets, members, origin, sizes, boxes,
                from_points[n], to_points[n], t,
            )  # fmt: skip
            if value > best:
                best, place = value, t
        extremes[n], places[n] = sign * best, place


@parallel_kernel
def _refine_along(
    starts: Floats, steps: Floats, shapes: Floats, inverse_reaches: Floats, struts: int, power: int, offsets: Ints,
    members: NDArray[np.int32], origin: Floats, sizes: Floats, boxes: Ints, from_points: Floats, to_points: Floats,
    sign: int, wanted: Ints, extremes: Floats, places: Floats,
) -> None:  # fmt: skip
    """Narrow the interval about each of `places` by golden section, always into its longer part."""
    golden = (3.0 - np.sqrt(5.0)) / 2.0
    for number in prange(len(wanted)):
        n = wanted[number]
        best, place = sign * extremes[n], places[n]
        low, high = max(place - 1.0 / _INTERVALS, 0.0), min(place + 1.0 / _INTERVALS, 1.0)
        for _ in range(_REFINEMENTS):
            is_left_longer = place - low > high - place
            t = place - golden * (place - low) if is_left_longer else place + golden * (high - place)
            value = sign * _value_along(
                starts, steps, shapes, inverse_reaches, struts, power, offsets, members, origin, sizes, boxes,
                from_points[n], to_points[n], t,
            )  # fmt: skip
            if value > best:
                low, high = (low, place) if t < place else (place, high)
                best, place = value, t
            else:
                low, high = (t, high) if t < place else (low, t)
        extremes[n], places[n] = sign * best, place
