"""Join meshes that a file places by transforms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError

_WORTH_A_WORD = 1000.0 * (1.0 + 1e-6)
"""Scale factor above which a matrix is not a change of units such as mm to m."""


class Placed(NamedTuple):
    """A mesh, `vertices` (n, 3) and `faces` (m, 3), and its transform (4, 4) of x, y, z, 1.

    With `is_coded` the vertices are integers, which the matrix converts to lengths.
    """

    vertices: Floats
    faces: Ints
    matrix: Floats
    is_coded: bool = False


def join_placed(meshes: list[Placed], thing: str, name: str) -> tuple[Floats, Ints, tuple[str, ...]]:
    """Return vertices and faces of all transformed meshes, and warnings for the user.

    The faces of a mirrored mesh are flipped, so that it still faces outward. Raises `StageError` for a matrix that is
    not finite or singular.
    """
    vertices, faces, start = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    greatest = 1.0
    for mesh in meshes:
        linear, shift = mesh.matrix[:3, :3], mesh.matrix[:3, 3]
        if not np.isfinite(mesh.matrix).all() or np.linalg.matrix_rank(linear) < 3 or not _is_affine(mesh.matrix):
            raise StageError(f"{name}: a {thing} has a singular or invalid matrix; {AGAIN}")
        sizes = np.linalg.svd(linear, compute_uv=False)
        factors = (greatest,) if mesh.is_coded else (greatest, sizes[0], sizes[-1])
        greatest = max(factors, key=lambda factor: abs(np.log(factor)))
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused with the vertices
            vertices.append(mesh.vertices @ linear.T + shift)
        turned = mesh.faces[:, ::-1] if np.linalg.det(linear) < 0.0 else mesh.faces
        faces.append(turned + start)
        start += len(mesh.vertices)
    is_odd = abs(np.log(greatest)) > np.log(_WORTH_A_WORD)
    doubts = (f"a {thing} changes the size by a factor of {greatest:.4g}; check the size",) if is_odd else ()
    return np.concatenate(vertices), np.concatenate(faces), doubts


def _is_affine(matrix: Floats) -> bool:
    return bool(np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]))
