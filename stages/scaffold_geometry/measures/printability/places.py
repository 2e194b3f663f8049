"""Few places that stand for many: the worst first, each for all that is near it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats
from scaffold_geometry.measures.declarations import to_place
from scaffold_pipeline.artifacts import SurfaceMesh

_REGIONS = 50
"""Places are at least this share of the solid's diagonal apart: less is one spot on a page."""


def apart_in(surface: SurfaceMesh) -> float:
    """Return how far two places of a surface must be from each other to be two, mm."""
    return float(np.linalg.norm(np.ptp(surface.bounds, axis=0))) / _REGIONS


def worst_apart(points: Floats, badness: Floats, apart: float, most: int) -> NDArray[np.int64]:
    """Return which of `points` (n, 3) to name: the worst of all, then the worst `apart` from those named, `most`.

    `badness` (n,) is greater where it is worse; of equals the first counts.
    """
    left = np.argsort(-badness, kind="stable")
    named: list[int] = []
    while len(left) and len(named) < most:
        worst = int(left[0])
        named.append(worst)
        distances = np.linalg.norm(points[left] - points[worst], axis=1)
        left = left[distances > apart]
    return np.array(named, np.int64)


def format_place(place: Floats) -> str:
    """Return a place (3,), mm, as a message has it."""
    return f"({to_place(place)})"
