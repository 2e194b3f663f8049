"""Stage `jitter_planar`: random pore geometry in a plane by random movement of a planar mesh's vertices."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_geometry.volumes.jitter import move_without_inversion, random_steps
from scaffold_pipeline.artifacts import PlanarMesh
from scaffold_pipeline.artifacts.cells import distinct_rows, faces_of_cells
from scaffold_pipeline.stages.contract import Params, Unit, stage

_STRAIGHT = 1e-9
"""Sine of the greatest angle between two edges of the outline that are one straight line up to rounding."""


class JitterPlanarParams(Params):
    """Parameters of `jitter_planar`."""

    amount: Annotated[float, Unit("mean length of the vertex's edges")] = Field(default=0.2, ge=0.0, lt=0.5)
    """Greatest displacement of a vertex."""

    boundary: Literal["outline", "free"] = "outline"
    """`outline`: the outline keeps its shape, its vertices slide along straight parts; `free`: they move freely."""


@stage(writes="mesh", version=1)
def jitter_planar(mesh: PlanarMesh, *, params: JitterPlanarParams, rng: np.random.Generator) -> PlanarMesh:
    """Move each vertex in a random direction in the plane, by at most `amount` times the mean length of its edges.

    Directions are uniform on the circle, distances uniform up to the greatest. No cell is inverted: the steps of a
    cell's vertices are halved until it is not, and after six halvings set to zero.
    """
    steps = random_steps(mesh.vertices, mesh.cells, params.amount, rng, 2)
    if params.boundary == "outline":
        steps = _along_outline(mesh, steps)
    moved, scales = move_without_inversion(mesh.vertices, mesh.cells, steps)
    facts = {
        **mesh.facts,
        "vertices_moved": int((moved != mesh.vertices).any(axis=1).sum()),
        "vertices_held_back": int((scales < 1.0).sum()),
    }
    return PlanarMesh(moved, mesh.triangles, mesh.quadrangles, facts)


def _along_outline(mesh: PlanarMesh, steps: Floats) -> Floats:
    """Return the steps (n, 3), those of the outline projected onto its straight parts, and zero at its corners.

    A vertex where pieces of the outline meet does not move either.
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
