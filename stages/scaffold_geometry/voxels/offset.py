"""The inward offset of a closed surface."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.voxels.grids import dilate, grid_over, samples_inside
from scaffold_geometry.voxels.iso_surface import extract_iso_surface

_BAND = 3.0
"""Distance from the offset surface, in samples, within which the distance field is exact."""

_FINEST, _COARSEST = 600.0, 100.0
"""Most and fewest samples along the diagonal of the shape; the most need about 2 GB."""


def offset_inward(vertices: Floats, faces: Ints, depth: float) -> tuple[Floats, Ints]:
    """Return the surface `depth` mm inside a closed one: the exact distance, contoured on a grid.

    The grid's spacing is half the depth, within limits for memory and accuracy. Both arrays are empty if no point is
    so deep.
    """
    import igl
    from scipy.ndimage import distance_transform_edt

    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
    spacing = float(np.clip(depth / 2.0, diagonal / _FINEST, diagonal / _COARSEST))
    origin, shape = grid_over(bounds, spacing, 2)
    inside = samples_inside(vertices, faces, origin, spacing, shape)
    depths = distance_transform_edt(inside).astype(np.float32) * np.float32(spacing)
    near = np.argwhere((np.abs(depths - depth) < _BAND * spacing) & dilate(inside, 1))
    squared, _, _ = igl.point_mesh_squared_distance(origin + spacing * near, vertices, faces)
    exact = np.sqrt(squared) * np.where(inside[tuple(near.T)], 1.0, -1.0)
    depths[tuple(near.T)] = exact
    return extract_iso_surface(depths, depth, origin, spacing)
