"""Self-intersections of a triangle mesh: triangles that cross, touch or overlap, found exactly.

Two triangles may have in common the vertices that they share and the edge between these, and nothing else.

CGAL's search through libigl finds the same, except duplicate faces, in twice the time and memory
(docs/decisions/libraries.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays, call_in_child

_FINEST = 2.0**-200
"""Share of the greatest coordinate below which one is set to 0, so that products of the others are exact."""


def self_intersecting_faces(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Bools:
    """Return which faces (m, 3) meet another beyond the vertices and edge that they share, (m,).

    `vertices` (n, 3) are distinct. Faces without area are left out (see `degenerate_faces`); their neighbours overlap
    and are found, as are duplicate faces.
    """
    if len(faces) < 2:  # it takes two
        return np.zeros(len(faces), np.bool_)
    from scaffold_geometry.surfaces.triangle_pairs import meeting_faces

    return meeting_faces(_scale(vertices), np.ascontiguousarray(faces, np.int64))


def degenerate_faces(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Bools:
    """Return which faces (m, 3) have their corners on one line, (m,)."""
    from scaffold_geometry.surfaces.triangle_pairs import collinear_faces

    return collinear_faces(_scale(vertices), np.ascontiguousarray(faces, np.int64))


def require_no_self_intersections(vertices: Floats, faces: Ints, subject: str, remedy: str, about: str) -> None:
    """Require that a surface does not intersect or overlap itself, by a search in a child process.

    Raises `StageError`: "`subject` intersects itself", with a place and the `remedy`, or `about` if the search fails.
    """
    crossing = call_in_child(
        find_self_intersections,
        {"vertices": vertices, "faces": faces},
        {},
        seconds=60.0 + len(faces) / 5_000,  # exact arithmetic; millions of sound triangles take seconds
        about=about,
    )["faces"]
    if len(crossing):
        at = vertices[faces[crossing[0]]].mean(axis=0)
        raise StageError(
            f"{subject} intersects itself: {len(crossing)} triangles intersect others "
            f"(one at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm); {remedy}"
        )


def find_self_intersections(vertices: Floats, faces: Ints) -> Arrays:
    """Return the indices `faces` (k,) of the `self_intersecting_faces`; for a child process, as this can take long."""
    return {"faces": np.flatnonzero(self_intersecting_faces(vertices, faces))}


def _scale(vertices: NDArray[np.floating]) -> Floats:
    """Return the vertices divided by a power of two, so that coordinates are at most 1."""
    points = np.asarray(vertices, np.float64)
    scaled = np.ldexp(points, -int(np.frexp(np.abs(points).max(initial=0.0))[1]))
    return np.ascontiguousarray(np.where(np.abs(scaled) < _FINEST, 0.0, scaled))
