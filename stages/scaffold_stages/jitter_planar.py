"""Stage `jitter_planar`: random porosity in a plane by moving the vertices of a planar mesh."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_geometry.volumes.jitter import random_steps, sound_move
from scaffold_pipeline.artifacts import PlanarMesh
from scaffold_pipeline.artifacts.cells import distinct_rows, faces_of_cells
from scaffold_pipeline.stages.contract import Params, Unit, stage

_STRAIGHT = 1e-9
"""Sine of the greatest angle at which two edges of the outline are one straight line, but for rounding."""


class JitterPlanarParams(Params):
    """Parameters of `jitter_planar`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest distance that a vertex moves."""

    boundary: Literal["outline", "free"] = "outline"
    """Whether the outline stays as it is, its vertices sliding on its straight parts only, or moves freely."""


@stage(writes="mesh", version=1)
def jitter_planar(mesh: PlanarMesh, *, params: JitterPlanarParams, rng: np.random.Generator) -> PlanarMesh:
    """Move each vertex in a random direction in the plane, by at most `amount` of the mean length of its edges.

    Directions are uniform on the circle, distances uniform up to the greatest. No tile turns over: the steps of the
    vertices of a tile that would are halved until it does not, and at last given up.
    """
    steps = random_steps(mesh.vertices, mesh.cells, params.amount, rng, 2)
    if params.boundary == "outline":
        steps = _along_outline(mesh, steps)
    moved, scales = sound_move(mesh.vertices, mesh.cells, steps)
    facts = {
        **mesh.facts,
        "vertices_moved": int((moved != mesh.vertices).any(axis=1).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return PlanarMesh(moved, mesh.triangles, mesh.quadrangles, facts)


def _along_outline(mesh: PlanarMesh, steps: Floats) -> Floats:
    """Return the steps (n, 3) with those of the outline along its straight parts, and none at its corners.

    Where pieces of the outline meet at a vertex, it stays too.
    """
    edges = faces_of_cells(mesh.cells)[:, :2]
    groups = distinct_rows(np.sort(edges, axis=1))[1]
    tails, heads = edges[np.bincount(groups)[groups] == 1].T
    ways = mesh.vertices[heads] - mesh.vertices[tails]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    arriving, leaving = np.zeros_like(steps), np.zeros_like(steps)
    arriving[heads], leaving[tails] = ways, ways
    turn = np.linalg.norm(np.cross(arriving, leaving), axis=1)
    is_straight = (turn < _STRAIGHT) & (np.einsum("ij,ij->i", arriving, leaving) > 0.0)
    is_straight &= np.bincount(heads, minlength=len(steps)) == 1
    along = np.einsum("ij,ij->i", steps, leaving)[:, None] * leaving
    is_outer = np.bincount(tails, minlength=len(steps)) > 0
    return np.where(is_outer[:, None], np.where(is_straight[:, None], along, 0.0), steps)
