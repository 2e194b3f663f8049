"""Diffusion through the pores: effective diffusivity and tortuosity along x, y and z."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats
from scaffold_geometry.measures.conduction import flow_through, links_between
from scaffold_geometry.measures.inscribed_box import InscribedBox, inscribed_box
from scaffold_geometry.voxels.image import PORE, VoxelImage


class AxisTransport(NamedTuple):
    """Diffusion through a box along one axis.

    `relative_diffusivity`: D_eff / D_0, of the box as a whole to that of the free medium, 0 where no pore leads
    through. `voxel_error`: by how much it is estimated to be off for the voxels' sake; minus that, the limit of
    vanishing voxels. None where no pore of twice the voxel leads through. `percolating_porosity`: share of the box in
    pores that lead from one face to the other. `tortuosity`: that share over D_eff / D_0; None where no pore does.
    """

    relative_diffusivity: float
    voxel_error: float | None
    percolating_porosity: float

    @property
    def tortuosity(self) -> float | None:
        """Return the tortuosity factor, 1 for straight channels."""
        return self.percolating_porosity / self.relative_diffusivity if self.relative_diffusivity else None


class Transport(NamedTuple):
    """Diffusion through the pores in a box: its corners (2, 3) mm, its share of the outer shape's volume.

    `voxel_size`, mm, is the edge of the cells that were computed with; along `x`, `y` and `z` the results.
    """

    bounds: Floats
    box_share: float
    voxel_size: float
    x: AxisTransport
    y: AxisTransport
    z: AxisTransport


def transport(image: VoxelImage, most_cells: int = 1_000_000) -> Transport | None:
    """Return the diffusion through the pores along each axis; None if the shape is only a voxel thick.

    An outer shape has no two opposite faces, so diffusion is followed through the largest box in it. Concentration is
    1 on one face of the box and 0 on the opposite one, nothing crosses the others and the struts; Laplace's equation
    in the pores by finite volumes. D_eff / D_0 = flow * length / (cross-section * drop), where the cross-section is
    the box's; the tortuosity factor is porosity / (D_eff / D_0) (Epstein, Chem. Eng. Sci. 44 (1989) 777-779: the square
    of the ratio of path lengths). Porosity counts the pores that lead through, face to face, as PoreSpy's
    `tortuosity_fd` does: others carry nothing, and would appear as winding ways. PoreSpy holds the concentrations in
    the middle of the outermost voxels; here they are held on the faces, so that the whole box counts.

    More pore voxels than `most_cells` are joined to blocks, with the open share of each common face as conductance:
    blocks of 2, 4 and 8 voxels of 96 to a cell of a gyroid changed D_eff by 0.2, 0.5 and 1.1 %. The staircase of voxels
    makes D_eff too small, by 3 % at 48 voxels a cell. Both errors are in proportion to the voxels, so that the same on
    every second voxel tells by how much; within a factor of two from 16 voxels a cell. A million cells take 10 s an
    axis and, with an image of 512^3, 1.5 GB.
    """
    box = inscribed_box(image)
    if box is None or box.sides.min() < 2:  # every second voxel of it must be left
        return None
    pores = image.phases[tuple(slice(*ends) for ends in zip(box.first, box.end, strict=True))] == PORE
    factor = _factor(int(np.count_nonzero(pores)), most_cells, int(box.sides.min()))
    box = _trim_box(box, 2 * factor)
    pores = pores[tuple(slice(side) for side in box.sides)]
    axes = diffusion_through(pores, factor)
    return Transport(box.bounds(image), box.share, factor * image.spacing, *axes)


def _factor(voxels: int, most_cells: int, shortest: int) -> int:
    """Return the voxels a side of the smallest blocks that are few enough, two of which fit along each side."""
    factor = 1
    while voxels / factor**3 > most_cells and 2 * (factor + 1) <= shortest:
        factor += 1
    return factor


def _trim_box(box: InscribedBox, multiple: int) -> InscribedBox:
    """Return the box with sides that are a multiple of some voxels, the last layers left off."""
    sides = box.sides - box.sides % multiple
    share = box.share * float(np.prod(sides) / np.prod(box.sides))
    return InscribedBox(box.first, box.first + sides, share)


def diffusion_through(pores: Bools, factor: int = 1) -> tuple[AxisTransport, AxisTransport, AxisTransport]:
    """Return the diffusion through `pores` (nx, ny, nz) along each axis, in blocks of `factor` voxels.

    Each side must be a multiple of twice the `factor`.
    """
    fine, coarse = _relative_diffusivities(pores, factor), _relative_diffusivities(pores[::2, ::2, ::2], factor)
    x, y, z = (
        AxisTransport(value, twice - value if twice or not value else None, porosity)
        for (value, porosity), (twice, _) in zip(fine, coarse, strict=True)
    )
    return x, y, z


def _relative_diffusivities(pores: Bools, factor: int) -> list[tuple[float, float]]:
    """Return D_eff / D_0 and the share of pores that lead through, along x, y and z."""
    from scipy.ndimage import label

    pieces, count = label(pores)
    results = []
    for axis in range(3):
        faces = np.moveaxis(pieces, axis, 0)
        leads = np.zeros(count + 1, bool)
        leads[np.intersect1d(faces[0], faces[-1])] = True
        leads[0] = False
        results.append(_through(leads[pieces], factor, axis) if leads.any() else (0.0, 0.0))
    return results


def _through(is_open: Bools, factor: int, axis: int) -> tuple[float, float]:
    counts = [length // factor for length in is_open.shape]
    blocks = np.asarray(is_open.reshape(counts[0], factor, counts[1], factor, counts[2], factor).any(axis=(1, 3, 5)))
    flow = flow_through(blocks, links_between(is_open, factor), axis)
    return flow * counts[axis] ** 2 / blocks.size, float(np.count_nonzero(is_open) / is_open.size)
