"""Regions of a plane: iso-lines of samples, booleans of polygons, rasterisation and extrusion.

A ring is (k, 2) mm, counter-clockwise around a region and clockwise around a hole; the first point is not repeated at
the end. Booleans are by Clipper2, which rounds to 1e-8 mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces.booleans import to_manifold

Rings = list[Floats]
Region = Any
"""A `manifold3d.CrossSection`, which has no type information."""

_NUDGE = 1e-3
"""Samples nearer to the iso-value than this share of the greatest change between neighbours are moved away from it:
iso-lines through a sample would touch there."""

_FLAT = 1e-3
"""Points of an iso-line nearer than this, in samples, to the line between their neighbours are removed: the iso-line's
own error is greater."""

_STRAIGHT = 1e-6
"""mm: an outline with smaller deviations is straight, up to the rounding of booleans and of single precision."""


def region_above(values: NDArray[np.float32], iso: float, origin: Floats, spacing: float) -> Region:
    """Return the region where samples (nx, ny), [i, j] at `origin + spacing * (i, j)`, are above `iso`.

    Marching squares; outside the samples is void, and at a saddle the void is connected.
    """
    from skimage.measure import find_contours

    changes = max(float(np.abs(np.diff(values, axis=axis)).max()) for axis in range(2))
    step = changes or max(1.0, abs(iso))
    padded = np.pad(values.astype(np.float64) - iso, 1, constant_values=-step)
    near = np.abs(padded) < _NUDGE * step
    padded[near] = np.where(padded[near] > 0.0, step, -step) * _NUDGE
    lines = find_contours(padded, 0.0, positive_orientation="high")
    return to_region([origin + spacing * (line[:-1] - 1.0) for line in lines]).simplify(_FLAT * spacing)


def to_region(rings: Iterable[Floats]) -> Region:
    """Return the region to the left of rings; overlapping regions are united."""
    import manifold3d

    return manifold3d.CrossSection(list(rings))


def rings_of(region: Region) -> Rings:
    """Return the rings of a region."""
    return [np.array(ring, np.float64) for ring in region.to_polygons()]


def pieces_of(region: Region) -> list[Region]:
    """Return the connected pieces of a region."""
    return list(region.decompose())


def remove_small_pieces(region: Region, least: float) -> Region:
    """Return a region without the pieces whose area is below `least` mm^2."""
    import manifold3d

    return manifold3d.CrossSection.compose([piece for piece in pieces_of(region) if piece.area() >= least])


def outline_of(vertices: Floats, cells: dict[str, Ints]) -> Region:
    """Return the region that planar cells cover: `vertices` (n, 3), kind -> (m, corners), counter-clockwise.

    Vertices inside straight sides are removed: they would give triangles without area.
    """
    tiles = to_region(tile for corners in cells.values() for tile in vertices[corners][:, :, :2])
    return tiles.simplify(_STRAIGHT)


def section_at(vertices: Floats, faces: Ints, z: float) -> Region:
    """Return the section of a closed, outward surface, (n, 3) and (m, 3), with the plane at `z` mm."""
    return to_manifold(vertices, faces, "outer shape").slice(z)


def rasterise(rings: Sequence[Floats], shape: tuple[int, int]) -> Bools:
    """Return a mask, of `shape`, of the pixels whose centre [i, j] is inside rings in pixels, by the even-odd rule.

    Along each row of pixels, every crossing of a ring switches between inside and outside. Regions side by side share
    no pixel; skimage.draw.polygon gives them some in common, in 20 times the time.
    """
    starts, ends = (np.concatenate([np.roll(ring, shift, axis=0) for ring in rings]) for shift in (1, 0))
    low, high = np.sort(np.stack([starts[:, 0], ends[:, 0]]), axis=0)
    first, last = (np.clip(np.ceil(row), 0, shape[0]).astype(int) for row in (low, high))  # rows: low <= i < high
    counts = last - first
    edge = np.repeat(np.arange(len(starts)), counts)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + first[edge]
    share = (row - starts[edge, 0]) / (ends[edge, 0] - starts[edge, 0])
    column = starts[edge, 1] + share * (ends[edge, 1] - starts[edge, 1])
    turns = np.zeros((shape[0], shape[1] + 1), np.uint8)  # sums wrap around at 256: odd stays odd
    np.add.at(turns, (row, np.clip(np.ceil(column), 0, shape[1]).astype(int)), 1)
    return np.asarray(np.cumsum(turns[:, :-1], axis=1, dtype=np.uint8) % 2 == 1)


def prism(rings: Sequence[Floats], low: float, high: float) -> tuple[Floats, Ints]:
    """Return the closed, outward surface of a region extruded between two heights: vertices (2 n, 3), faces (m, 3).

    Coordinates are exact in single precision; points of a ring that coincide in it are merged.
    """
    import manifold3d

    rings = [ring for ring in map(_snap_to_float32, rings) if len(ring) > 2]  # two bound nothing
    points = np.concatenate(rings)
    starts = np.cumsum([0, *(len(ring) for ring in rings)])
    a = np.arange(len(points))
    b = np.concatenate([start + np.roll(np.arange(len(ring)), -1) for ring, start in zip(rings, starts, strict=False)])
    cap: Ints = np.array(manifold3d.triangulate(rings), np.int64).reshape(-1, 3)
    up = len(points)
    walls = [np.stack(corners, axis=1) for corners in ((a, b, b + up), (a, b + up, a + up))]
    vertices = np.concatenate([np.insert(points, 2, z, axis=1) for z in _single(np.array([low, high]))])
    return vertices, np.concatenate([cap[:, ::-1], cap + up, *walls])


def _snap_to_float32(ring: Floats) -> Floats:
    rounded = _single(ring)
    return np.asarray(rounded[(rounded != np.roll(rounded, 1, axis=0)).any(axis=1)])


def _single(lengths: Floats) -> Floats:
    return lengths.astype(np.float32).astype(np.float64)
