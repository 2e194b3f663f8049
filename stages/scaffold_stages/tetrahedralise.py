"""Stage `tetrahedralise`: the outer shape filled with tetrahedra of one size, by fTetWild.

Hu, Schneider, Wang, Zorin, Panozzo, "Fast tetrahedral meshing in the wild", ACM Transactions on Graphics 39 (2020).
"""

from __future__ import annotations

import os

import numpy as np
from pydantic import Field, model_validator

from scaffold_pipeline.artifacts import Floats, Ints, OuterShape, VolumeMesh
from scaffold_pipeline.cell_types import cell_volumes
from scaffold_pipeline.contract import Millimetres, Params, stage
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.isolation import Arrays, call_in_child

TOLERANCE = 0.15
"""How far the mean edge, or the number of cells, may be from what was asked for."""

ATTEMPTS = 5
"""fTetWild takes a target, not a promise: on bones the mean edge came out at 0.8 to 1.0 of it. Each attempt
corrects the target by what the one before gave."""

FIRST_TARGET = 1.08
"""First target edge, in edges asked for: what met the tolerance at once on most of the bones tried."""

COARSER_ENVELOPE = 1.7
"""Growth of the envelope where cells come out too small: details of the surface then hold their size down, whatever
the target. Edges of the heel bone at 8 mm stayed at 0.86 of a target 1.3 times as large."""

EDGE_CELL_VOLUME = 0.105
"""Volume of a mean cell in cubes of the mean edge (a regular tetrahedron has 0.118)."""

LIMITS = (2e-4, 0.05)
"""Envelope as a share of the bounding box's diagonal outside of which fTetWild crashes or does not return."""

FACTOR_LIMITS = (0.015, 0.5)
"""The same for the target edge."""

_MOST_SLACK = 1.5
"""How much of the envelope times the area the volume may differ by; the envelope is a bound on distance, not volume."""


class TetrahedraliseParams(Params):
    """Parameters of `tetrahedralise`: `edge_length` or `cells`, one of them."""

    edge_length: Millimetres | None = Field(default=None, gt=0.0)
    """Mean edge length of the cells, met within 15 %; about the distance from pore to pore."""

    cells: int | None = Field(default=None, ge=1)
    """Number of cells instead of an edge length, met within 15 %."""

    envelope: Millimetres | None = Field(default=None, gt=0.0)
    """How far the mesh may lie off the surface; by default a tenth of the edge length, so that cells come out even, and
    more where that keeps cells too small. The solid is cut to the exact surface all the same."""

    time_limit: float = Field(default=1800.0, gt=0.0)
    """Seconds after which an attempt is given up."""

    @model_validator(mode="after")
    def _one_size(self) -> TetrahedraliseParams:
        if (self.edge_length is None) == (self.cells is None):
            raise ValueError("give either edge_length or cells")
        return self


@stage(writes="mesh", version=1)
def tetrahedralise(outer: OuterShape, *, params: TetrahedraliseParams) -> VolumeMesh:
    """Fill the outer shape with tetrahedra whose mean edge is the one asked for.

    fTetWild cannot repeat itself: the result is stored, and a later run goes on from it. Raises `StageError` where
    no attempt meets the size within 15 %, or the mesher dies or does not return in time.
    """
    wanted = params.edge_length or _edge_for(outer.volume, params.cells or 1)
    diagonal = float(np.linalg.norm(np.ptp(outer.bounds, axis=0)))
    _require_edge_within(wanted, diagonal)
    envelope = float(np.clip(params.envelope or wanted / 10.0, LIMITS[0] * diagonal, LIMITS[1] * diagonal))
    target, tried = FIRST_TARGET * wanted, []
    for attempt in range(1, ATTEMPTS + 1):
        vertices, cells = _mesh(outer, target, envelope, params.time_limit)
        mesh = VolumeMesh(vertices, cells, facts={"attempts": attempt, "envelope": envelope})
        ratio = _size_ratio(mesh, wanted, params.cells)
        tried.append(ratio)
        if abs(ratio - 1.0) <= TOLERANCE:
            _require_volume(mesh, outer, envelope)
            return mesh
        target = float(np.clip(target / ratio, FACTOR_LIMITS[0] * diagonal, FACTOR_LIMITS[1] * diagonal))
        if params.envelope is None and ratio < 1.0:
            envelope = min(COARSER_ENVELOPE * envelope, LIMITS[1] * diagonal)
    sizes = ", ".join(f"{ratio:.2f}" for ratio in tried)
    raise StageError(
        f"{ATTEMPTS} attempts gave mean edges of {sizes} times the {wanted:.3g} mm asked for, none within 15 %; the "
        f"surface's details (envelope {envelope:.3g} mm) limit the size: raise envelope, or change edge_length"
    )


