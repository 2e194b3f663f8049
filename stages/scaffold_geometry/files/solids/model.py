"""The content of a file to write, and the mesh read from a file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Ints, Singles
from scaffold_geometry.surfaces.merge_corners import merge_corners, to_single
from scaffold_pipeline import __version__

APPLICATION = f"scaffold-pipeline {__version__}"

_ROWS_AT_ONCE = 1 << 16

Text: TypeAlias = Iterator[str]


class Mesh(NamedTuple):
    """Vertices (n, 3) float32, mm, and faces (m, 3), in the order of a file."""

    vertices: Singles
    faces: Ints

    def equals(self, other: Mesh) -> bool:
        """Return whether both have the same numbers in the same order."""
        return np.array_equal(self.vertices, other.vertices) and np.array_equal(self.faces, other.faces)


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh with its title, its colour as "#RRGGBB", and the hash of its configuration."""

    mesh: Mesh
    title: str
    colour: str
    config_hash: str | None = None

    @property
    def notes(self) -> dict[str, str]:
        """Comments for a format without metadata, all ASCII."""
        notes = {"application": APPLICATION, "unit": "mm"}
        return notes if self.config_hash is None else {**notes, "config_sha256": self.config_hash}


def mesh_of_corners(corners: NDArray[np.floating]) -> Mesh:
    """Return triangles (m, 3, 3) as a mesh: corners of equal float32 merged, vertices in the order of first use."""
    vertices, faces = merge_corners(corners)
    return Mesh(vertices.astype(np.float32), faces)


def mesh_as_read(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """Return the mesh from a reader's arrays; raises `StageError` if a coordinate is not finite in float32."""
    return Mesh(to_single(np.asarray(vertices)), np.asarray(faces, np.int64))


def rows(row: str, table: NDArray[Any]) -> Text:
    """Yield the rows of a table as text, many rows at a time."""
    for start in range(0, len(table), _ROWS_AT_ONCE):
        part = table[start : start + _ROWS_AT_ONCE]
        yield (row * len(part)) % tuple(part.reshape(-1).tolist())
