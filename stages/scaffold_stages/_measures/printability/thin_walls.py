"""Rule `thin_wall`: where the solid is thinnest, from one side of a wall straight through to the other.

At the thinnest place of a wall its sides are parallel, so the straight way through is the shortest. A ball grown from
the surface would be stopped by the next face at every edge, and by the next facet on every curved wall.

Along a rim every thickness down to 0 is found, and the least of them tells of the samples, not of the solid. So what
lies opposite is the other side of a wall only where the two open at less than `knife_angle`, and where they do not run
out, just as they open, into a sharp edge close by: that is for the rule `knife_edge`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

_ROUNDING = 1e-5
"""Share by which a wall may fall short of what is asked for: lengths along rays are of single precision."""

_INSIDE = 1e-7
"""Share of the greatest coordinate by which a ray starts within the solid: above the rounding of its own face."""

_CLOSE = 4.0
_NEAR = 12.0
_AS_TOLD = 0.4, 2.5
"""Two sides end in a rim that is nearer than `_CLOSE` times their thickness, or nearer than `_NEAR` times, where sides
meet that open at 5 degrees, and as far off as their opening tells, within these shares: of hollow sides it tells half,
of bulging ones twice as much."""

_PLASTIC = 1.324717957244746
"""The plastic number; steps of its first two inverse powers spread points evenly over a square (Roberts, 2018)."""


Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Walls:
    """The walls under some points of the surface, (n, 3): their thickness, (n,) mm, and their middles, (n, 3)."""

    points: Floats
    thickness: Floats
    middles: Floats


def thin_walls(surface: SurfaceMesh, rims: Ints, rules: PrintRules) -> Outcome:
    """Measure the walls of a closed surface at points spread evenly over it, and closely where they are thinnest.

    `rims` (k, 2) are its sharp edges, pairs of vertex indices. The share of what is thin is that of the whole surface.
    """
    areas, _ = facing(surface.vertices, surface.faces, rules.up)
    caster = _Caster(surface, rims, rules.knife_angle)
    walls = caster.walls(*_spread(surface, areas, np.arange(len(areas)), _SAMPLES))
    closer = _closer(surface, areas, caster, walls)
    if not len(closer.thickness):
        return Outcome(dict.fromkeys(("thinnest_wall_mm", "thinnest_wall_at", "wall_first_percentile_mm")), None)
    thinnest = int(np.argmin(closer.thickness))
    values: dict[str, Fact] = {
        "thinnest_wall_mm": float(closer.thickness[thinnest]),
        "thinnest_wall_at": worded(closer.middles[thinnest])[1:-1],
        "wall_first_percentile_mm": float(np.quantile(walls.thickness, 0.01)) if len(walls.thickness) else None,
    }
    if rules.min_wall is None:
        return Outcome(values, None)
    values["thin_wall_fraction"] = share = len(_thin(walls, rules.min_wall)) / _SAMPLES
    thin = _thin(closer, rules.min_wall)
    if not len(thin):
        return Outcome(values, None)
    named = thin[worst_apart(closer.middles[thin], -closer.thickness[thin], apart_in(surface), rules.most_places)]
    message = (
        f"a wall is {closer.thickness[named[0]]:.3g} mm thin at {worded(closer.middles[named[0]])}, and under "
        f"{share:.2%} of the surface walls are below the {rules.min_wall:g} mm asked for; lower porosity, or use "
        "larger cells"
    )
    return Outcome(values, Finding("thin_wall", message, closer.middles[named]))


def _thin(walls: _Walls, least: float) -> Ints:
    return np.flatnonzero(walls.thickness < (1.0 - _ROUNDING) * least)


class _Caster:
    """Sends rays into a solid; igl finds by trees of boxes where they leave it, and how far off the rims are."""

    def __init__(self, surface: SurfaceMesh, rims: Ints, knife_angle: float) -> None:
        import igl

        self._mesh = surface.vertices, surface.faces
        self._rims = rims
        self._least_cosine = float(np.cos(np.radians(knife_angle)))
        self._inside = _INSIDE * float(np.abs(surface.bounds).max())
        self._tree: Any = igl.AABB()
        self._tree.init(*self._mesh)

    def walls(self, points: Floats, normals: Floats) -> _Walls:
        """Return the walls under points of the surface, (n, 3), with its outward unit normals there, (n, 3)."""
        vertices, faces = self._mesh
        left, lengths, _ = self._tree.intersect_ray_first(*self._mesh, points - self._inside * normals, -normals)
        cosines = -np.einsum("ij,ij->i", _unit_normals(vertices[faces[np.maximum(left, 0)]]), normals)
        met = np.flatnonzero((left >= 0) & (cosines >= self._least_cosine))
        thickness = lengths[met] + self._inside
        middles = points[met] - thickness[:, None] / 2.0 * normals[met]
        is_wall = ~self._runs_out(middles, thickness, cosines[met])
        return _Walls(points[met][is_wall], thickness[is_wall], middles[is_wall])

    def _runs_out(self, middles: Floats, thickness: Floats, cosines: Floats) -> Mask:
        """Return where two sides that open by so much run out into a rim, (n,)."""
        import igl

        if not (len(self._rims) and len(middles)):
            return np.zeros(len(middles), bool)
        squared, _, _ = igl.point_mesh_squared_distance(middles, self._mesh[0], self._rims)
        off = np.sqrt(squared) / thickness
        told = off * np.tan(np.arccos(np.minimum(cosines, 1.0)))
        is_as_told = (told >= _AS_TOLD[0]) & (told <= _AS_TOLD[1])
        return np.asarray((off < _CLOSE) | ((off < _NEAR) & is_as_told))


def _closer(surface: SurfaceMesh, areas: Floats, caster: _Caster, walls: _Walls) -> _Walls:
    """Return the walls, and more of them about the thinnest, where faces are sampled ever more densely."""
    reach = 2.0 * float(np.sqrt(areas.sum() / _SAMPLES))
    for _ in range(_CLOSER):
        thinnest = worst_apart(walls.points, -walls.thickness, reach, _CLOSER_PLACES)
        places = walls.points[thinnest]
        near = np.flatnonzero(faces_near(surface.vertices, surface.faces, places, reach))
        if not len(near):
            break
        within = np.minimum(areas, (2.0 * reach) ** 2)  # a face much larger than the place would take all points
        found = caster.walls(*_spread(surface, within, near, _CLOSER_SAMPLES))
        walls = _Walls(*(np.concatenate(pair) for pair in zip(_parts(walls), _parts(found), strict=True)))
        reach /= 4.0
    return walls


def _parts(walls: _Walls) -> tuple[Floats, Floats, Floats]:
    return walls.points, walls.thickness, walls.middles


def _spread(surface: SurfaceMesh, weights: Floats, among: Ints, count: int) -> tuple[Floats, Floats]:
    """Return `count` points on the faces `among` (k,), by their `weights` (m,), and the normals there, (count, 3).

    One point to each equal share of the weight, face after face, so that the same surface has the same points.
    """
    ends = np.cumsum(weights[among])
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
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0))