def _edge_for(volume: float, cells: int) -> float:
    return float((volume / (cells * EDGE_CELL_VOLUME)) ** (1.0 / 3.0))


def _require_edge_within(edge: float, diagonal: float) -> None:
    least, greatest = (factor * diagonal for factor in FACTOR_LIMITS)
    if not least <= edge <= greatest:
        raise StageError(
            f"edge_length {edge:.3g} mm (asked for, or following from cells): must be from {least:.3g} to {greatest:.3g} "
            f"mm for a shape {diagonal:.4g} mm across its diagonal; fTetWild does not return outside of that"
        )


def _size_ratio(mesh: VolumeMesh, wanted: float, cells: int | None) -> float:
    """Return the size got over the size asked for, as a ratio of lengths or, for a count, within its own tolerance."""
    if cells is not None:
        count_ratio = len(mesh.tetrahedra) / cells
        return 1.0 if abs(count_ratio - 1.0) <= TOLERANCE else count_ratio ** (-1.0 / 3.0)
    ends = mesh.vertices[mesh.edges]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean() / wanted)


def _require_volume(mesh: VolumeMesh, outer: OuterShape, envelope: float) -> None:
    allowed = _MOST_SLACK * envelope * outer.area
    if abs(mesh.volume - outer.volume) > allowed:
        raise StageError(
            f"the cells fill {mesh.volume:.6g} mm^3 of an outer shape of {outer.volume:.6g} mm^3; an envelope of "
            f"{envelope:.3g} mm explains {allowed:.3g} mm^3 of difference; check the surface, or lower envelope"
        )


def _mesh(outer: OuterShape, target: float, envelope: float, seconds: float) -> tuple[Floats, Ints]:
    centre = outer.bounds.mean(axis=0)
    answer = call_in_child(
        run_ftetwild,
        {"vertices": outer.vertices - centre, "faces": outer.faces},
        {"edge_length": target, "envelope": envelope},
        seconds=seconds,
        about=f"outer shape of {len(outer.faces)} triangles, target edge {target:.3g} mm; raise edge_length or envelope",
    )
    return answer["vertices"] + centre, answer["cells"]


def run_ftetwild(vertices: Floats, faces: Ints, edge_length: float, envelope: float) -> Arrays:
    """Return positively oriented tetrahedra of a surface near the origin: `vertices` (n, 3), `cells` (m, 4).

    Runs in a child process: pytetwild crashes or hangs on bad input and writes into the working directory.
    """
    import pytetwild

    points, cells = pytetwild.tetrahedralize(
        vertices,
        faces.astype(np.int32),
        edge_length_abs=edge_length,
        epsilon=envelope / float(np.linalg.norm(np.ptp(vertices, axis=0))),
        num_threads=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        vtk_ordering=True,
    )
    if not len(cells):
        raise StageError("fTetWild returned no cell: the shape is flat, or thinner than the envelope")
    cells = np.asarray(cells, np.int64)
    cells = cells[np.abs(cell_volumes(points, cells, "tetrahedron")) > 0.0]
    used, compact = np.unique(cells, return_inverse=True)
    cells = compact.reshape(cells.shape)
    inverted = cell_volumes(points[used], cells, "tetrahedron") < 0.0
    cells[inverted] = cells[inverted][:, [0, 2, 1, 3]]
    return {"vertices": points[used], "cells": cells}
