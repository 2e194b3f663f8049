"""Where a body is narrowest between two thicker parts of itself.

The voxels are taken from the deepest to the shallowest, and each joins the part that it touches: the watershed of the
distance, L. Vincent and P. Soille, IEEE Trans. Pattern Anal. 13 (1991). A part that is hardly thicker than where it
meets a thicker one is no part, but roughness: the persistence of H. Edelsbrunner, D. Letscher, A. Zomorodian,
"Topological persistence and simplification", Discrete Comput. Geom. 28 (2002). Where two parts first meet is their
neck, if they hang together nowhere else about it.
"""

from __future__ import annotations

import math

import numpy as np

from scaffold_geometry.arrays import Indices, Ints, Singles
from scaffold_geometry.jit import kernel

_RISE, _FACTOR = 1.0, 1.1
"""A part's greatest ball exceeds the neck's in radius by a voxel and by a tenth: what lies below is roughness."""

_BEYOND = 2
"""Voxels around the neck's own ball within which the two parts must not hang together otherwise."""

_PAIRS = 1 << 20
"""Places for the pairs of parts that have met; half of them are used."""


@kernel
def deepest_first(squared: Singles, top: int) -> Indices:
    """Return the flat indices of the voxels of `squared` (nx, ny, nz) above 0, whole numbers up to `top`, falling."""
    starts = np.zeros(top + 2, np.int64)
    flat = squared.reshape(-1)
    for depth in flat:
        starts[int(depth)] += 1
    total = len(flat) - starts[0]
    order = np.empty(total, np.int32)
    for level in range(1, top + 1):
        total -= starts[level]
        starts[level] = total
    for voxel in range(len(flat)):
        level = int(flat[voxel])
        if level > 0:
            order[starts[level]] = voxel
            starts[level] += 1
    return order


