"""Binary STL: triangles to bytes and back, the corners merged by identical coordinates."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import StageError

Singles: TypeAlias = NDArray[np.float32]

_HEADER_BYTES = 80
_PREFIX_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_AT_ONCE = 1 << 20


def to_stl(vertices: NDArray[np.floating], faces: NDArray[np.integer], header: str) -> bytes:
    """Return the binary STL of a triangle mesh: `vertices` (n, 3), `faces` (m, 3), rounded to float32.

    The same mesh and `header` give the same bytes. Raises `StageError` where the header is no ASCII text of
    at most 80 characters or starts with "solid", as text STL does, and where a coordinate overflows float32.
    """
    text = header.encode("ascii", errors="replace")
    if len(text) > _HEADER_BYTES or text != header.encode() or text.lower().startswith(b"solid"):
        raise StageError(
            f"STL header: must be ASCII of at most {_HEADER_BYTES} characters and not start with 'solid', "
            f"got {header!r}"
        )
    single = to_single(vertices)
    records = np.zeros(len(faces), dtype=_TRIANGLE)
    for start in range(0, len(faces), _AT_ONCE):
        part = records[start : start + _AT_ONCE]
        part["corners"] = single[faces[start : start + _AT_ONCE]]
        part["normal"] = _unit_normals(part["corners"])
    return text.ljust(_HEADER_BYTES) + len(faces).to_bytes(4, "little") + records.tobytes()


def from_stl(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return `vertices` (n, 3) and `faces` (m, 3) of a binary STL, see `merge_corners`.

    Raises `StageError` where the size does not fit the count of triangles, or a coordinate is not finite.
    """
    size = len(content)
    count = int.from_bytes(content[_HEADER_BYTES:_PREFIX_BYTES], "little")
    wanted = _PREFIX_BYTES + _TRIANGLE.itemsize * count
    if size < _PREFIX_BYTES or size != wanted:
        raise StageError(
            f"binary STL: {count} triangles need {wanted} bytes, got {size}; "
            "the file is cut off, padded or not a binary STL: export it again"
        )
    records = np.frombuffer(content, dtype=_TRIANGLE, offset=_PREFIX_BYTES)
    return merge_corners(records["corners"])


def merge_corners(corners: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return `vertices` (n, 3) and `faces` (m, 3) of triangles `corners` (m, 3, 3) that hold float32 values.

    Corners of equal coordinates become one vertex, nothing else is merged; vertices are in the order of their
    first use. Raises `StageError` where a coordinate is not finite in float32.
    """
    points = to_single(corners.reshape(-1, 3))
    if not len(points):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    first, vertex_of_corner = _equal_rows(_keys(points))
    if not np.array_equal(points[first][vertex_of_corner], points):  # two points share a key: once in 10^6 files
        _, exact = np.unique(points, axis=0, return_inverse=True)
        first, vertex_of_corner = _equal_rows(exact.reshape(-1))
    return points[first].astype(np.float64), vertex_of_corner.reshape(-1, 3)


def to_single(coordinates: NDArray[np.floating]) -> Singles:
    """Return the coordinates in float32, -0.0 as 0.0; raises `StageError` where one is not finite there."""
    with np.errstate(over="ignore"):
        single: Singles = np.add(coordinates, np.float32(0.0), dtype=np.float32, casting="same_kind")
    if not np.isfinite(single).all():
        bad = int(np.count_nonzero(~np.isfinite(single)))
        raise StageError(f"coordinates: must be finite in float32, but {bad} of {single.size} are not")
    return single


def _unit_normals(corners: Singles) -> NDArray[np.float64]:
    """Return the normal of each triangle, (m, 3); zero where a triangle has no area."""
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    return normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]


def _keys(points: Singles) -> NDArray[np.uint64]:
    """Return a 64-bit key for each row, equal where the rows are: their bits, mixed."""
    x, y, z = np.ascontiguousarray(points).view(np.uint32).astype(np.uint64).T
    return _mixed(_mixed(x | (y << np.uint64(32))) ^ z)


def _mixed(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return splitmix64's finaliser of the keys: different keys stay different (Steele et al., 2014)."""
    keys = (keys ^ (keys >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    keys = (keys ^ (keys >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return keys ^ (keys >> np.uint64(31))


def _equal_rows(keys: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first place of each distinct key, ascending, and for each place the number of its key."""
    order = np.argsort(keys)
    ordered = keys[order]
    is_new = np.concatenate([[True], ordered[1:] != ordered[:-1]])
    first = np.minimum.reduceat(order, np.flatnonzero(is_new))
    by_first_use = np.argsort(first)
    number = np.empty_like(by_first_use)
    number[by_first_use] = np.arange(len(first))
    number_of_key = np.empty_like(order)
    number_of_key[order] = number[np.cumsum(is_new) - 1]
    return first[by_first_use], number_of_key
