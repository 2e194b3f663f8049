"""The result of every reader of surface files: polygons, and the file's unit, axes and notes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError


class Polygons(NamedTuple):
    """Polygons: `corners` are the corner indices of all, one after the other, `sizes` the number of corners of each.

    `vertices` (n, 3) are in the file's unit. `up` is the up axis of the format, `space` the anatomical axes named in
    the file (`RAS`, `LPS`), `notes` what was ignored, `doubts` warnings for the user.
    """

    vertices: Floats
    corners: Ints
    sizes: Ints
    unit: str | None = None
    up: str = "z"
    space: str | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def no_polygons() -> Polygons:
    """Return an empty set of polygons."""
    return Polygons(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64))


def of_triangles(vertices: Floats, faces: Ints) -> Polygons:
    """Return the polygons of triangles `faces` (m, 3)."""
    return Polygons(vertices, faces.ravel(), np.full(len(faces), 3))


def of_corners(corners: Floats) -> Polygons:
    """Return the polygons of triangles given by the coordinates of their corners, (m, 3, 3)."""
    return of_triangles(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def split_strip(strip: Ints) -> Ints:
    """Return the triangles (m, 3) of a strip: every other one is flipped, those with a repeated corner are left out."""
    if len(strip) < 3:  # corners of a triangle
        return np.empty((0, 3), np.int64)
    faces = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
    faces[1::2] = faces[1::2, [1, 0, 2]]
    a, b, c = faces.T
    kept: Ints = faces[(a != b) & (b != c) & (c != a)]
    return kept


def split_fan(fan: Ints) -> Ints:
    """Return the triangles (m, 3) of a fan of corners around its first."""
    if len(fan) < 3:  # corners of a triangle
        return np.empty((0, 3), np.int64)
    return np.stack([np.full(len(fan) - 2, fan[0]), fan[1:-1], fan[2:]], axis=1)


def first_three(words: list[bytes], name: str, line: int) -> list[bytes]:
    """Return the first three words, the coordinates of a vertex; a weight, normal or colour may follow."""
    if len(words) < 3:  # coordinates of a vertex
        raise StageError(f"{name}:{line}: a vertex has {len(words)} coordinates, needs 3; {AGAIN}")
    return words[:3]
