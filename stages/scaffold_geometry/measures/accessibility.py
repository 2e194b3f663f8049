"""Accessible porosity: the share of the pore space that a ball, such as a cell or drug carrier, reaches from outside.

A ball of diameter d is pushed in from OUTSIDE, as mercury is into a porous body (E. W. Washburn, "Note on a method of
determining the distribution of pore sizes in a porous material", PNAS 7 (1921)); it reaches what it covers, wherever
its centre can move. OUTSIDE is open to it; only positions with the centre in the outer shape count, so that the space
that a large ball touches through an opening is not counted as reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints, Singles
from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT, VoxelImage

REACHES = (0.5, 0.9, 0.99)
"""Shares of the pore volume for which throats are computed."""


class Throat(NamedTuple):
    """The widest ball that reaches `share` of the pore volume: its diameter, mm, and the place of the throat, (3,) mm.

    The place is that of the widest way's narrowest voxel, of those as narrow the one that lets the ball into most.
    Without any way in the diameter is 0, the place None.
    """

    share: float
    diameter: float
    place: Floats | None


class Accessibility(NamedTuple):
    """The `shares` (n,) of the pore volume that balls of the rising `diameters` (n,) mm reach, and throats."""

    diameters: Floats
    shares: Floats
    throats: tuple[Throat, ...]


def accessibility(image: VoxelImage, reaches: Sequence[float] = REACHES) -> Accessibility:
    """Return the curve of an image, with a throat for each of `reaches`; n is 0 without an open pore.

    Exact in the image: the diameters are all that its voxels can tell apart, 2 sqrt(integer) voxels, and the widest way
    into every voxel is found, not a list of sizes tried. The image is off by up to a voxel of diameter, as in
    `local_thickness`, whose measure of a ball is used. The ball's middle goes on across faces of voxels, across edges
    and corners also where its diameter is 2.8 voxels or more: so the least ball, of 2 voxels, reaches the open
    porosity. Takes 16 bytes a voxel.
    """
    from scaffold_geometry.measures.balls import greatest_balls

    is_pore = image.is_phase(PORE)
    widest, places = _widest_ways(image, is_pore)
    counts = np.bincount(greatest_balls(widest)[is_pore].astype(np.int32), minlength=1)
    shares = np.cumsum(counts[::-1])[::-1] / max(counts.sum(), 1)
    values = 1 + np.flatnonzero(counts[1:])
    shares = shares[values]
    throats = [_throat(share, values, shares, places, image) for share in reaches]
    return Accessibility(_diameters(values, image.spacing), shares, tuple(throats))


def reachable_share(found: Accessibility, diameters: Floats) -> Floats:
    """Return the share of the pore volume that balls of `diameters` (k,) mm reach, (k,)."""
    index = np.searchsorted(found.diameters, np.asarray(diameters, np.float64) * (1.0 - 1e-9))
    return np.append(found.shares, 0.0)[index]


def _widest_ways(image: VoxelImage, is_pore: NDArray[np.bool_]) -> tuple[Singles, Ints]:
    """Return the squared radius, in voxels, of the greatest ball whose middle gets to each pore voxel, and throats."""
    import edt

    from scaffold_geometry.measures.flooding import flood

    squared = np.asarray(edt.edtsq(~image.is_phase(STRUT), black_border=False), np.float32)
    squared[image.is_phase(OUTSIDE)] = np.inf
    squared[np.isinf(squared) & is_pore] = np.float32(np.square(image.phases.shape, dtype=np.int64).sum())
    top = int(squared[is_pore].max(initial=0.0))
    _, places = flood(squared, np.empty(squared.size, np.int32), top)
    np.negative(squared, out=squared)
    squared[(squared < 0.0) | ~is_pore] = 0.0
    return squared, places


def _throat(share: float, values: Ints, shares: Floats, places: Ints, image: VoxelImage) -> Throat:
    enough = np.flatnonzero(shares >= share)
    if not len(enough):
        return Throat(share, 0.0, None)
    squared = int(values[enough[-1]])
    place = image.place(tuple(int(i) for i in np.unravel_index(places[squared], image.phases.shape)))
    return Throat(share, float(_diameters(squared, image.spacing)), place)


def _diameters(squared: Ints | int, spacing: float) -> Floats:
    return 2.0 * spacing * np.sqrt(np.asarray(squared, np.float64))
