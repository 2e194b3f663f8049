"""Clean a triangle mesh: merge vertices, close cracks, and remove duplicate and flat faces.

No vertex is moved by more than the rounding of the file.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import MANIFOLD, Surface, components, edges_of, open_vertices, rounding
from scaffold_geometry.surfaces.repair.log import DOUBLE, MERGED, TWICE, OpCounts, RepairOp

_ROUNDS = 20
"""Most rounds: splitting a face can make a neighbour flat, and a chain of such faces takes one round each."""

_MOST_OPEN = 200_000
"""Most open vertices tested against open edges: a surface with more is to be rebuilt."""

_WELDED = RepairOp("vertices_welded", "merged {} vertices along cracks within the file's rounding")
_STITCHED = RepairOp("triangles_cut", "split {} triangles at vertices on their open edge")
_COLLAPSED = RepairOp("triangles_without_area_collapsed", "collapsed {} triangles without area")
_FOLDED = RepairOp("folded_triangles_dropped", "dropped {} triangles of walls present in both orientations")


def merge_vertices(vertices: Floats, faces: Ints, done: OpCounts) -> Surface:
    """Return the surface with coincident vertices merged, without degenerate faces and unused vertices."""
    count = len(vertices)
    vertices, faces = triangles.merge_coincident(vertices, faces)
    done[MERGED] += count - len(vertices)
    faces = _without(faces, triangles.duplicate_vertex_faces(faces), TWICE, done)
    return triangles.drop_unreferenced(vertices, faces)


def clean_mesh(vertices: Floats, faces: Ints, done: OpCounts) -> Surface:
    """Return a merged surface without cracks, duplicate faces and flat faces.

    Removing a flat triangle alone would open a crack, so its neighbour over the longest side is split at the opposite
    vertex.
    """
    reach = rounding(vertices)
    for _ in range(_ROUNDS):
        before = sum(done.values())
        faces = _without_doubles(faces, done)
        faces = _weld_boundary(vertices, faces, reach, done)
        faces = _without_flats(vertices, faces, reach, done)
        faces = _stitch_boundary(vertices, faces, reach, done)
        if sum(done.values()) == before:
            break
    faces = _without(faces, triangles.flat_faces(vertices, faces), _COLLAPSED, done)
    return triangles.drop_unreferenced(vertices, faces)


def _without(faces: Ints, bad: Bools, op: RepairOp, done: OpCounts) -> Ints:
    done[op] += int(bad.sum())
    return faces[~bad]


def _without_doubles(faces: Ints, done: OpCounts) -> Ints:
    """Keep one of several faces with the same corners; none if they have both orientations, as internal walls have."""
    if not triangles.duplicate_faces(faces).any():
        return faces
    corners, group = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)
    group = group.ravel()
    ways = np.sign(_determinants(faces)).astype(np.int64)
    net = np.bincount(group, weights=ways, minlength=len(corners)).astype(np.int64)
    copies = np.bincount(group)
    wanted = np.where(net[group] == 0, ways[np.unique(group, return_index=True)[1]][group], np.sign(net[group]))
    # of each group the first face with the orientation of most
    candidates = np.flatnonzero(ways == wanted)
    first = candidates[np.unique(group[candidates], return_index=True)[1]]
    one_each = faces[np.sort(first)]
    is_both_ways = ((net == 0) & (copies > 1))[group[np.sort(first)]]
    is_wall = is_both_ways & ~_closes_something(one_each, is_both_ways)
    done[_FOLDED] += 2 * int(is_wall.sum())
    done[DOUBLE] += len(faces) - len(one_each) - int(is_wall.sum())
    return np.asarray(one_each[~is_wall])


def _determinants(faces: Ints) -> Ints:
    """Return for each face a number with the sign of the permutation of its corners from ascending order."""
    a, b, c = faces.T
    return np.asarray(np.sign(b - a) * np.sign(c - a) * np.sign(c - b))


def _closes_something(faces: Ints, is_asked: Bools) -> Bools:
    """Return which faces of `is_asked` reduce the edges with an odd number of faces, or are isolated, (m,).

    Faces that share an edge are tested together.
    """
    edges = edges_of(faces)
    asked_edges = edges.of.reshape(-1, 3)[is_asked]
    owners = np.repeat(np.arange(len(asked_edges)), 3)
    cluster = components(owners, len(asked_edges) + asked_edges.ravel(), len(asked_edges) + len(edges.uses))
    own_uses = np.bincount(asked_edges.ravel(), minlength=len(edges.uses))
    others = edges.uses - own_uses
    # odd without the cluster less odd with it, over the edges of the cluster
    gain = (others % 2) - (edges.uses % 2)
    used = np.flatnonzero(own_uses)
    label = cluster[len(asked_edges) + used]
    gains = np.bincount(label, weights=gain[used], minlength=cluster.max(initial=0) + 1)
    company = np.bincount(label, weights=others[used], minlength=cluster.max(initial=0) + 1)
    closes = np.zeros(len(faces), bool)
    mine = cluster[: len(asked_edges)]
    closes[is_asked] = (gains[mine] > 0) | (company[mine] == 0)
    return closes


def _weld_boundary(vertices: Floats, faces: Ints, reach: float, done: OpCounts) -> Ints:
    """Merge vertices of open edges within `reach` of each other into the first of them."""
    rim = open_vertices(edges_of(faces))
    if len(rim) < MANIFOLD:
        return faces
    from scipy.spatial import cKDTree

    pairs = cKDTree(vertices[rim]).query_pairs(reach, output_type="ndarray")
    if not len(pairs):
        return faces
    return _join_vertices(faces, rim[pairs[:, 0]], rim[pairs[:, 1]], len(vertices), _WELDED, done)


def _join_vertices(faces: Ints, one: Ints, other: Ints, count: int, op: RepairOp, done: OpCounts) -> Ints:
    """Replace the second vertex of each pair by the first; remove faces that then use a vertex twice."""
    label = components(one, other, count)
    first = np.full(count, count)
    np.minimum.at(first, label, np.arange(count))
    place = first[label]
    done[op] += int((place[np.unique(faces)] != np.unique(faces)).sum())
    moved = place[faces]
    return _without(moved, triangles.duplicate_vertex_faces(moved), TWICE, done)


def _without_flats(vertices: Floats, faces: Ints, reach: float, done: OpCounts) -> Ints:
    """Remove flat faces: merge two coincident corners, or split the neighbour that has a corner on its edge."""
    flat = np.flatnonzero(triangles.flat_faces(vertices, faces))
    if not len(flat):
        return faces
    sides = np.linalg.norm(np.roll(vertices[faces[flat]], -1, axis=1) - vertices[faces[flat]], axis=2)
    needle = sides.min(axis=1) <= min(reach, 1e-3 * float(sides.max()))
    if needle.any():
        at, side = flat[needle], sides[needle].argmin(axis=1)
        return _join_vertices(faces, faces[at, side], faces[at, (side + 1) % 3], len(vertices), _COLLAPSED, done)
    edges = edges_of(faces)
    touched, cuts, gone = np.zeros(len(faces), bool), {}, []
    for face, side in zip(flat, sides.argmax(axis=1), strict=True):
        around = np.flatnonzero(edges.of == edges.of[3 * face + side])
        others = around[around // 3 != face]
        if touched[around // 3].any():
            continue
        touched[around // 3] = True
        gone.append(face)
        cuts.update({int(half_edge): [int(faces[face, (side + 2) % 3])] for half_edge in others})
    done[_COLLAPSED] += len(gone)
    return _split_faces(faces, cuts, np.array(gone, np.int64))


def _split_faces(faces: Ints, cuts: dict[int, list[int]], gone: Ints) -> Ints:
    """Return the faces without `gone`, those of `cuts` split from vertices on a half-edge to the opposite corner."""
    kept = np.ones(len(faces), bool)
    kept[gone] = False
    new: list[tuple[int, int, int]] = []
    for half_edge, between in cuts.items():
        face, side = divmod(half_edge, 3)
        kept[face] = False
        start, end, opposite = (int(faces[face, (side + step) % 3]) for step in range(3))
        new += [(tail, head, opposite) for tail, head in pairwise([start, *between, end])]
    return np.concatenate([faces[kept], np.array(new, np.int64).reshape(-1, 3)])


def _stitch_boundary(vertices: Floats, faces: Ints, reach: float, done: OpCounts) -> Ints:
    """Split open edges at open vertices within `reach` of them: a coarser side meets a finer one."""
    edges = edges_of(faces)
    rim = open_vertices(edges)
    if not 0 < len(rim) <= _MOST_OPEN:
        return faces
    from scipy.spatial import cKDTree

    half_edges = np.flatnonzero(edges.uses[edges.of] == 1)
    tails, heads = faces.ravel()[half_edges], np.roll(faces, -1, axis=1).ravel()[half_edges]
    middles = (vertices[tails] + vertices[heads]) / 2.0
    reaches = np.linalg.norm(vertices[heads] - vertices[tails], axis=1) / 2.0 - reach
    near = cKDTree(vertices[rim]).query_ball_point(middles, np.maximum(reaches, 0.0), return_sorted=True)
    cuts: dict[int, list[int]] = {}
    for at in np.flatnonzero([len(found) > 0 for found in near]):
        on = _on_segment(vertices, rim[near[at]], tails[at], heads[at], reach)
        on = on[~np.isin(on, faces[half_edges[at] // 3])]
        if len(on) and not any(3 * (half_edges[at] // 3) + side in cuts for side in range(3)):
            cuts[int(half_edges[at])] = [int(vertex) for vertex in on]
    done[_STITCHED] += len(cuts)
    return _split_faces(faces, cuts, np.empty(0, np.int64))


def _on_segment(vertices: Floats, candidates: Ints, tail: int, head: int, reach: float) -> Ints:
    """Return the candidates on the segment between two vertices, from tail to head."""
    along = vertices[head] - vertices[tail]
    length = float(np.linalg.norm(along))
    arms = vertices[candidates] - vertices[tail]
    run = arms @ along / length
    aside = np.linalg.norm(arms - run[:, None] * along / length, axis=1)
    on = (aside <= reach) & (run > reach) & (run < length - reach)
    return np.asarray(candidates[on][np.argsort(run[on], kind="stable")])
