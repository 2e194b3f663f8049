"""Triply periodic minimal surfaces as nodal surfaces: zero levels of sums of waves, f(X, Y, Z) with period 2 pi.

The surfaces: H. A. Schwarz, "Gesammelte mathematische Abhandlungen" (1890), P and D; A. H. Schoen, "Infinite periodic
minimal surfaces without self-intersections", NASA TN D-5541 (1970), G and I-WP. The formulas: H. G. von Schnering,
R. Nesper, "Nodal surfaces of Fourier series: fundamental invariants of structured matter", Z. Phys. B 83 (1991).
They approximate the minimal surfaces, with the same symmetry and topology.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy import cos, sin

from scaffold_geometry.arrays import Floats

Surface: TypeAlias = Callable[[Floats, Floats, Floats], Floats]

_SAMPLES = 64
_OFFSETS = (0.2, 0.45, 0.8)
"""Offsets of the samples along x, y and z, in steps: with equal ones many values coincide, and shares are 0.002 off."""


def schwarz_p(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return cos X + cos Y + cos Z, -3 to 3: a simple cubic network of tubes on either side."""
    f: Floats = cos(x) + cos(y) + cos(z)
    return f


def schwarz_d(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return sXsYsZ + sXcYcZ + cXsYcZ + cXcYsZ, s = sin, c = cos, -1.41 to 1.41: a diamond network on either side."""
    f: Floats = sin(x) * (sin(y) * sin(z) + cos(y) * cos(z)) + cos(x) * (sin(y) * cos(z) + cos(y) * sin(z))
    return f


def gyroid(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return sin X cos Y + sin Y cos Z + sin Z cos X, -1.5 to 1.5: two networks with three-way nodes, mirror images."""
    f: Floats = sin(x) * cos(y) + sin(y) * cos(z) + sin(z) * cos(x)
    return f


def iwp(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return 2 (cXcY + cYcZ + cZcX) - (cos 2X + cos 2Y + cos 2Z), c = cos, -5 to 3.

    Above 0 is the body-centred network with eight-way nodes (I), below it the wrapped package (WP).
    """
    f: Floats = 2.0 * (cos(x) * cos(y) + cos(y) * cos(z) + cos(z) * cos(x)) - (
        cos(2.0 * x) + cos(2.0 * y) + cos(2.0 * z)
    )
    return f


SURFACES: dict[str, Surface] = {"schwarz_p": schwarz_p, "schwarz_d": schwarz_d, "gyroid": gyroid, "iwp": iwp}
"""The function of each surface, by name; X, Y and Z broadcast."""


def sheet_of(surface: Surface) -> Surface:
    """Return -|f|: above any level below 0 lies a sheet around the surface f = 0."""
    return lambda x, y, z: -np.abs(surface(x, y, z))


def levels_at(surface: Surface, shares: Floats) -> Floats:
    """Return the level below which each of the given shares of a cell's volume lies, (n,)."""
    x, y, z = (2.0 * np.pi * (np.arange(_SAMPLES) + offset) / _SAMPLES for offset in _OFFSETS)
    levels: Floats = np.quantile(surface(x[:, None, None], y[:, None], z), shares)
    return levels
