"""The boundary of a volume mesh as a surface of triangles."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.volumes.cells import Faces


def enclosed_volume(vertices: Floats, faces: Faces) -> float:
    """Return the volume that the boundary encloses, with quadrangles split around their centres, as in `cell_volumes`.

    By Gauss's theorem it equals the volume of the cells, unless cells overlap or faces do not match.
    """
    origin = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - origin)[faces.triangles], 1, 0)
    total = float(np.einsum("ij,ij->", a, np.cross(b, c)))
    ring = (vertices - origin)[faces.quadrangles]
    hub = ring.mean(axis=1)
    total += float(np.einsum("ij,ikj->", hub, np.cross(ring, np.roll(ring, -1, axis=1))))
    return total / 6.0


def boundary_triangles(vertices: Floats, faces: Faces) -> tuple[Ints, Ints]:
    """Return the boundary as triangles (t, 3), outward, and the cell of each, (t,).

    A quadrangle is split along its shorter diagonal; if both are equal, along that of its vertex of lowest number. The
    result does not depend on the cell or on the order of its corners.
    """
    a, b, c, d = np.moveaxis(faces.quadrangles, 1, 0)
    one, other = (np.linalg.norm(vertices[p] - vertices[q], axis=1) for p, q in ((a, c), (b, d)))
    is_even = np.abs(one - other) <= 1e-9 * (one + other)
    least = np.argmin(faces.quadrangles, axis=1) if len(a) else np.empty(0, np.int64)
    along_one = np.where(is_even, least % 2 == 0, one < other)
    halves = [
        np.where(along_one[:, None], np.column_stack([a, b, c]), np.column_stack([a, b, d])),
        np.where(along_one[:, None], np.column_stack([a, c, d]), np.column_stack([b, c, d])),
    ]
    owners = [faces.triangle_cells, faces.quadrangle_cells, faces.quadrangle_cells]
    return np.concatenate([faces.triangles, *halves]), np.concatenate(owners)
