"""One pass over the triangles of a surface: how they face, how flat they are, what hangs together.

Vertices (n, 3) float64, faces (m, 3) int64, counter-clockwise from outside. Where `triangles.py` gathers all corners
at once these go triangle by triangle, which for millions of them is the difference between megabytes and gigabytes.
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.jit import kernel


@kernel(inline=True)
def _doubled_normal(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float
) -> tuple[float, float, float]:
    """Return the normal of a triangle, as long as twice its area."""
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def facing(vertices: Floats, faces: Ints, direction: Floats) -> tuple[Floats, Floats]:
    """Return the area of each face and the cosine of its normal with a unit `direction` (3,), both (m,).

    The cosine of a face without area is 0.
    """
    areas, cosines = np.zeros(len(faces)), np.zeros(len(faces))
    for i in range(len(faces)):
        a, b, c = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        x, y, z = _doubled_normal(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
        length = np.sqrt(x * x + y * y + z * z)
        areas[i] = length / 2.0
        if length > 0.0:
            cosines[i] = (x * direction[0] + y * direction[1] + z * direction[2]) / length
    return areas, cosines


@kernel
def cone_angles(vertices: Floats, faces: Ints, up: Floats, is_asked: Bools) -> Floats:
    """Return the solid angle about the unit direction `up` (3,) that the faces at a lowest vertex bound, signed, (n,).

    It is below 0 where the solid lies within, so that it starts at the vertex, above 0 where a pore does, and 0 where
    it is not asked for. The sum of the spherical triangles between `up` and the edges of each face at the vertex: Van
    Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126.
    """
    angles = np.zeros(len(vertices))
    for i in range(len(faces)):
        for k in range(3):
            tip = faces[i, k]
            if is_asked[tip]:
                a = vertices[faces[i, (k + 1) % 3]] - vertices[tip]
                b = vertices[faces[i, (k + 2) % 3]] - vertices[tip]
                la, lb = np.sqrt((a * a).sum()), np.sqrt((b * b).sum())
                x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
                above = up[0] * x + up[1] * y + up[2] * z
                angles[tip] += 2.0 * np.arctan2(
                    above, la * lb + (a * up).sum() * lb + (b * up).sum() * la + (a * b).sum()
                )
    return angles


@kernel
def shell_sums(vertices: Floats, faces: Ints, shells: Ints, count: int) -> tuple[Floats, Floats]:
    """Return the signed volume within each of `count` shells, (k,), and its centroid, (k, 3).

    `shells` (m,) is the shell of each face. Tetrahedra from a point near the shell, so that no small difference of
    great numbers is left: its first vertex. The centroid of a shell of no volume is that vertex.
    """
    volumes, moments, origins = np.zeros(count), np.zeros((count, 3)), np.full((count, 3), np.nan)
    for i in range(len(faces)):
        shell = shells[i]
        if np.isnan(origins[shell, 0]):
            origins[shell] = vertices[faces[i, 0]]
        o = origins[shell]
        ax, ay, az = vertices[faces[i, 0], 0] - o[0], vertices[faces[i, 0], 1] - o[1], vertices[faces[i, 0], 2] - o[2]
        bx, by, bz = vertices[faces[i, 1], 0] - o[0], vertices[faces[i, 1], 1] - o[1], vertices[faces[i, 1], 2] - o[2]
        cx, cy, cz = vertices[faces[i, 2], 0] - o[0], vertices[faces[i, 2], 1] - o[1], vertices[faces[i, 2], 2] - o[2]
        volume = (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6.0
        volumes[shell] += volume
        moments[shell, 0] += volume * (ax + bx + cx) / 4.0
        moments[shell, 1] += volume * (ay + by + cy) / 4.0
        moments[shell, 2] += volume * (az + bz + cz) / 4.0
    for k in range(count):
        if volumes[k] != 0.0:
            origins[k] += moments[k] / volumes[k]
    return volumes, origins


@kernel
def label_connected_faces(faces: Ints, count: int) -> Ints:
    """Return the number of the part that each face belongs to, (m,), from 0 in the order of their first faces.

    Faces that share one of the `count` vertices hang together.
    """
    parents = np.arange(count)
    for i in range(len(faces)):
        a, b, c = _root(parents, faces[i, 0]), _root(parents, faces[i, 1]), _root(parents, faces[i, 2])
        least = min(a, b, c)
        parents[a] = parents[b] = parents[c] = least
    numbers, labels, found = np.full(count, -1), np.empty(len(faces), np.int64), 0
    for i in range(len(faces)):
        root = _root(parents, faces[i, 0])
        if numbers[root] < 0:
            numbers[root] = found
            found += 1
        labels[i] = numbers[root]
    return labels


@kernel
def faces_near(vertices: Floats, faces: Ints, places: Floats, reach: float) -> Bools:
    """Return which faces come into a cube of half edge `reach` about one of `places` (k, 3), by their boxes, (m,)."""
    near = np.zeros(len(faces), np.bool_)
    for i in range(len(faces)):
        a, b, c = vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]]
        for k in range(len(places)):
            meets = True
            for axis in range(3):
                low, high = min(a[axis], b[axis], c[axis]), max(a[axis], b[axis], c[axis])
                meets &= low <= places[k, axis] + reach and high >= places[k, axis] - reach
            if meets:
                near[i] = True
                break
    return near


@kernel
def _root(parents: Ints, place: int) -> int:
    """Return the root of a part, halving the way to it for the next walk (Tarjan, van Leeuwen, 1984)."""
    while parents[place] != place:
        parents[place] = parents[parents[place]]
        place = parents[place]
    return place
