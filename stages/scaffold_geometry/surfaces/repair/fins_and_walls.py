"""Remove parts of a surface that bound no solid: fins attached by an edge, and internal walls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import MANIFOLD, Edges, Surface, edges_of, patches_of
from scaffold_geometry.surfaces.repair.log import OpCounts, RepairOp

_INSIDE = 0.5
"""Winding number halfway between outside and inside."""

_LOOKED_AT = 50
"""Faces of a patch at which the winding number is evaluated."""

_FIN = RepairOp("fin_triangles_dropped", "dropped {} triangles of fins attached to the surface by an edge")
_WALL = RepairOp("wall_triangles_dropped", "dropped {} triangles of internal walls")


class _Patch(NamedTuple):
    """A part of the surface between edges of more than two faces: its area, whether it is open, and its edges."""

    number: int
    area: float
    is_open: bool
    rim: Ints


def remove_fins_and_internal_walls(vertices: Floats, faces: Ints, done: OpCounts) -> Surface:
    """Return the surface without fins and internal walls, unless an edge would have an odd number of faces."""
    while True:
        edges = edges_of(faces)
        if (edges.uses <= MANIFOLD).all():
            break
        labels = patches_of(faces, edges)
        gone = _superfluous(vertices, faces, edges, labels, done)
        if not gone.any():
            break
        faces = faces[~gone]
    return triangles.drop_unreferenced(vertices, faces)


def _superfluous(vertices: Floats, faces: Ints, edges: Edges, labels: Ints, done: OpCounts) -> Bools:
    """Return which faces are in a fin or wall, (m,): smallest first, at most one fin or wall at each edge."""
    gone, taken = np.zeros(len(faces), bool), np.zeros(len(edges.uses), bool)
    for patch in sorted(_candidates(vertices, faces, edges, labels), key=lambda patch: (patch.area, patch.number)):
        is_of_patch = labels == patch.number
        if taken[patch.rim].any() or not (patch.is_open or _is_within(vertices, faces, is_of_patch)):
            continue
        taken[patch.rim] = True
        gone |= is_of_patch
        done[_FIN if patch.is_open else _WALL] += int(is_of_patch.sum())
    return gone


def _candidates(vertices: Floats, faces: Ints, edges: Edges, labels: Ints) -> list[_Patch]:
    """Return the patches whose removal would give each of their edges an even number of faces."""
    owner = np.repeat(labels, 3)
    crowded = edges.uses[edges.of] > MANIFOLD
    rims, shares = np.unique(np.column_stack([owner, edges.of])[crowded], axis=0, return_counts=True)
    is_good = (edges.uses[rims[:, 1]] % 2 == 1) & (shares % 2 == 1)
    spoilt = np.zeros(int(labels.max(initial=-1)) + 1, bool)
    spoilt[rims[~is_good, 0]] = True
    is_open = np.zeros_like(spoilt)
    is_open[owner[edges.uses[edges.of] == 1]] = True
    areas = np.bincount(labels, weights=triangles.face_areas(vertices, faces))
    return [
        _Patch(int(number), float(areas[number]), bool(is_open[number]), rims[rims[:, 0] == number, 1])
        for number in np.unique(rims[:, 0])
        if not spoilt[number]
    ]


def _is_within(vertices: Floats, faces: Ints, is_of_patch: Bools) -> bool:
    """Return whether the rest of the surface encloses the patch."""
    import igl

    others = np.ascontiguousarray(faces[~is_of_patch])
    if not len(others):
        return False
    own = faces[is_of_patch]
    points = vertices[own[:: -(-len(own) // _LOOKED_AT)]].mean(axis=1)
    return bool(np.median(np.abs(igl.fast_winding_number(vertices, others, points))) > _INSIDE)
