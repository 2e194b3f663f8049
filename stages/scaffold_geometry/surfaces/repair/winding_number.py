"""The inside of arbitrary triangles, by their generalised winding number on a grid.

A. Jacobson, L. Kavan, O. Sorkine, "Robust inside-outside segmentation using generalized winding numbers", ACM
Transactions on Graphics 32 (2013); its fast form, by which fTetWild filters its cells: G. Barill and others, 37 (2018).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.repair.exact_union import without_slivers
from scaffold_geometry.surfaces.self_intersections import find_self_intersections
from scaffold_geometry.voxels.grids import dilate, grid_over
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays

_COARSE = 4
"""Samples of the fine grid per sample of the coarse grid, which finds the regions to refine."""

_SLOPE = 4.0
"""Distance, spacings, for a change of the winding number by 1 where no triangle is near: over holes."""

_SURE = 0.4
"""Least difference from 0.5 of the winding number around a sample without a near triangle, to skip refinement."""

_SIMPLER = 0.05
"""Tolerance of simplification, as a share of the spacing."""

_PULLS = 6
"""Rounds of projecting vertices onto triangles; each leaves out those whose faces would cross."""


def winding_number_isosurface(vertices: Floats, faces: Ints, spacing: float) -> Arrays:
    """Return `vertices` and `faces` of the boundary of {winding number > 0.5}; for a child process.

    The surface is closed and manifold. Vertices within a spacing of a triangle are projected onto it.
    """
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    origin, shape = grid_over(bounds, spacing, _COARSE)
    samples = _samples(vertices, faces, origin, spacing, shape)
    points, corners = extract_iso_surface(samples, 0.0, origin, spacing)
    if not len(corners):
        raise StageError("its triangles enclose nothing")
    points = _project_to_surface(points, corners, vertices, faces, spacing)
    points, corners = without_slivers(points, corners, _SIMPLER * spacing)
    return {"vertices": points, "faces": corners}


def _samples(
    vertices: Floats, faces: Ints, origin: Floats, spacing: float, shape: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Return a smooth function on the grid, mm, positive inside: the signed distance near triangles."""
    from scipy.ndimage import map_coordinates

    coarse_shape = tuple(-(-(count - 1) // _COARSE) + 1 for count in shape)
    places = origin + spacing * _COARSE * np.moveaxis(np.indices(coarse_shape), 0, -1).reshape(-1, 3)
    winding, distance = (found.reshape(coarse_shape) for found in _winding_and_distance(vertices, faces, places))
    reach = 2.0 * _COARSE * spacing
    is_unsure = (np.abs(winding - 0.5) < _SURE) | (distance < reach)
    is_close = np.kron(dilate(is_unsure, 1), np.ones((_COARSE,) * 3, bool))[tuple(slice(count) for count in shape)]
    samples = np.empty(shape, np.float32)
    for layer in range(shape[0]):
        grid = np.stack(np.meshgrid([layer], np.arange(shape[1]), np.arange(shape[2]), indexing="ij")) / _COARSE
        rough = map_coordinates(winding, grid, order=1, mode="nearest")[0]
        samples[layer] = _SLOPE * spacing * (rough - 0.5)
    near = np.argwhere(is_close)
    for some in np.array_split(near, -(-len(near) // 1_000_000) or 1):
        winding, distance = _winding_and_distance(vertices, faces, origin + spacing * some)
        height = np.minimum(distance, _SLOPE * spacing * np.abs(winding - 0.5))
        samples[tuple(some.T)] = np.where(winding > 0.5, height, -height)  # halfway inside
    return samples


def _winding_and_distance(vertices: Floats, faces: Ints, places: Floats) -> tuple[Floats, Floats]:
    """Return the winding number at points (k, 3), and the distance to the nearest triangle."""
    import igl

    squared, _, _ = igl.point_mesh_squared_distance(places, vertices, faces)
    return np.asarray(igl.fast_winding_number(vertices, faces, places)), np.sqrt(squared)


def _project_to_surface(points: Floats, corners: Ints, vertices: Floats, faces: Ints, spacing: float) -> Floats:
    """Return points projected onto the nearest triangle within a spacing, except those that would make faces cross."""
    import igl

    squared, _, nearest = igl.point_mesh_squared_distance(points, vertices, faces)
    is_pulled: Bools = squared <= spacing**2
    for _ in range(_PULLS):
        moved = np.where(is_pulled[:, None], nearest, points)
        bad = triangles.flat_faces(moved, corners)
        bad[find_self_intersections(moved, corners)["faces"]] = True
        if not bad.any():
            return moved
        is_bad = np.zeros(len(points), bool)
        is_bad[corners[bad]] = True
        is_bad[corners[is_bad[corners].any(axis=1)]] = True
        is_pulled &= ~is_bad
    return points
