"""What a field is along and around segments: sampled, as no closed form of its extremes is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FieldAt = Callable[[Floats], Floats]
"""Gives the field at points (n, 3), (n,)."""

_SAMPLES = 9
_REFINED = 250
_REFINEMENTS = 20
_GOLDEN = (3.0 - 5.0**0.5) / 2.0

_AT_ONCE = 100_000
"""Segments that are sampled at once: points of more would need as much memory as the field."""

_DIRECTIONS = 4


def extremes_along(at: FieldAt, starts: Floats, ends: Floats, sign: int, precisely_at: FieldAt | None = None) -> Floats:
    """Return the greatest (`sign` = 1) or least (-1) s found on each segment `starts`-`ends` (n, 3), (n,).

    Each is sampled at 9 points; the 250 that come out most extreme also between the neighbours of their best
    point, by golden section and `precisely_at` where that is another way to the field than `at`.
    """
    precisely_at = precisely_at or at
    shares = np.linspace(0.0, 1.0, _SAMPLES)
    extremes, places = np.empty(len(starts)), np.empty(len(starts))
    for part in _parts(len(starts)):
        points = starts[part, None] + shares[:, None] * (ends - starts)[part, None]
        samples = sign * at(points.reshape(-1, 3)).reshape(-1, _SAMPLES)
        extremes[part], places[part] = samples.max(axis=1), shares[samples.argmax(axis=1)]
    closest = np.sort(np.argsort(-extremes, kind="stable")[:_REFINED])
    a, step = starts[closest], (ends - starts)[closest]
    extremes[closest] = _refined(lambda t: sign * precisely_at(a + t[:, None] * step), places[closest])
    return sign * extremes


def extremes_around(
    at: FieldAt, starts: Floats, ends: Floats, places: tuple[float, ...], radius: float, sign: int
) -> Floats:
    """Return the greatest (`sign` = 1) or least (-1) s on rings of `radius` about each segment (n, 3), (n,).

    The rings stand at the `places`, shares of the segment, four points each: where a strut or channel is as thick as
    the ring all around, its extreme there is on its own side of the iso-value.
    """
    extremes = np.empty(len(starts))
    for part in _parts(len(starts)):
        steps = (ends - starts)[part]
        axes = np.array([starts[part] + place * steps for place in places])
        points = axes[:, None] + radius * _ring(steps)
        extremes[part] = (sign * at(points.reshape(-1, 3))).reshape(-1, len(steps)).max(axis=0)
    return sign * extremes


def _parts(count: int) -> list[slice]:
    return [slice(first, first + _AT_ONCE) for first in range(0, count, _AT_ONCE)]


def _ring(steps: Floats) -> Floats:
    """Return unit vectors around each of `steps` (n, 3), (4, n, 3)."""
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    axes = np.divide(steps, lengths, out=np.tile([0.0, 0.0, 1.0], (len(steps), 1)), where=lengths > 0.0)
    least = np.eye(3)[np.abs(axes).argmin(axis=1)]
    across = np.cross(axes, least)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS)[:, None, None] / _DIRECTIONS
    return np.asarray(np.cos(angles) * across + np.sin(angles) * np.cross(axes, across))


def _refined(value_at: Callable[[Floats], Floats], place: Floats) -> Floats:
    """Return the greatest value found about each place, 0..1, the interval narrowed always in its longer part."""
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
