"""Rule `thin_wall`: where the solid is thinnest, from one side of a wall straight through to the other.

At the thinnest place of a wall its sides are parallel, so the straight way through is the shortest. A ball grown from
the surface would be stopped by the next face at every edge, and by the next facet on every curved wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from scaffold_pipeline.artifacts import Fact, Floats, Ints, SurfaceMesh
from scaffold_pipeline.measurements import Finding
from scaffold_stages._kernels.facets import faces_near, facing
from scaffold_stages._measures.printability.places import apart_in, worded, worst_apart
from scaffold_stages._measures.printability.rules import Outcome, PrintRules

_SAMPLES = 100_000
"""Points on the surface: for a share of 1 % of the area a standard error of 0.03 % at most."""

_CLOSER = 3
_CLOSER_PLACES = 16
_CLOSER_SAMPLES = 10_000
"""How often the thinnest places are looked at more closely, how many of them, and with how many points in all."""

_INSIDE = 1e-7
"""Share of the greatest coordinate by which a ray starts within the solid: above the rounding of its own face."""

_PLASTIC = 1.324717957244746
"""The plastic number; steps of its first two inverse powers spread points evenly over a square (Roberts, 2018)."""


@dataclass(frozen=True, eq=False)
class _Walls:
    """Walls under points of the surface, (n, 3): their thickness, (n,) mm, inf where there is no other side."""

    points: Floats
    thickness: Floats
    middles: Floats


def thin_walls(surface: SurfaceMesh, rules: PrintRules) -> Outcome:
    """Measure the walls of a closed surface at points spread evenly over it, and closely where they are thinnest.

    What lies opposite a point, along its normal, is the other side of a wall where the two open at less than
    `wall_angle`. So the rim of a box is no thin wall, but a knife's edge is, of thickness down to 0. Shares are those
    of the whole surface's area.
    """
    areas, _ = facing(surface.vertices, surface.faces, rules.up)
    caster = _Caster(surface, rules.wall_angle)
    walls = caster.walls(*_spread(surface, areas, np.arange(len(areas)), _SAMPLES))
    closer = _closer(surface, areas, caster, walls)
    thinnest = int(np.argmin(closer.thickness))
    least = float(closer.thickness[thinnest])
    one_percent = float(np.quantile(walls.thickness, 0.01, method="lower"))
    values: dict[str, Fact] = {
        "thinnest_wall_mm": _finite(least),
        "thinnest_wall_at": worded(closer.middles[thinnest])[1:-1] if np.isfinite(least) else None,
        "wall_first_percent_mm": _finite(one_percent),
        "thin_wall_fraction": None if rules.min_wall is None else float(np.mean(walls.thickness < rules.min_wall)),
    }
    return Outcome(values, _finding(surface, rules, closer, values))


def _finite(length: float) -> float | None:
    return length if np.isfinite(length) else None


def _finding(surface: SurfaceMesh, rules: PrintRules, walls: _Walls, values: dict[str, Fact]) -> Finding | None:
    if rules.min_wall is None or walls.thickness.min() >= rules.min_wall:
        return None
    thin = np.flatnonzero(walls.thickness < rules.min_wall)
    named = thin[worst_apart(walls.middles[thin], -walls.thickness[thin], apart_in(surface), rules.most_places)]
    message = (
        f"a wall is {walls.thickness[named[0]]:.3g} mm thin at {worded(walls.middles[named[0]])}, and under "
        f"{values['thin_wall_fraction']:.2%} of the surface walls are below the {rules.min_wall:g} mm asked for; "
        "lower porosity, or use larger cells"
    )
    return Finding("thin_wall", message, walls.middles[named])


class _Caster:
    """Sends rays into a solid; igl finds by a tree of boxes where they leave it."""

    def __init__(self, surface: SurfaceMesh, wall_angle: float) -> None:
        import igl

        self._mesh = surface.vertices, surface.faces
        self._least_cosine = float(np.cos(np.radians(wall_angle)))
        self._inside = _INSIDE * float(np.abs(surface.bounds).max())
        self._tree: Any = igl.AABB()
        self._tree.init(*self._mesh)

    def walls(self, points: Floats, normals: Floats) -> _Walls:
        """Return the walls under points of the surface, (n, 3), with its outward unit normals there, (n, 3)."""
        faces, lengths, _ = self._tree.intersect_ray_first(*self._mesh, points - self._inside * normals, -normals)
        cosines = -np.einsum("ij,ij->i", self._normals(np.maximum(faces, 0)), normals)
        is_wall = (faces >= 0) & (cosines >= self._least_cosine)
        thickness = np.where(is_wall, lengths + self._inside, np.inf)
        return _Walls(points, thickness, points - np.where(is_wall, thickness / 2.0, 0.0)[:, None] * normals)

    def _normals(self, faces: Ints) -> Floats:
        vertices, corners = self._mesh
        return _unit_normals(vertices[corners[faces]])


def _closer(surface: SurfaceMesh, areas: Floats, caster: _Caster, walls: _Walls) -> _Walls:
    """Return the walls, and more of them about the thinnest, where faces are sampled ever more densely."""
    reach = 2.0 * float(np.sqrt(areas.sum() / _SAMPLES))
    for _ in range(_CLOSER):
        thinnest = worst_apart(walls.points, -walls.thickness, reach, _CLOSER_PLACES)
        places = walls.points[thinnest[np.isfinite(walls.thickness[thinnest])]]
        near = np.flatnonzero(faces_near(surface.vertices, surface.faces, places, reach))
        if not areas[near].any():
            break
        found = caster.walls(*_spread(surface, areas, near, _CLOSER_SAMPLES))
        walls = _Walls(*(np.concatenate(pair) for pair in zip(_parts(walls), _parts(found), strict=True)))
        reach /= 4.0
    return walls


def _parts(walls: _Walls) -> tuple[Floats, Floats, Floats]:
    return walls.points, walls.thickness, walls.middles


def _spread(surface: SurfaceMesh, areas: Floats, among: Ints, count: int) -> tuple[Floats, Floats]:
    """Return `count` points spread evenly, by area, over the faces `among` (k,), and the normals there, (count, 3).

    One point to each equal share of the area, face after face, so that the same surface has the same points.
    """
    ends = np.cumsum(areas[among])
    steps = np.arange(count)
    chosen = among[np.searchsorted(ends, (steps + 0.5) / count * ends[-1], side="right")]
    corners = surface.vertices[surface.faces[chosen]]
    u, v = ((0.5 + steps / _PLASTIC**power) % 1.0 for power in (1, 2))
    is_beyond = u + v > 1.0
    u, v = np.where(is_beyond, 1.0 - u, u), np.where(is_beyond, 1.0 - v, v)
    points = np.einsum("kn,nkj->nj", np.stack([1.0 - u - v, u, v]), corners)
    return points, _unit_normals(corners)


def _unit_normals(corners: Floats) -> Floats:
    """Return the unit normals of triangles (n, 3, 3), zero where one has no area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
