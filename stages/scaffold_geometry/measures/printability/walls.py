"""What is opposite a point of a solid's surface, and whether that makes a wall.

Along a rim every thickness down to 0 is found, and at a facet a hair wide that stands across the surface, as clipping
leaves them, any: the least of these tells of the samples, not of the solid. So a wall has sides that open at less than
a given angle, that do not run out, just as they open, into a sharp rim close by, and that go on for a while.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_pipeline.artifacts import SurfaceMesh

_INSIDE = 1e-7
"""Share of the greatest coordinate by which a ray starts within the solid: above the rounding of its own face."""

_CLOSE = 4.0
_NEAR = 12.0
_AS_TOLD = 0.4, 2.5
"""Two sides end in a rim that is nearer than `_CLOSE` times their thickness, or nearer than `_NEAR` times, where sides
meet that open at 5 degrees, and as far off as their opening tells, within these shares: of hollow sides it tells half,
of bulging ones twice as much."""

_AHEAD = 0.75
_AS_THICK = 0.25, 3.0
_THINNEST = 2000
"""A wall goes on, to both sides, for at least this much of its thickness, and has such shares of it there. Only of so
many, the thinnest, is that asked: they decide which is the thinnest, and to ask it of all would take ten times as long.
"""

_WAYS = 3


@dataclass(frozen=True, eq=False)
class Walls:
    """The walls under some points of the surface, (n, 3): their thickness, (n,) mm, and their middles, (n, 3)."""

    points: Floats
    thickness: Floats
    middles: Floats

    def only(self, chosen: Bools) -> Walls:
        """Return the walls chosen, (n,)."""
        return Walls(self.points[chosen], self.thickness[chosen], self.middles[chosen])

    def and_these(self, others: Walls) -> Walls:
        """Return these walls, and others after them."""
        return Walls(
            np.concatenate([self.points, others.points]),
            np.concatenate([self.thickness, others.thickness]),
            np.concatenate([self.middles, others.middles]),
        )


class WallFinder:
    """Sends rays through a solid; igl finds by a tree of boxes where they leave it.

    `rims` (k, 2) are the sharp edges of its closed surface; the two sides of a wall open at `angle` degrees at most,
    and go on for `detail` mm at least to either side.
    """

    def __init__(self, surface: SurfaceMesh, rims: Ints, angle: float, detail: float) -> None:
        import igl

        self._mesh = surface.vertices, surface.faces
        self._rims, self._detail = rims, detail
        self._least_cosine = float(np.cos(np.radians(angle)))
        self._inside = _INSIDE * float(np.abs(surface.bounds).max())
        self._tree: Any = igl.AABB()
        self._tree.init(*self._mesh)

    def walls(self, points: Floats, normals: Floats) -> Walls:
        """Return the walls under points of the surface, (n, 3), with its outward unit normals there, (n, 3)."""
        lengths, cosines = self._way_out(points - self._inside * normals, -normals)
        is_met = cosines >= self._least_cosine
        thickness = lengths[is_met] + self._inside
        found = Walls(points[is_met], thickness, points[is_met] - thickness[:, None] / 2.0 * normals[is_met])
        is_wall = ~self._runs_out(found, cosines[is_met])
        return self._lasting(found.only(is_wall), normals[is_met][is_wall])

    def _way_out(self, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Return how far it is from within the solid to its surface, and the cosine there with its normal, (n,) both.

        The cosine is negative where the start is not within.
        """
        vertices, faces = self._mesh
        left, lengths, _ = self._tree.intersect_ray_first(vertices, faces, starts, directions)
        normals = unit_normals(vertices[faces[np.maximum(left, 0)]])
        return lengths, np.where(left >= 0, np.einsum("ij,ij->i", normals, directions), -1.0)

    def _runs_out(self, walls: Walls, cosines: Floats) -> Bools:
        """Return where two sides that open by so much run out into a rim, (n,)."""
        import igl

        if not (len(self._rims) and len(cosines)):
            return np.zeros(len(cosines), bool)
        squared, _, _ = igl.point_mesh_squared_distance(walls.middles, self._mesh[0], self._rims)
        off = np.sqrt(squared) / walls.thickness
        told = off * np.tan(np.arccos(np.minimum(cosines, 1.0)))
        is_as_told = (told >= _AS_TOLD[0]) & (told <= _AS_TOLD[1])
        return np.asarray((off < _CLOSE) | ((off < _NEAR) & is_as_told))

    def _lasting(self, walls: Walls, normals: Floats) -> Walls:
        """Return the walls without those, of the thinnest, that do not go on along any of some ways."""
        asked = np.argsort(walls.thickness, kind="stable")[:_THINNEST]
        thickness, middles, across = walls.thickness[asked], walls.middles[asked], normals[asked]
        ahead = np.maximum(_AHEAD * thickness, self._detail)[:, None]
        goes_on = np.zeros(len(asked), bool)
        for way in _ways(across):
            both = [self._thickness_at(middles + step * way, across) for step in (-ahead, ahead)]
            shares = np.array(both) / thickness
            goes_on |= ((shares >= _AS_THICK[0]) & (shares <= _AS_THICK[1])).all(axis=0)
        is_wall = np.ones(len(walls.thickness), bool)
        is_wall[asked] = goes_on
        return walls.only(is_wall)

    def _thickness_at(self, places: Floats, across: Floats) -> Floats:
        """Return how thick the solid is at places within it along directions `across`, inf outside, (n,)."""
        there, back = self._way_out(places, across), self._way_out(places, -across)
        return np.where((there[1] > 0.0) & (back[1] > 0.0), there[0] + back[0], np.inf)


def _ways(normals: Floats) -> list[Floats]:
    """Return unit vectors at right angles to each normal, evenly turned about it, `_WAYS` times (n, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    return [np.cos(turn) * first + np.sin(turn) * second for turn in np.pi / _WAYS * np.arange(_WAYS)]


def unit_normals(corners: Floats) -> Floats:
    """Return the unit normals of triangles (n, 3, 3), zero where one has no area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0))
