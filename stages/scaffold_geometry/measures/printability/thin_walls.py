"""Rule `thin_wall`: where the solid is thinnest, from one side of a wall straight through to the other.

At the thinnest place of a wall its sides are parallel, so the straight way through is the shortest. A ball grown from
the surface would be stopped by the next face at every edge, and by the next facet on every curved wall.

What makes a wall is for `walls` to tell.
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.measures.declarations import place_facts
from scaffold_geometry.measures.printability.facets import faces_near, facing
from scaffold_geometry.measures.printability.places import apart_in, format_place, worst_apart
from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_geometry.measures.printability.walls import WallFinder, Walls
from scaffold_geometry.measures.surface_tree import SurfaceTree, unit_normals
from scaffold_pipeline.artifacts import Fact, Finding, SurfaceMesh

_SAMPLES = 100_000
"""Points on the surface: for a share of 1 % of the area a standard error of 0.03 % at most."""

_CLOSER = 3
_CLOSER_PLACES = 16
_CLOSER_SAMPLES = 10_000
"""How often the thinnest places are looked at more closely, how many of them, and with how many points in all."""

_ROUNDING = 1e-5
"""Share by which a wall may fall short of what is asked for: lengths along rays are of single precision."""

_PLASTIC = 1.324717957244746
"""The plastic number; steps of its first two inverse powers spread points evenly over a square (Roberts, 2018)."""


def thin_walls(surface: SurfaceMesh, tree: SurfaceTree, rules: PrintRules) -> Outcome:
    """Measure the walls of a closed surface at points spread evenly over it, and closely where they are thinnest.

    `tree` finds its triangles. The share of what is thin is that of the whole surface.
    """
    areas, _ = facing(surface.vertices, surface.faces, rules.up)
    finder = WallFinder(surface, tree, rules.wall_angle, rules.layer, rules.min_wall or 0.0)
    walls = finder.walls(*_spread(surface, areas, np.arange(len(areas)), _SAMPLES))
    closer = _closer(surface, areas, finder, walls)
    values = _numbers(walls, closer, rules.min_wall)
    if rules.min_wall is None:
        return Outcome(values, None)
    thin = _thin(closer, rules.min_wall)
    if not len(thin):
        return Outcome(values, None)
    named = thin[worst_apart(closer.middles[thin], -closer.thickness[thin], apart_in(surface), rules.most_places)]
    message = (
        f"a wall is {closer.thickness[named[0]]:.3g} mm thin at {format_place(closer.middles[named[0]])}, and under "
        f"{values['thin_wall_fraction']:.2%} of the surface walls are below the {rules.min_wall:g} mm asked for; lower "
        "porosity, or use larger cells"
    )
    return Outcome(values, Finding("thin_wall", message, closer.middles[named]))


def _numbers(walls: Walls, closer: Walls, least: float | None) -> dict[str, Fact]:
    """Return what the walls spread evenly say, and of the thinnest those looked at closely, too; None without walls."""
    thinnest = int(np.argmin(closer.thickness)) if len(closer.thickness) else None
    return {
        "thinnest_wall_mm": None if thinnest is None else float(closer.thickness[thinnest]),
        **place_facts("thinnest_wall", None if thinnest is None else closer.middles[thinnest]),
        "wall_percentile_5_mm": float(np.quantile(walls.thickness, 0.05)) if len(walls.thickness) else None,
        "thin_wall_fraction": None if least is None else len(_thin(walls, least)) / _SAMPLES,
    }


def _thin(walls: Walls, least: float) -> Ints:
    return np.flatnonzero(walls.thickness < (1.0 - _ROUNDING) * least)


def _closer(surface: SurfaceMesh, areas: Floats, finder: WallFinder, walls: Walls) -> Walls:
    """Return the walls, and more of them about the thinnest, where faces are sampled ever more densely."""
    reach = 2.0 * float(np.sqrt(areas.sum() / _SAMPLES))
    for _ in range(_CLOSER):
        thinnest = worst_apart(walls.points, -walls.thickness, reach, _CLOSER_PLACES)
        places = walls.points[thinnest]
        near = np.flatnonzero(faces_near(surface.vertices, surface.faces, places, reach))
        if not len(near):
            break
        within = np.minimum(areas, (2.0 * reach) ** 2)  # a face much larger than the place would take all points
        walls = walls.and_these(finder.walls(*_spread(surface, within, near, _CLOSER_SAMPLES)))
        reach /= 4.0
    return walls


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
    return points, unit_normals(corners)
