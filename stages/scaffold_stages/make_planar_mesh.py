"""Stage `make_planar_mesh`: regular meshes in a plane, centred at x = y = 0."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats, Ints
from scaffold_pipeline.artifacts import PlanarMesh
from scaffold_pipeline.stages.contract import Millimetres, Params, Unit, stage

Tile = tuple[int, int, int]
Count = Annotated[int, Field(ge=1, le=1000)]


class MakePlanarMeshParams(Params):
    """Parameters of `make_planar_mesh`."""

    shape: Literal["triangle", "quadrangle", "triangles", "quadrangles", "disc"] = "quadrangle"
    """One equilateral triangle, one square, a rectangle of triangles or squares, or a disc of triangles."""

    counts: tuple[Count, Count] | None = None
    """Number of squares along x and y, or of triangles along the lower side and of rows; required for a rectangle."""

    rings: Count | None = None
    """Number of rings of triangles in a disc, required for it; ring k has 6 k edges on its outside."""

    edge: Millimetres = Field(default=1.0, gt=0.0)
    """Edge length; in a disc that of the radial edges, so that its radius is rings x edge."""

    z: Annotated[float, Unit("mm")] = 0.0
    """Height of the plane."""

    @model_validator(mode="after")
    def _only_what_applies(self) -> MakePlanarMeshParams:
        needed = {"triangles": "counts", "quadrangles": "counts", "disc": "rings"}.get(self.shape)
        for name in ("counts", "rings"):
            if (getattr(self, name) is None) == (name == needed):
                rule = (
                    "is required with shape: {}; give it"
                    if name == needed
                    else "does not apply to shape: {}; leave it out"
                )
                raise ValueError(f"{name}: {rule.format(self.shape)}")
        return self


@stage(writes="mesh", version=1)
def make_planar_mesh(*, params: MakePlanarMeshParams) -> PlanarMesh:
    """Make a planar mesh: a triangle, a square, a rectangle of triangles or squares, or a disc, centred at x = y = 0.

    A rectangle of triangles has equilateral triangles, and half ones at both ends of each row.
    """
    if params.shape == "disc":
        places, tiles = _disc(params.rings or 1)
    elif params.shape == "triangle":
        places, tiles = np.array([(0.0, 0.0), (1.0, 0.0), (0.5, np.sqrt(0.75))]), np.array([(0, 1, 2)])
    else:
        make = _triangles if params.shape == "triangles" else _squares
        places, tiles = make(*(params.counts or (1, 1)))
    centred = places - (places.min(axis=0) + places.max(axis=0)) / 2.0
    vertices = np.insert(params.edge * centred, 2, params.z, axis=1)
    return PlanarMesh(vertices, quadrangles=tiles) if "quad" in params.shape else PlanarMesh(vertices, triangles=tiles)


def _squares(columns: int, rows: int) -> tuple[Floats, Ints]:
    j, i = np.indices((rows + 1, columns + 1))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    return np.column_stack([i.ravel(), j.ravel()]).astype(float), first + np.array([0, 1, columns + 2, columns + 1])


def _triangles(columns: int, rows: int) -> tuple[Floats, Ints]:
    """Return rows of triangles: every other line of vertices is shifted by half an edge, except for its ends."""
    whole = np.arange(columns + 1.0)
    shifted = np.concatenate([[0.0], whole[:-1] + 0.5, [float(columns)]])
    lines = [shifted if row % 2 else whole for row in range(rows + 1)]
    starts = np.cumsum([0, *map(len, lines)]).tolist()
    height = np.repeat(np.sqrt(0.75) * np.arange(rows + 1), [len(line) for line in lines])
    tiles = [
        tile
        for row in range(rows)
        for tile in (_strip_down if row % 2 else _strip_up)(starts[row], starts[row + 1], columns)
    ]
    return np.column_stack([np.concatenate(lines), height]), np.array(tiles)


def _strip_up(low: int, high: int, columns: int) -> list[Tile]:
    """Return the triangles between lines of vertices that begin at `low` and `high`, the upper line shifted."""
    pointing_down = [(low + i, high + i + 1, high + i) for i in range(columns + 1)]
    return pointing_down + [(low + i, low + i + 1, high + i + 1) for i in range(columns)]


def _strip_down(low: int, high: int, columns: int) -> list[Tile]:
    """Return the same with the lower line shifted."""
    pointing_up = [(low + i, low + i + 1, high + i) for i in range(columns + 1)]
    return pointing_up + [(low + i + 1, high + i + 1, high + i) for i in range(columns)]


def _disc(rings: int) -> tuple[Floats, Ints]:
    """Return 6 k points on ring k, and the triangles between rings in six sectors."""
    places, tiles = [np.zeros((1, 2))], []
    for k in range(1, rings + 1):
        angles = np.arange(6 * k) * (np.pi / (3 * k))
        places.append(k * np.column_stack([np.cos(angles), np.sin(angles)]))
        inner, outer = 1 + 3 * (k - 1) * (k - 2) if k > 1 else 0, 1 + 3 * k * (k - 1)
        for sector in range(6):
            within = [inner + (sector * (k - 1) + j) % max(6 * (k - 1), 1) for j in range(k)]
            around = [outer + (sector * k + j) % (6 * k) for j in range(k + 1)]
            tiles += [(within[j], around[j], around[j + 1]) for j in range(k)]
            tiles += [(within[j], around[j + 1], within[j + 1]) for j in range(k - 1)]
    return np.concatenate(places), np.array(tiles)
