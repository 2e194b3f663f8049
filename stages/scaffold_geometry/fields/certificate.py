"""Extremes of a field along and around segments: found by sampling, as no closed form is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.jit import parallel_kernel, prange

FieldAt = Callable[[Floats], Floats]
"""The field as a function of points (n, 3), with values (n,)."""

_SAMPLES = 9
_REFINED = 250
_REFINEMENTS = 20
_GOLDEN = (3.0 - 5.0**0.5) / 2.0

_AT_ONCE = 100_000
"""Segments that are sampled at once: the points of more would need as much memory as the field."""

_DIRECTIONS = 4
_ANGLES = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS


@dataclass(frozen=True)
class Rings:
    """Rings of four points around a segment: at `places`, shares of its length, with `radii`, mm."""

    places: tuple[float, ...]
    radii: tuple[float, ...]


def extremes_of(
    at: FieldAt, starts: Floats, ends: Floats, rings: Rings, sign: int, precisely_at: FieldAt | None = None
) -> tuple[Floats, Floats]:
    """Return the greatest (`sign` = 1) or least (-1) s on each segment `starts`-`ends` (n, 3), and on its rings.

    They are (n,) and, for k radii, (n, k). Each segment is sampled at 9 points. On the 250 most extreme segments a
    golden-section search follows around the best point, with `precisely_at` if given, a more precise form of `at`.
    If a strut or channel is as thick as a ring all around, the extreme on the ring is on its side of the iso-value.
    """
    shares, shape = np.linspace(0.0, 1.0, _SAMPLES), (len(rings.places), len(rings.radii), _DIRECTIONS)
    places, radii, angles = (axis.ravel() for axis in np.meshgrid(rings.places, rings.radii, _ANGLES, indexing="ij"))
    steps, none = ends - starts, np.zeros(_SAMPLES)
    samples = np.concatenate([shares, places]), np.concatenate([none, radii]), np.concatenate([none, angles])
    along, around, best = np.empty(len(starts)), np.empty((len(starts), len(rings.radii))), np.empty(len(starts))
    for first in range(0, len(starts), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        values = sign * at(_points(starts[part], steps[part], *samples)).reshape(-1, len(samples[0]))
        along[part], best[part] = values[:, :_SAMPLES].max(axis=1), shares[values[:, :_SAMPLES].argmax(axis=1)]
        around[part] = values[:, _SAMPLES:].reshape(-1, *shape).max(axis=(1, 3))
    closest = np.sort(np.argsort(-along, kind="stable")[:_REFINED])
    a, step, precisely_at = starts[closest], steps[closest], precisely_at or at
    along[closest] = _refine_maxima(lambda t: sign * precisely_at(a + t[:, None] * step), best[closest])
    return sign * along, sign * around


def _points(starts: Floats, steps: Floats, shares: Floats, radii: Floats, angles: Floats) -> Floats:
    """Return the points (n k, 3) at k places on and around each segment: shares of length, radii and angles (k,)."""
    points = np.empty((len(starts), len(shares), 3))
    _fill_points(starts, steps, shares, radii * np.cos(angles), radii * np.sin(angles), points)
    return points.reshape(-1, 3)


@parallel_kernel
def _fill_points(starts: Floats, steps: Floats, shares: Floats, right: Floats, up: Floats, points: Floats) -> None:
    for n in prange(len(starts)):
        length = np.sqrt((steps[n] * steps[n]).sum())
        d = steps[n] / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        least = np.zeros(3)
        least[np.abs(d).argmin()] = 1.0
        u = np.cross(d, least)
        u /= np.sqrt((u * u).sum())
        v = np.cross(d, u)
        for k in range(len(shares)):
            for axis in range(3):
                points[n, k, axis] = starts[n, axis] + shares[k] * steps[n, axis] + right[k] * u[axis] + up[k] * v[axis]


def _refine_maxima(value_at: Callable[[Floats], Floats], place: Floats) -> Floats:
    """Return the greatest value near each place, 0..1, by golden-section search in the longer part of the interval."""
    reach = 1.0 / (_SAMPLES - 1)
    low, high = np.maximum(place - reach, 0.0), np.minimum(place + reach, 1.0)
    best = value_at(place)
    for _ in range(_REFINEMENTS):
        trial = place + _GOLDEN * np.where(place - low > high - place, low - place, high - place)
        value = value_at(trial)
        is_better, is_left = value > best, trial < place
        new_low = np.where(is_better, np.where(is_left, low, place), np.where(is_left, trial, low))
        high = np.where(is_better, np.where(is_left, place, high), np.where(is_left, high, trial))
        low, best, place = new_low, np.maximum(best, value), np.where(is_better, trial, place)
    return best
