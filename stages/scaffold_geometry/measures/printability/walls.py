"""What is opposite a point of a solid's surface, and whether that makes a wall.

Along a rim every thickness down to 0 is found, and at a facet a hair wide that stands across the surface, as clipping
leaves them, any: the least of these tells of the samples, not of the solid. So a wall has sides that open at less than
a given angle, that go on for a while, and that do not run out: along no way do they thin to about half as much, or end
close by, while they thicken the opposite way. What is left at the thinnest is a plate, a strut or a waist of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.measures.surface_tree import SurfaceTree
from scaffold_pipeline.artifacts import SurfaceMesh

_INSIDE = 1e-7
"""Share of the greatest coordinate by which a ray starts within the solid: above the rounding of its own face."""

_AHEAD = 0.75
_AS_THICK = 0.25, 3.0
_THINNEST = 2000
"""A wall goes on, to both sides, for at least this much of its thickness, and has such shares of it there. Only of so
many, the thinnest, is that asked: a body as thick as it is wide goes on to no side.
"""

_FALL = 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.3, 16.0
_THINNED, _THINS, _THICKENED, _CLOSE = 0.6, 0.9, 1.1, 4.0
"""How many thicknesses ahead it is looked whether a wall thins, and the shares of its thickness at which it has, does,
or has thickened; an end so many thicknesses off is close. Sides that open at 20 degrees have thinned at the second, at
3 degrees at the last."""

_LEVEL = 1.0 - 1e-4
"""Share of its thickness from which a wall does not thin: rays are of single precision."""

_PARALLEL = 0.01
"""Length of the sum of two sides' normals, radians, up to which they are parallel: half a degree."""

_FIRST, _ENOUGH, _MOST = 500, 100, 5000
"""Of how many, the thinnest, it is asked at first whether they run out, how many that do not are enough, and of how
many that are too thin it is asked."""

_WAYS = 3


@dataclass(frozen=True, eq=False)
class Walls:
    """The walls under some points of the surface, (n, 3): their thickness, (n,) mm, and their middles, (n, 3)."""

    points: Floats
    thickness: Floats
    middles: Floats

    def only(self, chosen: Bools | Ints) -> Walls:
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
    """Sends rays through a solid, whose `tree` finds where they leave it.

    The two sides of a wall open at `angle` degrees at most, and go on for `detail` mm at least to either side. The
    thinnest are told, and of those thinner than `least` mm thousands; among the thicker are rims.
    """

    def __init__(self, surface: SurfaceMesh, tree: SurfaceTree, angle: float, detail: float, least: float) -> None:
        self._tree, self._detail, self._least = tree, detail, least
        self._least_cosine = float(np.cos(np.radians(angle)))
        self._inside = _INSIDE * float(np.abs(surface.bounds).max())

    def walls(self, points: Floats, normals: Floats) -> Walls:
        """Return the walls under points of the surface, (n, 3), with its outward unit normals there, (n, 3)."""
        lengths, beyond = self._tree.ways_out(points - self._inside * normals, -normals)
        is_met = _dots(beyond, -normals) >= self._least_cosine
        thickness = lengths[is_met] + self._inside
        found = Walls(points[is_met], thickness, points[is_met] - thickness[:, None] / 2.0 * normals[is_met])
        return found.only(self._is_wall(found, normals[is_met], beyond[is_met]))

    def _is_wall(self, found: Walls, normals: Floats, beyond: Floats) -> Bools:
        """Return which are walls, (n,): the thinnest are asked first, until enough of them are.

        Sides that are parallel do not run out.
        """
        order = np.argsort(found.thickness, kind="stable")
        is_wall = np.ones(len(order), bool)
        thinnest = order[:_THINNEST]
        is_wall[thinnest] = self._is_lasting(found.only(thinnest), normals[thinnest])
        order = order[is_wall[order]]
        opens = np.linalg.norm(normals + beyond, axis=1) > _PARALLEL
        most = min(_MOST, int(np.searchsorted(found.thickness[order], self._least)))
        first, enough = 0, 0
        while first < len(order) and (enough < _ENOUGH or first < most):
            asked = order[first : first + max(_FIRST, first)]
            first, enough = first + len(asked), enough + len(asked)
            asked = asked[opens[asked]]
            runs_out = self._runs_out(found.only(asked), normals[asked], normals[asked] + beyond[asked])
            is_wall[asked[runs_out]] = False
            enough -= int(runs_out.sum())
        return is_wall

    def _is_lasting(self, walls: Walls, normals: Floats) -> Bools:
        """Return which walls go on along any of some ways, (n,)."""
        ahead = np.maximum(_AHEAD * walls.thickness, self._detail)[:, None]
        goes_on = np.zeros(len(walls.thickness), bool)
        for way in _ways(normals, _WAYS):
            both = [self._thickness_at(walls.middles + step * way, normals) for step in (-ahead, ahead)]
            shares = np.array(both) / walls.thickness
            goes_on |= ((shares >= _AS_THICK[0]) & (shares <= _AS_THICK[1])).all(axis=0)
        return goes_on

    def _runs_out(self, walls: Walls, normals: Floats, closing: Floats) -> Bools:
        """Return which walls, along any of some ways, thin out and do not the opposite way, (n,).

        Or end close by, while they thicken the opposite way: the blunt end of such a wall. The way along which their
        two sides close, (n, 3), is tried first.
        """
        runs_out = np.zeros(len(walls.thickness), bool)
        closing = closing / np.linalg.norm(closing, axis=1, keepdims=True)
        for way in (closing, *_ways(normals, 2 * _WAYS)):
            for along in (way, -way):
                left = np.flatnonzero(~runs_out)
                before = np.zeros(len(left))
                for fall in _FALL:
                    shares = self._shares_at(fall, along, walls, normals, left)
                    has_thinned = (shares <= _THINNED) & (before <= _THINS)
                    found = has_thinned | (np.isinf(shares) & (fall <= _CLOSE))
                    opposite = self._shares_at(-fall, along, walls, normals, left[found])
                    wanted = np.where(has_thinned[found], _LEVEL, _THICKENED)
                    runs_out[left[found]] = (opposite >= wanted) & np.isfinite(opposite)
                    goes_on = (shares > _THINNED) & (shares < _THICKENED)
                    left, before = left[goes_on], shares[goes_on]
        return runs_out

    def _shares_at(self, ahead: float, along: Floats, walls: Walls, normals: Floats, chosen: Ints) -> Floats:
        """Return the thickness so many thicknesses `ahead` of the walls `chosen` (k,), as a share of theirs, (k,).

        Or so many times `detail`, where that is more: a strip beside a rim that is narrower is not looked at.
        """
        step = ahead * np.maximum(walls.thickness[chosen], self._detail)[:, None] * along[chosen]
        return self._thickness_at(walls.middles[chosen] + step, normals[chosen]) / walls.thickness[chosen]

    def _thickness_at(self, places: Floats, across: Floats) -> Floats:
        """Return how thick the solid is at places within it along directions `across`, inf outside, (n,)."""
        there, back = self._tree.ways_out(places, across), self._tree.ways_out(places, -across)
        is_within = (_dots(there[1], across) > 0.0) & (_dots(back[1], -across) > 0.0)
        return np.where(is_within, there[0] + back[0], np.inf)


def _ways(normals: Floats, count: int) -> list[Floats]:
    """Return unit vectors at right angles to each normal, evenly turned about it, `count` times (n, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    return [np.cos(turn) * first + np.sin(turn) * second for turn in np.pi / count * np.arange(count)]


def _dots(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b))
