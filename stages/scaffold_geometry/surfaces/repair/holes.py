"""Fill the holes of a surface: P. Liepa, "Filling holes in meshes", Symposium on Geometry Processing (2003) 200-205.

Each hole is triangulated with the least bending, then the patch is refined to the density around it and faired.
MeshLab's `meshing_close_holes` makes flat patches and leaves half of the broken files open
(docs/decisions/libraries.md).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.edges import edges_of
from scaffold_geometry.surfaces.repair.hole_fairing import fair_patch, refine_patch
from scaffold_geometry.surfaces.repair.hole_triangulation import triangulate_hole

LONGEST = 600
"""Most edges of a hole that is filled: triangulation takes the cube of their number, 3 s for these."""


class FilledHoles(NamedTuple):
    """The surface with patches after its own `vertices` and `faces`; `patches` (k,) is the hole of each new face."""

    vertices: Floats
    faces: Ints
    patches: Ints
    too_long: int


def fill_holes(vertices: Floats, faces: Ints) -> FilledHoles:
    """Fill all holes of up to `LONGEST` edges of a consistently oriented surface; its vertices and faces stay."""
    loops = _loops(vertices, faces)
    short = [loop for loop in loops if len(loop) <= LONGEST]
    if not short:
        return FilledHoles(vertices, faces, np.empty(0, np.int64), len(loops))
    # only the faces at a rim affect the filling
    near = _faces_at(faces, np.concatenate(short), len(vertices))
    normals, patches = _rim_normals(vertices, near), []
    for loop in short:
        own = _faces_at(near, loop, len(vertices))
        at_rim = np.array([normals[min(ends), max(ends)] for ends in pairwise([*loop.tolist(), int(loop[0])])])
        points, patch = refine_patch(vertices, own, triangulate_hole(vertices, loop, at_rim, own))
        vertices = fair_patch(points, own, patch, len(vertices))
        near = np.concatenate([near, patch])
        patches.append(patch)
    numbers = np.repeat(np.arange(len(patches)), [len(patch) for patch in patches])
    return FilledHoles(vertices, np.concatenate([faces, *patches]), numbers, len(loops) - len(short))


def _faces_at(faces: Ints, loop: Ints, count: int) -> Ints:
    is_on = np.zeros(count, bool)
    is_on[loop] = True
    return faces[is_on[faces].any(axis=1)]


def _loops(vertices: Floats, faces: Ints) -> list[Ints]:
    """Return the rims of the holes as simple loops, in the direction of the half-edges of a patch."""
    edges = edges_of(faces)
    rim = np.flatnonzero(edges.net)
    # a patch needs the half-edges opposite to the surplus ones of the surface
    ends = np.where(edges.net[rim, None] > 0, edges.ends[rim, ::-1], edges.ends[rim])
    ways: dict[int, list[int]] = {}
    for tail, head in np.repeat(ends, np.abs(edges.net[rim]), axis=0).tolist():
        ways.setdefault(tail, []).append(head)
    loops = []
    for start in sorted(ways):
        while ways[start]:
            loops += _walk_loops(vertices, ways, start)
    return [np.array(loop) for loop in loops if len(loop) > 2]  # corners of a triangle


def _walk_loops(vertices: Floats, ways: dict[int, list[int]], start: int) -> list[list[int]]:
    """Walk from `start` until the path ends, and split off a loop whenever it returns to one of its vertices."""
    path, places, loops = [start], {start: 0}, []
    while ways.get(path[-1]):
        choices = ways[path[-1]]
        head = choices[0] if len(choices) == 1 or len(path) == 1 else _narrowest(vertices, path[-2], path[-1], choices)
        choices.remove(head)
        if head not in places:
            places[head] = len(path)
            path.append(head)
            continue
        first = places[head]
        loops.append(path[first:])
        for vertex in path[first + 1 :]:
            del places[vertex]
        del path[first + 1 :]
    return loops


def _narrowest(vertices: Floats, before: int, at: int, choices: list[int]) -> int:
    """Return the next vertex with the least angle to the last edge: the other side of the same gap."""
    back = vertices[before] - vertices[at]
    ahead = vertices[choices] - vertices[at]
    cosines = ahead @ back / (np.linalg.norm(ahead, axis=1) * np.linalg.norm(back))
    return choices[int(np.argmax(cosines))]


def _rim_normals(vertices: Floats, faces: Ints) -> dict[tuple[int, int], Floats]:
    """Return the unit normal of the face at each edge of a hole, keyed by the edge, lower vertex first."""
    edges = edges_of(faces)
    half_edges = np.flatnonzero(edges.net[edges.of] != 0)
    a, b, c = np.moveaxis(vertices[faces[half_edges // 3]], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    return {(int(x), int(y)): normal for (x, y), normal in zip(edges.ends[edges.of[half_edges]], normals, strict=True)}
