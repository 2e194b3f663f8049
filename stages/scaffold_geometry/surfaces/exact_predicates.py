"""Signs of determinants of points, exact despite rounding.

J. R. Shewchuk, "Adaptive precision floating-point arithmetic and fast robust geometric predicates", Discrete &
Computational Geometry 18 (1997) 305-363. Coordinates `points` (n, 3) are 0, or between 2^-200 and 1 in size, or whole
numbers, so that no product of three underflows or overflows.
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.jit import kernel

_SPLIT = 134217729.0
"""2^27 + 1 cuts a float64 into halves whose products are exact (Dekker, 1971)."""

_ORIENT_3D = 7.8e-16
_ORIENT_2D = 3.4e-16
"""Rounding error of a determinant, as a share of the sum of its terms' sizes: (7 + 56 e) e and (3 + 16 e) e with
e = 2^-53."""


@kernel
def orient_3d(points: Floats, a: int, b: int, c: int, d: int) -> int:
    """Return the sign of the volume of tetrahedron a, b, c, d."""
    px, py, pz = points[a, 0] - points[d, 0], points[a, 1] - points[d, 1], points[a, 2] - points[d, 2]
    qx, qy, qz = points[b, 0] - points[d, 0], points[b, 1] - points[d, 1], points[b, 2] - points[d, 2]
    rx, ry, rz = points[c, 0] - points[d, 0], points[c, 1] - points[d, 1], points[c, 2] - points[d, 2]
    one, two = qx * ry, qy * rx
    three, four = rx * py, ry * px
    five, six = px * qy, py * qx
    value = pz * (one - two) + qz * (three - four) + rz * (five - six)
    size = abs(pz) * (abs(one) + abs(two)) + abs(qz) * (abs(three) + abs(four)) + abs(rz) * (abs(five) + abs(six))
    if value > _ORIENT_3D * size:
        return 1
    if -value > _ORIENT_3D * size:
        return -1
    if size == 0.0:
        return 0
    return _exact_volume(points, a, b, c, d)


@kernel
def _exact_volume(points: Floats, a: int, b: int, c: int, d: int) -> int:
    """Return the sign of the determinant of a, b and c relative to d, as an exact sum of its products."""
    parts = np.empty((3, 3, 2))
    for axis in range(3):
        parts[0, axis, 0], parts[0, axis, 1] = _difference(points[a, axis], points[d, axis])
        parts[1, axis, 0], parts[1, axis, 1] = _difference(points[b, axis], points[d, axis])
        parts[2, axis, 0], parts[2, axis, 1] = _difference(points[c, axis], points[d, axis])
    terms, count = np.empty(192), 0
    for first in range(3):
        for step in range(1, 3):
            second, third = (first + step) % 3, (first + 2 * step) % 3
            sign = 1.0 if step == 1 else -1.0
            for part in range(8):
                x, y, z = parts[0, first, part & 1], parts[1, second, part >> 1 & 1], parts[2, third, part >> 2]
                if x != 0.0 and y != 0.0 and z != 0.0:  # most differences have no rounding error
                    _triple(terms, count, sign * x, y, z)
                    count += 4
    return _sign_of_sum(terms[:count])


@kernel
def orient_2d(points: Floats, a: int, b: int, c: int, axis: int) -> int:
    """Return the sign of the area of a, b, c seen along `axis`."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    pu, pv = points[a, u] - points[c, u], points[a, v] - points[c, v]
    qu, qv = points[b, u] - points[c, u], points[b, v] - points[c, v]
    one, two = pu * qv, pv * qu
    value, size = one - two, abs(one) + abs(two)
    if value > _ORIENT_2D * size:
        return 1
    if -value > _ORIENT_2D * size:
        return -1
    if size == 0.0:
        return 0
    return _exact_area(points, a, b, c, u, v)


@kernel
def _exact_area(points: Floats, a: int, b: int, c: int, u: int, v: int) -> int:
    """Return the sign of the area of a, b, c in the plane of the axes u and v."""
    parts = np.empty((2, 2, 2))
    for k, axis in ((0, u), (1, v)):
        parts[0, k, 0], parts[0, k, 1] = _difference(points[a, axis], points[c, axis])
        parts[1, k, 0], parts[1, k, 1] = _difference(points[b, axis], points[c, axis])
    terms = np.empty(16)
    for part in range(4):
        one, other = part & 1, part >> 1
        terms[4 * part], terms[4 * part + 1] = _product(parts[0, 0, one], parts[1, 1, other])
        terms[4 * part + 2], terms[4 * part + 3] = _product(-parts[0, 1, one], parts[1, 0, other])
    return _sign_of_sum(terms)


@kernel
def _triple(terms: Floats, start: int, x: float, y: float, z: float) -> None:
    """Write the product of three numbers as four terms that add up to it exactly."""
    high, low = _product(x, y)
    terms[start], terms[start + 1] = _product(high, z)
    terms[start + 2], terms[start + 3] = _product(low, z)


@kernel
def _difference(x: float, y: float) -> tuple[float, float]:
    """Return x - y and its rounding error, exact together (Knuth)."""
    difference = x - y
    back = x - difference
    return difference, (x - (difference + back)) + (back - y)


@kernel
def _product(x: float, y: float) -> tuple[float, float]:
    """Return x y and its rounding error, exact together (Dekker, 1971)."""
    product = x * y
    shifted = _SPLIT * x
    x_high = shifted - (shifted - x)
    x_low = x - x_high
    shifted = _SPLIT * y
    y_high = shifted - (shifted - y)
    y_low = y - y_high
    return product, x_low * y_low - (((product - x_high * y_high) - x_low * y_high) - x_high * y_low)


@kernel
def _sign_of_sum(terms: Floats) -> int:
    """Return the sign of an exact sum, kept as non-overlapping parts, least first."""
    parts = np.zeros(len(terms))
    for k in range(len(terms)):
        rest = terms[k]
        for i in range(k):
            total = rest + parts[i]
            back = total - rest
            parts[i] = (rest - (total - back)) + (parts[i] - back)
            rest = total
        parts[k] = rest
    for k in range(len(parts) - 1, -1, -1):
        if parts[k] != 0.0:
            return 1 if parts[k] > 0.0 else -1
    return 0
