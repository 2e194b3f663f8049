"""Split a closed surface where it touches itself, so that every edge has two faces and every vertex one fan.

`vertices` (n, 3) and `faces` (m, 3), counter-clockwise from outside. A half-edge `h` runs from corner `h % 3` of face
`h // 3` to that face's next corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.errors import StageError

SHARE = 0.01
"""Distance that a vertex is moved inward, in lengths of its shortest edge: invisible, but enough for float32."""

_STEPS, _CLOSE = 1000, 1e-3
"""Most steps to the direction most inward of all faces, and the tolerance; fans of few faces need tens of steps."""

_LEAST_SINE = 1e-3
"""Sine of the angle to the nearest face below which a direction is not inward."""

_FAR, _NEAR = (7.0, 11.0, 13.0), 1e-3
"""The point that closes a fan of unit length, in a direction unusual in meshes, and the size of its neighbourhood."""

_ROUNDS = 8
"""Rounds of splitting edges: each splits at most one edge of a face, and a face has three."""


class SplitSurface(NamedTuple):
    """The split surface, the numbers of vertices and edges of contact, and the greatest move of a vertex."""

    vertices: Floats
    faces: Ints
    touching_vertices: int
    touching_edges: int
    farthest: float


class _Fan(NamedTuple):
    """The faces around a vertex: `rays` (k, 2, 3) along their edges from it, `normals` (k, 3), the shortest edge."""

    rays: Floats
    normals: Floats
    shortest: float


def split_non_manifold(vertices: Floats, faces: Ints) -> SplitSurface:
    """Return the surface with one vertex for each fan; coincident ones are moved apart into the solid.

    Four faces at an edge are paired across the solid between them, so that the solid is separated. Raises `StageError`
    if there is no inward direction.
    """
    _, uses = np.unique(_edge_keys(faces), return_counts=True)
    touching_edges, places = int((uses > 2).sum()), vertices  # an edge has two faces
    for _ in range(_ROUNDS):
        partner = _partners(places, faces)
        fans = _fans(faces, partner)
        doubled = _find_double_edges(fans, partner)
        if not len(doubled):
            break
        places, faces = _split_edges(places, faces, doubled, partner)
    owner = np.zeros(int(fans.max()) + 1, dtype=np.int64)
    owner[fans.ravel()] = faces.ravel()
    is_shared = np.bincount(owner, minlength=len(places))[owner] > 1
    is_shared |= owner >= len(vertices)  # the midpoints of a split edge coincide too
    place = np.unique(places[owner], axis=0, return_inverse=True)[1].ravel()
    moved, farthest = _move_apart(places[owner], fans, np.flatnonzero(is_shared), place)
    touching = int((np.bincount(owner[owner < len(vertices)]) > 1).sum())
    return SplitSurface(moved, fans, touching, touching_edges, farthest)


def _heads(faces: Ints) -> Ints:
    return np.roll(faces, -1, axis=1).ravel()


def _next(half_edge: Ints) -> Ints:
    return np.asarray(half_edge - half_edge % 3 + (half_edge + 1) % 3)


def _edge_keys(faces: Ints) -> Ints:
    tails, heads = faces.ravel(), _heads(faces)
    return np.asarray(np.minimum(tails, heads) * (faces.max(initial=0) + 1) + np.maximum(tails, heads))


def _partners(vertices: Floats, faces: Ints) -> Ints:
    """Return the half-edge opposite to each half-edge, (3m,): across the solid at edges of more than two."""
    order = np.argsort(_edge_keys(faces), kind="stable")
    key = _edge_keys(faces)[order]
    starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    sizes = np.diff(np.append(starts, len(key)))
    partner = np.empty(faces.size, dtype=np.int64)
    pairs = starts[sizes == 2]
    partner[order[pairs]], partner[order[pairs + 1]] = order[pairs + 1], order[pairs]
    for start, size in zip(starts[sizes != 2], sizes[sizes != 2], strict=True):
        around = order[start : start + size]
        one, other = _pair_half_edges(vertices, faces, around)
        partner[one], partner[other] = other, one
    return partner


def _pair_half_edges(vertices: Floats, faces: Ints, around: Ints) -> tuple[Ints, Ints]:
    """Pair the half-edges of one edge, each with that of the face across the solid."""
    tails, heads = faces.ravel()[around], _heads(faces)[around]
    low, high = vertices[min(tails[0], heads[0])], vertices[max(tails[0], heads[0])]
    axis = (high - low) / np.linalg.norm(high - low)
    arms = vertices[faces.ravel()[_next(_next(around))]] - low
    first = arms[0] - (arms[0] @ axis) * axis
    angles = np.arctan2(arms @ np.cross(axis, first), arms @ first)
    turning = np.argsort(angles, kind="stable")
    is_forward = (tails < heads)[turning]
    if not (is_forward != np.roll(is_forward, 1)).all():
        at = (low + high) / 2.0
        raise StageError(
            f"its boundary folds onto itself at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm: {len(around)} faces meet at "
            "an edge, and solid and void do not alternate around it"
        )
    # A face whose half-edge goes up the axis has its normal towards larger angles, so its solid is at smaller angles.
    return around[turning[is_forward]], around[np.roll(turning, 1)[is_forward]]


def _fans(faces: Ints, partner: Ints) -> Ints:
    """Return the fan of each corner, (m, 3), from 0: corners of one vertex joined over paired half-edges."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    half_edges = np.arange(faces.size)
    ends = (half_edges, _next(partner))
    graph = coo_array((np.ones(len(half_edges), np.int8), ends), shape=(len(half_edges),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64).reshape(-1, 3)


def _find_double_edges(fans: Ints, partner: Ints) -> Ints:
    """Return half-edges, one of each pair, whose edge has four faces although its ends are separate fans."""
    _, edge, uses = np.unique(_edge_keys(fans), return_inverse=True, return_counts=True)
    half_edges = np.arange(fans.size)
    return np.flatnonzero((uses[edge] > 2) & (half_edges < partner))


def _split_edges(vertices: Floats, faces: Ints, doubled: Ints, partner: Ints) -> tuple[Floats, Ints]:
    """Split edges at their midpoints, each with its own vertex, and their faces; at most one edge of a face."""
    taken = np.zeros(len(faces), dtype=bool)
    cut = []
    for half_edge in doubled:
        pair = [half_edge // 3, partner[half_edge] // 3]
        if not taken[pair].any():
            taken[pair] = True
            cut.append(half_edge)
    halves = np.array(cut, dtype=np.int64)
    middles = (vertices[faces.ravel()[halves]] + vertices[_heads(faces)[halves]]) / 2.0
    hub = np.tile(len(vertices) + np.arange(len(halves)), 2)
    own = np.concatenate([halves, partner[halves]])
    corner, follower, opposite = (faces.ravel()[at] for at in (own, _next(own), _next(_next(own))))
    kept = faces.copy()
    kept[own // 3] = np.column_stack([corner, hub, opposite])
    return np.concatenate([vertices, middles]), np.concatenate([kept, np.column_stack([hub, follower, opposite])])


def _move_apart(vertices: Floats, faces: Ints, which: Ints, place: Ints) -> tuple[Floats, float]:
    """Move the vertices `which` away from others at the same `place`; return all vertices and the greatest move.

    One vertex at a place may stay; the others move away from it.
    """
    moved, farthest = vertices.copy(), 0.0
    staying: set[int] = set()
    fans = {int(vertex): _fan(vertices, faces, vertex) for vertex in which}
    for vertex, fan in fans.items():
        others = [other for rival, other in fans.items() if rival != vertex and place[rival] == place[vertex]]
        direction = _way_out(fan, others)
        if direction is not None:
            way = SHARE * fan.shortest
            moved[vertex] += way * direction
            farthest = max(farthest, way)
        elif place[vertex] not in staying:
            staying.add(int(place[vertex]))
        else:
            at = vertices[vertex]
            raise StageError(
                f"its boundary touches itself at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm, where its parts cannot be "
                "moved apart"
            )
    return moved, farthest


def _fan(vertices: Floats, faces: Ints, vertex: int) -> _Fan:
    of_fan, corner = np.nonzero(faces == vertex)
    ahead, behind = (vertices[faces[of_fan, (corner + step) % 3]] - vertices[vertex] for step in (1, 2))
    normals = np.cross(ahead, behind)
    lengths = np.linalg.norm(ahead, axis=1), np.linalg.norm(behind, axis=1)
    rays = [ray / length[:, None] for ray, length in zip((ahead, behind), lengths, strict=True)]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return _Fan(np.stack(rays, axis=1), normals, float(lengths[0].min()))


def _way_out(fan: _Fan, others: list[_Fan]) -> Floats | None:
    """Return the direction to the side of `fan` without any of the others, or None if they are on both sides."""
    is_in_solid = {_is_in_solid(fan, other.rays[0].mean(axis=0)) for other in others}
    if len(is_in_solid) != 1:
        return None
    return _inwards(fan.normals if is_in_solid.pop() else -fan.normals)


def _is_in_solid(fan: _Fan, direction: Floats) -> bool:
    """Return whether a direction from the fan's vertex goes into the solid, as one just below a face does.

    The fan is closed by a far point, so that the winding number of the solid side is one more than that of the void.
    """
    count = len(fan.rays)
    corners = np.concatenate([np.zeros((1, 3)), [_FAR], fan.rays.reshape(-1, 3)])
    rim = 2 + np.arange(2 * count).reshape(count, 2)
    closed = np.concatenate([np.column_stack([np.full(count, k), rim[:, :: 1 - 2 * k]]) for k in (0, 1)])
    below = fan.rays[0].mean(axis=0) - _NEAR * fan.normals[0]
    one, other = (triangles.winding_number(_NEAR * ray, corners, closed) for ray in (direction, below))
    return abs(one - other) < 0.5  # they differ by 0 or 1


def _inwards(inner: Floats) -> Floats | None:
    """Return the direction with the greatest least dot product with unit vectors `inner` (k, 3), if above 0.

    It is that of the shortest vector in their convex hull: E. G. Gilbert, SIAM Journal on Control 4 (1966) 61-80.
    """
    nearest = inner.mean(axis=0)
    for _ in range(_STEPS):
        step = inner[np.argmin(inner @ nearest)] - nearest
        gain = -float(nearest @ step)
        if gain <= _CLOSE * float(nearest @ nearest):
            break
        nearest = nearest + min(gain / float(step @ step), 1.0) * step
    length = float(np.linalg.norm(nearest))
    is_inwards = length > 0.0 and (inner @ nearest).min() > _LEAST_SINE * length
    return np.asarray(nearest / length) if is_inwards else None
