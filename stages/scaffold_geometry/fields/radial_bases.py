"""The radial basis functions, each of the *squared* distance r^2: most need no square root.

Hardy, "Multiquadric equations of topography and other irregular surfaces", J. Geophys. Res. 76 (1971). Duchon,
"Splines minimizing rotation-invariant semi-norms in Sobolev spaces" (1977). Franke, "Scattered data
interpolation: tests of some methods", Math. Comp. 38 (1982). Liu, Guo, Yu (see `interpolant.py`) use the inverse
multiquadric with c = 0.1.

exp, ln and, for long sums, 1/sqrt are computed by IEEE operations here and not by a library: loops over them are
vectorised, and their digits do not depend on the library.
"""

from __future__ import annotations

import math

import numpy as np

from scaffold_geometry.jit import kernel

_FUSED = frozenset({"contract"})
"""Fused multiply-add; nothing that reorders a sum."""

GAUSSIAN, MULTIQUADRIC, INVERSE_MULTIQUADRIC, THIN_PLATE_SPLINE = range(4)

BASES = {
    "gaussian": GAUSSIAN,
    "multiquadric": MULTIQUADRIC,
    "inverse_multiquadric": INVERSE_MULTIQUADRIC,
    "thin_plate_spline": THIN_PLATE_SPLINE,
}
"""The name of each basis function and its number in kernels."""

_ROOTS = {MULTIQUADRIC, INVERSE_MULTIQUADRIC}

ROOT_SCALE = -64.0
"""Scale of `scaled_reciprocal_root`: a power of two, so that division by it is exact."""

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
"""ln 2 in two parts (Cody, Waite 1980): the first has few digits, so that its product with an exponent is exact."""

_TO_INTEGER = 1.5 * 2.0**52
"""Adding it to a number puts the nearest integer into the last bits."""

_LEAST_EXPONENT = -708.0
"""exp of a smaller number is subnormal."""

_ROOT_HALF = 0x3FE6A09E667F3BCD
"""The bits of sqrt(1/2)."""

_LEAST_SHIFT = 1e-290
"""Least c^2 of a sum: the powers of its reciprocal square root stay in range."""


@kernel(inline=True, fastmath=_FUSED)
def exponential(x: float) -> float:
    """Return exp(x) for x <= 0 with a relative error below 3e-16; exp(-708) for x < -708.

    2^n exp(r), |r| <= ln(2)/2, and Taylor's series of exp(r), even and odd powers apart, which halves the latency.
    """
    x = max(x, _LEAST_EXPONENT)
    shifted = x * _LOG2_E + _TO_INTEGER
    n = shifted - _TO_INTEGER
    r = x - n * _LN2_HIGH - n * _LN2_LOW
    r2 = r * r
    even = ((r2 / 479001600.0 + 1.0 / 3628800.0) * r2 + 1.0 / 40320.0) * r2 + 1.0 / 720.0
    odd = ((r2 / 6227020800.0 + 1.0 / 39916800.0) * r2 + 1.0 / 362880.0) * r2 + 1.0 / 5040.0
    even, odd = (even * r2 + 1.0 / 24.0) * r2 + 0.5, (odd * r2 + 1.0 / 120.0) * r2 + 1.0 / 6.0
    p = (odd * r + even) * r2 + r + 1.0
    return np.int64(np.float64(p).view(np.int64) + (np.float64(shifted).view(np.int64) << 52)).view(np.float64)


@kernel(inline=True, fastmath=_FUSED)
def logarithm(x: float) -> float:
    """Return ln(x) for a normal x > 0 with a relative error below 4e-16; a finite number for smaller x.

    n ln 2 + 2 artanh((m - 1) / (m + 1)), sqrt(1/2) <= m < sqrt(2), and the series of artanh.
    """
    bits = np.float64(x).view(np.int64)
    n = (bits - _ROOT_HALF) >> 52
    m = np.int64(bits - (n << 52)).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    z2 = z * z
    odd = (((z2 / 19.0 + 1.0 / 15.0) * z2 + 1.0 / 11.0) * z2 + 1.0 / 7.0) * z2 + 1.0 / 3.0
    even = ((z2 / 17.0 + 1.0 / 13.0) * z2 + 1.0 / 9.0) * z2 + 0.2
    return n * _LN2_HIGH + (n * _LN2_LOW + 2.0 * (s * (even * z2 + odd * z) + s))


