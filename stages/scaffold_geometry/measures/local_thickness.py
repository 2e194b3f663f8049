"""Thickness of struts and width of pores: the largest ball within the phase that contains each voxel.

T. Hildebrand, P. Rueegsegger, "A new method for the model-independent assessment of thickness in three-dimensional
images", J. Microscopy 185 (1997); by the balls of R. Dougherty, K.-H. Kunzelmann, "Computing local thickness of 3D
structures with ImageJ", Microsc. Microanal. 13 (2007).

OUTSIDE is a wall for both phases. A pore ends at the outer shape, as the body around the scaffold begins there; without
this wall, the size of a pore at its opening would be undefined.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Singles
from scaffold_geometry.voxels.image import VoxelImage

PERCENTILES = (5.0, 25.0, 75.0, 95.0)

LEAST_RESOLVED = 3.0
"""Least resolved thickness of a wall, voxels: an error of one voxel is a third of it."""

_BINS = 40
"""Bars of a histogram at most; none is narrower than a voxel."""


class Distribution(NamedTuple):
    """The local thickness over the voxels of a phase, each of the same weight, so by volume; mm.

    `deviation` is the median absolute deviation from the median; `percentiles` (4,) are those of `PERCENTILES`;
    `shares` (n,) are those of the volume between `edges` (n + 1,).
    """

    mean: float
    median: float
    deviation: float
    percentiles: Floats
    edges: Floats
    shares: Floats


def local_thickness(mask: Bools, spacing: float) -> Singles:
    """Return the diameter, mm, of the greatest ball in `mask` (nx, ny, nz) that holds each voxel, 0 outside.

    A ball's radius is the distance from a voxel's middle to that of the nearest voxel outside. Its diameter is off by
    -1.7 voxels, where the true middle is a corner of voxels, to 1, in a wall along the grid of an odd number of them.
    At the mean of places and directions that is 0.2 to 0.6 voxels too much in plates, 0.2 too little in rods, 0.8 too
    little in balls; in a scaffold of rods and nodes the mean was off by 0.01 voxels in struts and 0.2 in pores. In
    the image nothing else is approximated, but in one whose balls hold so many voxels that `greatest_balls` takes
    larger ones. What lies beyond the array counts as outside. Takes 16 bytes a voxel.
    """
    from scaffold_geometry.measures.balls import greatest_balls

    squared = _squared_depths(mask)
    thickness = np.sqrt(greatest_balls(squared), out=squared)
    thickness *= np.float32(2.0 * spacing)
    return thickness


def distribution(image: VoxelImage, phase: int, thickness: Singles) -> Distribution | None:
    """Return how the local thickness of `phase` is distributed, given its map `thickness`; None without such a voxel.

    It has no least: that would be the image's own, as in each corner and on each step of a surface there is a voxel
    that only a ball of a voxel holds.
    """
    is_phase = image.is_phase(phase)
    values, counts = _diameters(thickness[is_phase], image.spacing)
    if not len(values):
        return None
    median = _quantile(values, counts, 0.5)
    apart = np.abs(values - median)
    order = np.argsort(apart)
    mean = float(np.average(values, weights=counts))
    edges = histogram_edges(float(values[-1]), image.spacing)
    shares, _ = np.histogram(values, edges, weights=counts)
    return Distribution(
        mean=mean,
        median=median,
        deviation=_quantile(apart[order], counts[order], 0.5),
        percentiles=np.array([_quantile(values, counts, share / 100.0) for share in PERCENTILES]),
        edges=edges,
        shares=shares / counts.sum(),
    )


def thickness_at(image: VoxelImage, thickness: Singles, points: Floats) -> Floats:
    """Return the map's value at the voxel of the phase nearest to each point (n, 3) mm, (n,) mm.

    It is looked for as far as two voxels from that of the point, what a surface is off by at the most; where there is
    none, the strut is thinner than the image can show, and the value 0.
    """
    from scaffold_geometry.voxels.nearest import nearest_values

    return nearest_values(thickness, (np.asarray(points, np.float64) - image.origin) / image.spacing)


def is_resolved(mean_thickness: float, spacing: float) -> bool:
    """Return whether walls of `mean_thickness` are at least `LEAST_RESOLVED` voxels thick; both in mm."""
    return mean_thickness >= LEAST_RESOLVED * spacing


def histogram_edges(greatest: float, spacing: float) -> Floats:
    """Return edges from 0 to `greatest` mm or above, whole voxels apart."""
    voxels = greatest / spacing
    width = max(1.0, np.ceil(voxels / _BINS))
    return np.asarray(spacing * width * np.arange(int(voxels // width) + 2))


def _diameters(thickness: Singles, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Return the diameters, mm, rising, that `thickness` (n,) has, and how often: roots of whole numbers of voxels."""
    squared = np.rint(np.square(thickness * np.float32(0.5 / spacing))).astype(np.int32)
    counts = np.bincount(squared)
    present = np.flatnonzero(counts)
    return 2.0 * spacing * np.sqrt(present), counts[present]


def _squared_depths(mask: Bools) -> Singles:
    """Return the squared distance, in voxels, of each voxel of `mask` to the nearest outside."""
    import edt

    return np.asarray(edt.edtsq(np.ascontiguousarray(mask), black_border=True), np.float32)


def _quantile(values: Floats, counts: NDArray[np.int64], share: float) -> float:
    """Return the least of rising `values` (n,) up to which `counts` (n,) hold the share."""
    reached = np.cumsum(counts)
    return float(values[np.searchsorted(reached, share * reached[-1])])