@kernel
def find_necks(squared: Singles, order: Indices, least: float) -> Ints:
    """Return the flat indices of the necks between parts whose greatest ball has a squared radius of `least` or more.

    `squared` (nx, ny, nz) is the squared depth of each voxel in the body, 0 outside; `order` comes from
    `deepest_first`.
    """
    nx, ny, nz = squared.shape
    labels = np.zeros(squared.shape, np.int32)
    most = min(len(order), (nx + 1) // 2 * ((ny + 1) // 2) * ((nz + 1) // 2)) + 1
    parents, peaks = np.zeros(most, np.int32), np.zeros(most, np.float32)
    pairs, met = np.full(_PAIRS, -1, np.int64), 0
    found, parts = np.empty(26, np.int32), 0
    necks, count = np.empty(_PAIRS, np.int64), 0
    for voxel in order:
        k, j, i = voxel % nz, voxel // nz % ny, voxel // nz // ny
        depth = squared[i, j, k]
        touched, uphill = _parts_beside(squared, labels, parents, (i, j, k), found)
        if touched == 0:
            parts += 1
            parents[parts], peaks[parts], labels[i, j, k] = parts, depth, parts
            continue
        touched = _keep_bodies(found, touched, parents, peaks, depth, least)
        labels[i, j, k] = uphill
        for one in range(touched):
            for other in range(one):
                if met < _PAIRS // 2 and _is_new(pairs, found[one], found[other]):
                    met += 1
                    if _is_cut(labels, parents, (i, j, k), depth, found[one], found[other]):
                        necks[count] = voxel
                        count += 1
    return necks[:count].copy()


@kernel
def _root(parents: Indices, part: int) -> int:
    while parents[part] != part:
        parents[part] = parents[parents[part]]
        part = parents[part]
    return part


@kernel
def _parts_beside(
    squared: Singles, labels: Indices, parents: Indices, at: tuple[int, int, int], found: Indices
) -> tuple[int, int]:
    """Write into `found` the parts that a voxel touches, across faces alone at a depth of 1.

    Return how many these are, and that of the deepest voxel touched: its own, or the shells of parts would spread over
    others.
    """
    nx, ny, nz = labels.shape
    depth = squared[at[0], at[1], at[2]]
    count, deepest, uphill = 0, np.float32(0.0), 0
    for a in range(max(at[0] - 1, 0), min(at[0] + 2, nx)):
        for b in range(max(at[1] - 1, 0), min(at[1] + 2, ny)):
            for c in range(max(at[2] - 1, 0), min(at[2] + 2, nz)):
                if labels[a, b, c] == 0:
                    continue
                if depth < 2.0 and abs(a - at[0]) + abs(b - at[1]) + abs(c - at[2]) > 1:
                    continue
                part = _root(parents, labels[a, b, c])
                if squared[a, b, c] > deepest:
                    deepest, uphill = squared[a, b, c], part
                is_known = False
                for place in range(count):
                    is_known = is_known or found[place] == part
                if not is_known:
                    found[count] = part
                    count += 1
    return count, uphill


@kernel
def _keep_bodies(found: Indices, count: int, parents: Indices, peaks: Singles, depth: float, least: float) -> int:
    """Unite all parts in `found` that are no body with the thickest, put that first, and return how many are left."""
    thickest = 0
    for place in range(1, count):
        if peaks[found[place]] > peaks[found[thickest]]:
            thickest = place
    found[0], found[thickest] = found[thickest], found[0]
    radius = math.sqrt(depth)
    needed = max(max(radius + _RISE, radius * _FACTOR) ** 2, least)
    kept = 1
    for place in range(1, count):
        part = found[place]
        if peaks[part] < needed:
            parents[part] = found[0]
        else:
            found[kept] = part
            kept += 1
    return kept


@kernel
def _is_new(pairs: Ints, one: int, other: int) -> bool:
    """Tell whether two parts have not met, and note that they have."""
    key = np.int64(max(one, other)) * np.int64(1 << 31) + np.int64(min(one, other))
    place = (key ^ (key >> 29)) & np.int64(_PAIRS - 1)
    while pairs[place] != -1:
        if pairs[place] == key:
            return False
        place = (place + 1) & np.int64(_PAIRS - 1)
    pairs[place] = key
    return True


@kernel
def _is_cut(labels: Indices, parents: Indices, at: tuple[int, int, int], depth: float, one: int, other: int) -> bool:
    """Tell whether two parts hang together, in the surroundings of a voxel, by that voxel alone."""
    half = int(math.sqrt(depth)) + _BEYOND
    side = 2 * half + 1
    seen = np.zeros((side, side, side), np.bool_)
    seen[half, half, half] = True
    stack = np.empty((side**3, 3), np.int32)
    top = 0
    for turn in range(27):
        a, b, c = half - 1 + turn // 9, half - 1 + turn // 3 % 3, half - 1 + turn % 3
        if _part_at(labels, parents, at, half, (a, b, c)) == one and not seen[a, b, c]:
            seen[a, b, c] = True
            stack[top, 0], stack[top, 1], stack[top, 2] = a, b, c
            top += 1
    while top > 0:
        top -= 1
        i, j, k = stack[top, 0], stack[top, 1], stack[top, 2]
        if _part_at(labels, parents, at, half, (i, j, k)) == other:
            return False
        for a in range(max(i - 1, 0), min(i + 2, side)):
            for b in range(max(j - 1, 0), min(j + 2, side)):
                for c in range(max(k - 1, 0), min(k + 2, side)):
                    if not seen[a, b, c] and _part_at(labels, parents, at, half, (a, b, c)) > 0:
                        seen[a, b, c] = True
                        stack[top, 0], stack[top, 1], stack[top, 2] = a, b, c
                        top += 1
    return True


@kernel
def _part_at(
    labels: Indices, parents: Indices, at: tuple[int, int, int], half: int, place: tuple[int, int, int]
) -> int:
    """Return the part at a place of the surroundings, 0 for none."""
    i, j, k = at[0] + place[0] - half, at[1] + place[1] - half, at[2] + place[2] - half
    if not (0 <= i < labels.shape[0] and 0 <= j < labels.shape[1] and 0 <= k < labels.shape[2]):
        return 0
    label = labels[i, j, k]
    return _root(parents, label) if label > 0 else 0
