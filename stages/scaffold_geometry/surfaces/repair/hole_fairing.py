"""Refine a patch to the density of the mesh around it, and fair it: the second and third step of Liepa (2003)."""

from __future__ import annotations

from typing import Any

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.edges import Surface, edges_of

_ROUNDS = 12
_FLIPS = 30
_CLOSER = 1.4142135623730951
"""Liepa's factor: a triangle is split if its centre is farther from the corners than their mean edge length."""

_MOST = 20_000
"""Most triangles of a refined patch: next to tiny triangles, a wide hole would need millions."""


def refine_patch(vertices: Floats, faces: Ints, patch: Ints) -> Surface:
    """Return vertices and the patch (k, 3), refined to the triangle size of the `faces` at its rim."""
    scale = _edge_lengths(vertices, faces, patch)
    known = {(int(a), int(b)) for a, b in edges_of(faces).ends}
    patch = _flip_to_delaunay(vertices, patch, known)
    for _ in range(_ROUNDS):
        corners = vertices[patch]
        centres, scales = corners.mean(axis=1), scale[patch].mean(axis=1)
        far = _CLOSER * np.linalg.norm(corners - centres[:, None], axis=2)
        is_split = ((far > scales[:, None]) & (far > scale[patch])).all(axis=1)
        if not is_split.any() or len(patch) > _MOST:
            break
        hub = len(vertices) + np.arange(int(is_split.sum()))
        a, b, c = patch[is_split].T
        thirds = [np.column_stack(three) for three in ((a, b, hub), (b, c, hub), (c, a, hub))]
        vertices = np.concatenate([vertices, centres[is_split]])
        scale = np.concatenate([scale, scales[is_split]])
        patch = _flip_to_delaunay(vertices, np.concatenate([patch[~is_split], *thirds]), known)
    return vertices, patch


def _edge_lengths(vertices: Floats, faces: Ints, patch: Ints) -> Floats:
    """Return the mean length of the surface's edges at each vertex of the patch, (n,), 0 elsewhere."""
    of_patch = np.zeros(len(vertices), bool)
    of_patch[patch] = True
    ends = edges_of(faces[of_patch[faces].any(axis=1)]).ends
    lengths = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    sums = np.bincount(ends.ravel(), weights=np.repeat(lengths, 2), minlength=len(vertices))
    counts = np.bincount(ends.ravel(), minlength=len(vertices))
    return np.asarray(np.where(of_patch, sums / np.maximum(counts, 1), 0.0))


def _flip_to_delaunay(vertices: Floats, patch: Ints, known: set[tuple[int, int]]) -> Ints:
    """Flip inner edges of the patch whose opposite angles exceed 180 degrees in sum, unless the new edge exists."""
    for _ in range(_FLIPS):
        edges = edges_of(patch)
        order = np.argsort(edges.of, kind="stable")
        starts = (np.cumsum(edges.uses) - edges.uses)[edges.uses == 2]  # inner edges
        one, other = order[starts], order[starts + 1]
        tails, heads = patch.ravel()[one], np.roll(patch, -1, axis=1).ravel()[one]
        apexes = [np.roll(patch, -2, axis=1).ravel()[half_edge] for half_edge in (one, other)]
        angles = _angle(vertices, apexes[0], tails, heads) + _angle(vertices, apexes[1], tails, heads)
        worst = np.flatnonzero(angles > np.pi + 1e-6)
        worst = worst[np.argsort(-angles[worst], kind="stable")]
        present = known | {(int(a), int(b)) for a, b in edges.ends}
        patch, turned = _flip_edges(patch, [(int(one[k]), int(other[k])) for k in worst], present)
        if not turned:
            break
    return patch


def _angle(vertices: Floats, apex: Ints, one: Ints, other: Ints) -> Floats:
    a, b = vertices[one] - vertices[apex], vertices[other] - vertices[apex]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b)))


def _flip_edges(patch: Ints, pairs: list[tuple[int, int]], present: set[tuple[int, int]]) -> tuple[Ints, int]:
    """Flip the edge of each pair of half-edges, unless one of its faces was changed or the new edge exists."""
    patch, done = patch.copy(), 0
    touched: set[int] = set()
    for one, other in pairs:
        f, g = one // 3, other // 3
        tail, head, apex = (int(patch[f, (one + step) % 3]) for step in range(3))
        opposite = int(patch[g, (other + 2) % 3])
        new = (min(apex, opposite), max(apex, opposite))
        if f in touched or g in touched or new in present or apex == opposite:
            continue
        touched |= {f, g}
        present.add(new)
        patch[f], patch[g] = (tail, opposite, apex), (opposite, head, apex)
        done += 1
    return patch, done


def fair_patch(vertices: Floats, faces: Ints, patch: Ints, first: int) -> Floats:
    """Return the vertices, with the new ones, from `first` on, moved for the least bending of patch and `faces`.

    They solve the thin-plate equation, Laplacian of the Laplacian = 0 (cotangent weights), so that the patch continues
    the slope of the surface.
    """
    from scipy.sparse.linalg import spsolve

    inner = np.arange(first, len(vertices))
    if not len(inner):
        return vertices
    used, local = np.unique(np.concatenate([faces, patch]), return_inverse=True)
    laplacian, masses = _laplacian(vertices[used], local.reshape(-1, 3))
    plate = (laplacian @ (laplacian.multiply(1.0 / masses[:, None]).tocsr())).tocsr()
    is_inner = used >= first
    free = plate[is_inner]
    placed = spsolve(free[:, is_inner].tocsc(), -(free[:, ~is_inner] @ vertices[used[~is_inner]]))
    if not np.isfinite(placed).all():
        return vertices
    moved = vertices.copy()
    moved[used[is_inner]] = placed
    return moved


def _laplacian(vertices: Floats, faces: Ints) -> tuple[Any, Floats]:
    """Return the cotangent Laplacian, sparse (n, n), no weight negative, and a third of the area around each vertex."""
    from scipy.sparse import coo_array, diags_array

    count, rows, columns, weights = len(vertices), [], [], []
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    for apex in range(3):
        one, other = (apex + 1) % 3, (apex + 2) % 3
        a, b = corners[:, one] - corners[:, apex], corners[:, other] - corners[:, apex]
        cotangent = np.einsum("ij,ij->i", a, b) / np.maximum(4.0 * areas, np.finfo(float).tiny)
        rows += [faces[:, one], faces[:, other]]
        columns += [faces[:, other], faces[:, one]]
        weights += [cotangent, cotangent]
    entries = np.concatenate(weights)
    matrix = coo_array((entries, (np.concatenate(rows), np.concatenate(columns))), shape=(count, count)).tocsr()
    matrix.data = np.maximum(matrix.data, 1e-6)
    masses = np.bincount(faces.ravel(), weights=np.repeat(areas / 3.0, 3), minlength=count)
    laplacian = matrix - diags_array(np.asarray(matrix.sum(axis=1)).ravel())
    return laplacian.tocsr(), np.maximum(masses, 1e-12 * masses.max())