@kernel(inline=True, fastmath=_FUSED)
def scaled_reciprocal_root(x: float) -> float:
    """Return `ROOT_SCALE` / sqrt(x) for 1e-290 <= x <= 1e290 with a relative error below 5e-16.

    A square root and a division take 40 cycles per vector of 512 bits, these 11 operations 6. Halving the exponent bits
    (Lomont, "Fast inverse square root", 2003) gives y with x y^2 in [3/4, 27/32]. Up to a factor, the quadratic of
    least error brings this to 1 within 5e-5, and Taylor's cubic to 1 within 2e-18. Both polynomials have the leading
    coefficient 1, and are centred so that one more coefficient is 0. The omitted factors make up the scale; the
    quadratic's is 0.05^(1/7) instead of 0.663, so that the scale is a power of two.
    """
    y = np.int64(0x5FE4000000000000 - (np.float64(x).view(np.int64) >> 1)).view(np.float64)
    t = x * (y * y) - 1.33708
    y = y * (t * t + 1.426756)
    t = x * (y * y) - 3.2949656511103536
    return y * ((t * t + 6.203884938284043) * t - 35.04272190014879)


@kernel(inline=True)
def gaussian(squared: float, c: float) -> float:
    """Return exp(-(c r)^2); c is 1/mm."""
    return exponential(-c * c * squared)


@kernel(inline=True)
def multiquadric(squared: float, c: float) -> float:
    """Return sqrt(r^2 + c^2) (Hardy 1971); c is mm."""
    return math.sqrt(squared + c * c)


@kernel(inline=True)
def inverse_multiquadric(squared: float, c: float) -> float:
    """Return 1 / sqrt(r^2 + c^2) (Franke 1982, "reciprocal multiquadric"); c is mm."""
    return 1.0 / math.sqrt(squared + c * c)


@kernel(inline=True)
def thin_plate_spline(squared: float) -> float:
    """Return r^2 ln r (Duchon 1977), 0 at r = 0; it has no shape parameter."""
    return 0.5 * squared * logarithm(squared)


@kernel(inline=True)
def radial_basis(basis: int, squared: float, c: float) -> float:
    """Return phi(r) for the basis function of number `basis` (see `BASES`)."""
    if basis == GAUSSIAN:
        return gaussian(squared, c)
    if basis == MULTIQUADRIC:
        return multiquadric(squared, c)
    if basis == INVERSE_MULTIQUADRIC:
        return inverse_multiquadric(squared, c)
    return thin_plate_spline(squared)


def shift_of(basis: int, c: float) -> float:
    """Return the number that is added to the squared distance for `summand`: c^2, or 0."""
    return max(c * c, _LEAST_SHIFT) if basis in _ROOTS else 0.0


def scale_of(basis: int) -> float:
    """Return the factor between `summand` and phi."""
    return ROOT_SCALE if basis in _ROOTS else 1.0


@kernel(inline=True, fastmath=_FUSED)
def summand(basis: int, shifted: float, c: float) -> float:
    """Return `scale_of(basis)` phi(r), the term of a long sum, from `shifted` = r^2 + `shift_of(basis, c)`."""
    if basis == GAUSSIAN:
        return gaussian(shifted, c)
    if basis == MULTIQUADRIC:
        return shifted * scaled_reciprocal_root(shifted)
    if basis == INVERSE_MULTIQUADRIC:
        return scaled_reciprocal_root(shifted)
    return thin_plate_spline(shifted)
