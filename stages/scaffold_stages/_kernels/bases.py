"""The radial basis functions, each of the *squared* distance r^2: most need no root.

Hardy, "Multiquadric equations of topography and other irregular surfaces", J. Geophys. Res. 76 (1971). Duchon,
"Splines minimizing rotation-invariant semi-norms in Sobolev spaces" (1977). Franke, "Scattered data
interpolation: tests of some methods", Math. Comp. 38 (1982). Liu, Guo, Yu (see `interpolant.py`) use the inverse
multiquadric with c = 0.1.
"""

from __future__ import annotations

import math

from scaffold_stages._kernels._jit import kernel

GAUSSIAN, MULTIQUADRIC, INVERSE_MULTIQUADRIC, THIN_PLATE_SPLINE = range(4)

BASES = {
    "gaussian": GAUSSIAN,
    "multiquadric": MULTIQUADRIC,
    "inverse_multiquadric": INVERSE_MULTIQUADRIC,
    "thin_plate_spline": THIN_PLATE_SPLINE,
}
"""The name of each basis function and its number in kernels."""


@kernel(inline=True)
def gaussian(squared: float, c: float) -> float:
    """Return exp(-(c r)^2); c is 1/mm."""
    return math.exp(-c * c * squared)


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
    return 0.5 * squared * math.log(squared) if squared > 0.0 else 0.0


@kernel(inline=True)
def basis_value(basis: int, squared: float, c: float) -> float:
    """Return phi(r) for the basis function of number `basis` (see `BASES`)."""
    if basis == GAUSSIAN:
        return gaussian(squared, c)
    if basis == MULTIQUADRIC:
        return multiquadric(squared, c)
    if basis == INVERSE_MULTIQUADRIC:
        return inverse_multiquadric(squared, c)
    return thin_plate_spline(squared)
