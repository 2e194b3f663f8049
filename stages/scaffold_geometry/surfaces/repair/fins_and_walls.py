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

_DOMINANT = 0.5
"""Share of the area of its connected piece above which a patch is the surface itself, and no fin or wall of it."""

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
    strays = _find_strays(vertices, faces, edges, labels, taken)
    done[_FIN] += len(strays)
    gone[strays] = True
    return gone


def _find_strays(vertices: Floats, faces: Ints, edges: Edges, labels: Ints, taken: Bools) -> Ints:
    """Return one face for each edge with an odd number of faces of a single patch, (k,); not at edges `taken`.

    A face that is attached along the rim of a hole too belongs to the patch, and can only be told apart by itself.
    """
    is_odd = (edges.uses > MANIFOLD) & (edges.uses % 2 == 1) & ~taken
    half_edges = np.flatnonzero(is_odd[edges.of])
    half_edges = half_edges[np.argsort(edges.of[half_edges], kind="stable")]
    starts = np.flatnonzero(np.diff(edges.of[half_edges], prepend=-1))
    strays: set[int] = set()
    for around in np.split(half_edges, starts[1:]) if len(starts) else []:
        own = around // 3
        if (labels[own] == labels[own[0]]).all() and not strays & set(own.tolist()):
            strays.add(int(own[_find_loosest(vertices, faces, edges, around)]))
    return np.array(sorted(strays), np.int64)


def _find_loosest(vertices: Floats, faces: Ints, edges: Edges, around: Ints) -> int:
    """Return which of the half-edges of one edge is that of the face with the fewest neighbours, then most aslant."""
    own = around // 3
    free = (edges.uses[edges.of.reshape(-1, 3)[own]] != MANIFOLD).sum(axis=1)
    start, end = vertices[edges.ends[edges.of[around[0]]]]
    axis = (end - start) / np.linalg.norm(end - start)
    arms = vertices[faces[own, (around + 2) % 3]] - start
    arms -= (arms @ axis)[:, None] * axis
    arms /= np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), np.finfo(float).tiny)
    flush = (arms @ arms.T).min(axis=1)  # -1 if another face continues this one
    return int(np.lexsort([flush, free])[-1])


def _candidates(vertices: Floats, faces: Ints, edges: Edges, labels: Ints) -> list[_Patch]:
    """Return the patches whose removal would give each of their edges an even number of faces, no dominant one."""
    owner = np.repeat(labels, 3)
    crowded = edges.uses[edges.of] > MANIFOLD
    rims, shares = np.unique(np.column_stack([owner, edges.of])[crowded], axis=0, return_counts=True)
    is_good = (edges.uses[rims[:, 1]] % 2 == 1) & (shares % 2 == 1)
    spoilt = np.zeros(int(labels.max(initial=-1)) + 1, bool)
    spoilt[rims[~is_good, 0]] = True
    is_open = np.zeros_like(spoilt)
    is_open[owner[edges.uses[edges.of] == 1]] = True
    face_areas, pieces = triangles.face_areas(vertices, faces), triangles.face_pieces(faces)
    areas = np.bincount(labels, weights=face_areas)
    whole = np.zeros_like(areas)
    whole[labels] = np.bincount(pieces, weights=face_areas)[pieces]
    spoilt |= areas > _DOMINANT * whole
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
