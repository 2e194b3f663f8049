"""Round a closed mesh to float32 without folds, touching parts or holes.

All coordinates become multiples of one step, the distance of neighbouring float32 numbers at the greatest coordinate.
Near zero float32 is finer, but some readers merge vertices that are 1e-8 mm apart. Rounding can invert triangles
flatter than the step and merge vertices closer than it. Edges shorter than the step are collapsed; vertices of
remaining folds are moved towards the mean of their neighbours, one step further in each round, until no fold is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces.booleans import from_manifold, simplify_manifold, to_manifold
from scaffold_geometry.surfaces.merge_corners import to_single
from scaffold_geometry.surfaces.self_intersections import degenerate_faces, self_intersecting_faces
from scaffold_geometry.surfaces.triangles import duplicate_vertex_faces
from scaffold_pipeline.errors import StageError

_ROUNDS = 12
"""Scaffolds of 700,000 triangles need 2 rounds at 1 m from the origin, 4 at 20 m."""


_FINEST_STEP = 2.0**-26
"""The least step, mm, 1.5e-8, for very small shapes."""


class Rounded(NamedTuple):
    """A mesh of float32 coordinates, (n, 3) and (m, 3), and the greatest change of a coordinate, mm."""

    vertices: Floats
    faces: Ints
    moved: float


def snap_to_float32(vertices: Floats, faces: Ints, about: str) -> Rounded:
    """Return the closed mesh with coordinates exact in float32, without self-contact.

    Raises `StageError` with the name `about` if there is no such mesh.
    """
    step = max(float(np.spacing(np.float32(np.abs(vertices).max()))), _FINEST_STEP)
    rounded = _in_steps(vertices, step)
    if not _find_folded_vertices(rounded, faces).any():
        return Rounded(rounded, faces, float(np.abs(rounded - vertices).max()))
    vertices, faces = from_manifold(simplify_manifold(to_manifold(vertices, faces, about), step))
    places, reach = vertices.copy(), np.zeros(len(vertices))
    neighbours = _neighbour_weights(faces, len(vertices))
    for _ in range(_ROUNDS if len(faces) else 0):  # all edges may have collapsed
        rounded = _in_steps(places, step)
        folded = np.flatnonzero(_find_folded_vertices(rounded, faces))
        if not len(folded):
            to_manifold(rounded, faces, about)
            return Rounded(rounded, faces, step + float(np.abs(rounded - vertices).max()))
        reach[folded] += step
        way = neighbours[folded] @ places - places[folded]
        length = np.linalg.norm(way, axis=1)
        places[folded] += way * np.minimum(0.5, reach[folded] / np.maximum(length, step))[:, None]
    raise StageError(
        f"{about}: has details finer than float32 can represent so far from the origin, {step:.2g} mm, and its "
        "surface folds when rounded to it; move the shape nearer to the origin, "
        "or repair the outer shape by load_surface if it crosses itself"
    )


def _in_steps(places: Floats, step: float) -> Floats:
    return to_single(np.round(places / step) * step).astype(np.float64)


def _find_folded_vertices(vertices: Floats, faces: Ints) -> Bools:
    """Return which vertices coincide with another, or belong to a self-intersecting or flat triangle."""
    order = np.lexsort(vertices.T)
    is_new = np.concatenate([[True], (vertices[order[1:]] != vertices[order[:-1]]).any(axis=1)])
    place = np.empty(len(vertices), np.int64)
    place[order] = np.cumsum(is_new) - 1
    distinct, merged = vertices[order[is_new]], place[faces]
    bad = duplicate_vertex_faces(merged)
    bad[~bad] = self_intersecting_faces(distinct, merged[~bad])
    bad |= degenerate_faces(distinct, merged)
    folded: Bools = np.bincount(place)[place] > 1
    folded[faces[bad]] = True
    return folded


def _neighbour_weights(faces: Ints, count: int):  # type: ignore[no-untyped-def]  # noqa: ANN202 - scipy ships no types
    """Return the sparse matrix that maps vertices to the means of their neighbours."""
    from scipy.sparse import coo_array, diags_array

    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_array((np.ones(len(tails)), (tails, heads)), shape=(count, count)).tocsr()
    return diags_array(1.0 / np.maximum(links.sum(axis=1), 1.0)) @ links
