"""A closed surface with a tree of boxes: how far it is, and which triangles a ray meets."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.measures.axes import Axes, Crossings

_ASIDE = 1e-4
_NO_AXIS = np.array([0.5377, 0.3191, 0.7804])
"""A direction that no edge of a symmetric shape has."""


class SurfaceTree:
    """A closed surface, `vertices` (n, 3) mm and `faces` (m, 3), with a tree of boxes to find its triangles by."""

    def __init__(self, vertices: Floats, faces: Ints) -> None:
        self._mesh = vertices, faces

    @cached_property
    def _tree(self) -> Any:  # noqa: ANN401 - igl has no types
        import igl

        tree = igl.AABB()
        tree.init(*self._mesh)
        return tree

    def distances(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the distance of `points` (p, 3) from the surface, (p,), and where it is nearest, (p, 3)."""
        if not len(points):
            return np.empty(0), np.empty((0, 3))
        squared, _, nearest = self._tree.squared_distance(*self._mesh, np.ascontiguousarray(points))
        return np.sqrt(squared), np.asarray(nearest)

    def signed_distances(self, points: Floats) -> Floats:
        """Return the distance of `points` (p, 3), negative within, (p,).

        The sign is that of the angle-weighted normal where the surface is nearest: Baerentzen, Aanaes (2005). On
        triangles without area it fails, as a solid has, an outer shape has not.
        """
        import igl

        if not len(points):
            return np.empty(0)
        kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        return np.asarray(igl.signed_distance(np.ascontiguousarray(points), *self._mesh, kind)[0])

    def crossings(self, axes: Axes) -> Crossings:
        """Return where the rays from the starts of the axes through their ends pass through the surface.

        They are moved aside by a `_ASIDE` of the spacing of the points, as a ray through an edge can miss both faces.
        """
        vertices, faces = self._mesh
        starts = axes.starts + _ASIDE * axes.spacing * _NO_AXIS
        found = self._tree.intersect_ray(vertices, faces, starts, axes.ways.copy())
        owners: Ints = np.repeat(np.arange(len(found)), [len(hits) for hits in found])
        hits = np.array([hit[:2] for hits in found for hit in hits], float).reshape(-1, 2)
        normals = unit_normals(vertices[faces[hits[:, 0].astype(np.int64)]])
        return Crossings(axes, owners, hits[:, 1], np.einsum("ij,ij->i", normals, axes.ways[owners]) > 0.0)

    def ways_out(self, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Return how far it is from within the surface to its next wall, (p,), and the unit normal there, (p, 3).

        `starts` and unit `directions` are (p, 3). Where there is none, the normal is zero; where the start is not
        within, it is turned against the direction.
        """
        vertices, faces = self._mesh
        left, lengths, _ = self._tree.intersect_ray_first(vertices, faces, starts, directions)
        normals = unit_normals(vertices[faces[np.maximum(left, 0)]])
        return lengths, np.where(left[:, None] >= 0, normals, 0.0)


def unit_normals(corners: Floats) -> Floats:
    """Return the unit normals of triangles (n, 3, 3), zero where one has no area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0))
