"""Segments, points on them, and the walls of a surface that they pass: which of the points lie within."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints


class Axes:
    """Segments `starts`-`ends` (n, 3) mm, with points on each that are `spacing` mm apart at most, both ends included.

    `points` (p, 3) lie axis after axis, `shares` (p,) of the way along those of `owners` (p,); `directions` (n, 3) are
    of unit length.
    """

    def __init__(self, starts: Floats, ends: Floats, spacing: float) -> None:
        self.starts, self.ways, self.spacing = starts, ends - starts, spacing
        lengths = np.linalg.norm(self.ways, axis=1)
        self.directions = self.ways / np.maximum(lengths, np.finfo(float).tiny)[:, None]
        steps = np.maximum(np.ceil(lengths / spacing).astype(np.int64), 1)
        self._firsts = np.concatenate([[0], np.cumsum(steps + 1)])[:-1]
        self.owners: Ints = np.repeat(np.arange(len(starts)), steps + 1)
        self.shares: Floats = (np.arange(len(self.owners)) - self._firsts[self.owners]) / steps[self.owners]
        self.points: Floats = self.at(self.owners, self.shares)

    def at(self, axes: Ints, shares: Floats) -> Floats:
        """Return the points at `shares` (k,) of the way along `axes` (k,), (k, 3)."""
        return np.asarray(self.starts[axes] + shares[:, None] * self.ways[axes])

    def any(self, at_points: Bools) -> Bools:
        """Return for which axes it holds at a point, (n,), of what is said of all points, (p,)."""
        return np.logical_or.reduceat(at_points, self._firsts)

    def at_points(self, of_axes: Bools) -> Bools:
        """Return at all points, (p,), what is said of their axes, (n,)."""
        return of_axes[self.owners]


class Crossings:
    """Where the rays along some axes pass through a surface: `axes` (k,) in order, `shares` (k,) of the way, rising.

    Shares above 1 lie beyond the axis: they tell on which side it ends. `points` (k, 3), mm.
    """

    def __init__(self, axes: Axes, owners: Ints, shares: Floats, leaves: Bools) -> None:
        order = np.lexsort((shares, owners))
        self.axes, self.shares, self._leaves = owners[order], shares[order], leaves[order]
        self.points = axes.at(self.axes, self.shares)

    def is_solid(self, axes: Axes) -> Bools:
        """Return which points of the axes lie within the surface, (p,): the next wall ahead is one that leaves it."""
        ahead = np.searchsorted(_keys(self.axes, self.shares), _keys(axes.owners, axes.shares), side="right")
        known = np.append(self.axes, -1)[ahead] == axes.owners
        return np.asarray(known & np.append(self._leaves, False)[ahead])


def _keys(axes: Ints, shares: Floats) -> Floats:
    """Return numbers that rise with the axis, and with the share of the way along it."""
    return np.asarray(axes + shares / (1.0 + shares))
