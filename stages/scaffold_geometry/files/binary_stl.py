"""Binary STL: triangles to bytes and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Singles
from scaffold_geometry.surfaces.merge_corners import merge_corners, to_single
from scaffold_pipeline.errors import StageError

_HEADER_BYTES = 80
_PREFIX_BYTES = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_AT_ONCE = 1 << 20


def to_stl(vertices: NDArray[np.floating], faces: NDArray[np.integer], header: str) -> bytes:
    """Return the binary STL of a triangle mesh: `vertices` (n, 3), `faces` (m, 3), rounded to float32.

    The same mesh and `header` give the same bytes. Raises `StageError` if the header is not ASCII text of at most 80
    characters or starts with "solid", as text STL does, or if a coordinate overflows float32.
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

    Raises `StageError` if the size does not match the number of triangles, or a coordinate is not finite.
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


def _unit_normals(corners: Singles) -> NDArray[np.float64]:
    """Return the normal of each triangle, (m, 3); zero for a triangle without area."""
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    return normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
