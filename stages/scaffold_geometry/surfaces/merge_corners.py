"""Triangles given by their corners, as in STL files, to a mesh: corners with equal float32 coordinates are merged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Singles
from scaffold_geometry.surfaces.keys import equal_rows, mix_bits
from scaffold_pipeline.errors import StageError


def merge_corners(corners: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return `vertices` (n, 3) and `faces` (m, 3) of triangles `corners` (m, 3, 3) that hold float32 values.

    Only corners with equal coordinates become one vertex; vertices are in the order of their first use. Raises
    `StageError` if a coordinate is not finite in float32.
    """
    points = to_single(corners.reshape(-1, 3))
    if not len(points):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    first, vertex_of_corner = equal_rows(_keys(points))
    if not np.array_equal(points[first][vertex_of_corner], points):  # two points share a key: once in 10^6 files
        _, exact = np.unique(points, axis=0, return_inverse=True)
        first, vertex_of_corner = equal_rows(exact.reshape(-1))
    return points[first].astype(np.float64), vertex_of_corner.reshape(-1, 3)


def to_single(coordinates: NDArray[np.floating]) -> Singles:
    """Return the coordinates in float32, -0.0 as 0.0; raises `StageError` if one is not finite there."""
    with np.errstate(over="ignore"):
        single: Singles = np.add(coordinates, np.float32(0.0), dtype=np.float32, casting="same_kind")
    if not np.isfinite(single).all():
        bad = int(np.count_nonzero(~np.isfinite(single)))
        raise StageError(f"coordinates: must be finite in float32, but {bad} of {single.size} are not")
    return single


def _keys(points: Singles) -> NDArray[np.uint64]:
    """Return a 64-bit key for each row, equal for equal rows: a hash of their bits."""
    x, y, z = np.ascontiguousarray(points).view(np.uint32).astype(np.uint64).T
    return mix_bits(mix_bits(x | (y << np.uint64(32))) ^ z)
