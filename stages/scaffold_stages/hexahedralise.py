"""Stage `hexahedralise`: fill the outer shape with hexahedra, as cubes along the axes or fitted to its surface."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.volumes import cells, lattices
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_geometry.volumes.hexahedra import fitting
from scaffold_geometry.volumes.hexahedra.overlaps import find_overlapping_cubes
from scaffold_geometry.voxels.grids import grid_over
from scaffold_pipeline.artifacts import Fact, OuterShape, VolumeMesh
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.memory import available_memory
from scaffold_pipeline.stages.contract import Millimetres, Params, stage

_BYTES_PER_CUBE, _BYTES_PER_CELL = 80, 2000
"""Memory per cube of the bounding box and per cell of the mesh (a heel bone with 28,000 cells took 1,230 per cell)."""

_ON_SURFACE = 1e-6
"""Distance from the surface, in cell sizes, up to which a vertex counts as on the surface."""

_WELL_FILLED = 0.95
"""Least share of the shape's volume that a fitted mesh of sufficiently small cells fills."""


class HexahedraliseParams(Params):
    """Parameters of `hexahedralise`."""

    cell_size: Millimetres = Field(gt=0.0)
    """Edge length of the cubes, roughly the distance between pore centres; smaller near the surface with `fitted`."""

    kind: Literal["grid", "fitted"] = "fitted"
    """`grid`: all whole cubes along the axes that overlap the shape; `fitted`: the mesh ends on the surface."""


@stage(writes="mesh", version=2)
def hexahedralise(outer: OuterShape, *, params: HexahedraliseParams) -> VolumeMesh:
    """Fill the outer shape with hexahedra: whole cubes along the axes, or a mesh fitted to its surface.

    A fitted mesh has no inverted cell: the Jacobian is positive at every corner. A boundary vertex that cannot reach
    the surface without inverting a cell stays off it and is counted. Parts thinner than a cell may be left out. The
    same shape gives the same mesh, a mirrored shape its mirror image. Raises `StageError` if cells are larger than the
    shape, or too many for the memory.
    """
    _require_size(outer, params.cell_size)
    if params.kind == "grid":
        return _cubes(outer, params.cell_size)
    fitted = fitting.fit_hexahedra(outer.vertices, outer.faces, params.cell_size)
    if fitted is None:
        raise StageError(
            f"cell_size {params.cell_size:g} mm: no cell fits into the outer shape of {_extent(outer)} mm; lower it"
        )
    vertices, hexahedra, inner = fitted
    facts = _facts(outer, vertices, hexahedra)
    facts |= _fit(outer, vertices, hexahedra, inner, params.cell_size)
    _warn_of_gaps(facts, outer)
    return VolumeMesh(vertices, hexahedra=hexahedra, facts=facts)


def _extent(outer: OuterShape) -> str:
    return " x ".join(f"{length:.4g}" for length in np.ptp(outer.bounds, axis=0))


def _require_size(outer: OuterShape, size: float) -> None:
    if size > np.ptp(outer.bounds, axis=0).max():
        raise StageError(f"cell_size {size:g} mm: larger than the outer shape of {_extent(outer)} mm; lower it")
    needed, free = _estimate_memory(outer, size), available_memory()
    if needed > free:
        fitting_size = size
        while _estimate_memory(outer, fitting_size) > free:
            fitting_size = float(f"{1.1 * fitting_size:.2g}")
        raise StageError(
            f"cell_size {size:g} mm: the cells need {needed / 2**30:.1f} GiB, but {free / 2**30:.1f} GiB are free; "
            f"use {fitting_size:g} mm or more"
        )


def _estimate_memory(outer: OuterShape, size: float) -> float:
    """Return the bytes that cells of `size` mm need: for the cubes of the bounding box, and for those in the shape."""
    counts: list[float] = (np.ptp(outer.bounds, axis=0) / size + 5.0).tolist()
    # The stepped surface of a plane has at most 1.73 times its area, and one cell per square.
    number = outer.volume / size**3 + 2.0 * outer.area / size**2
    return math.prod(counts) * _BYTES_PER_CUBE + number * _BYTES_PER_CELL


def _cubes(outer: OuterShape, size: float) -> VolumeMesh:
    origin, samples = grid_over(outer.bounds, size, 0)
    shape = (samples[0] - 1, samples[1] - 1, samples[2] - 1)
    overlapping = find_overlapping_cubes(outer.vertices, outer.faces, origin, size, shape)
    lattice, hexahedra = lattices.on_lattice(np.argwhere(overlapping), lattices.HEXAHEDRON)
    vertices = origin + size * lattice
    return VolumeMesh(vertices, hexahedra=hexahedra, facts=_facts(outer, vertices, hexahedra))


def _facts(outer: OuterShape, vertices: Floats, hexahedra: Ints) -> dict[str, Fact]:
    """Return the facts of both kinds: the number of face-connected pieces, and the volume as a share of the shape's."""
    kind = {"hexahedron": hexahedra}
    pieces = cells.pieces(cells.faces(kind).neighbours, len(hexahedra))
    filled = float(cells.volumes(vertices, kind).sum()) / outer.volume
    return {"hexahedra": len(hexahedra), "pieces": int(pieces.max()) + 1, "volume_share": filled}


def _fit(outer: OuterShape, vertices: Floats, hexahedra: Ints, inner: int, size: float) -> dict[str, Fact]:
    """Return the quality of the cells, and the distances from their boundary to the surface and back."""
    from scaffold_geometry.volumes.hexahedra.quality import least_jacobians

    quality = least_jacobians(vertices, hexahedra)
    boundary = vertices[inner:]
    off = np.linalg.norm(boundary - fitting.nearest(boundary, (outer.vertices, outer.faces)), axis=1)
    skin, _ = boundary_triangles(vertices, cells.faces({"hexahedron": hexahedra}))
    left_out = np.linalg.norm(outer.vertices - fitting.nearest(outer.vertices, (vertices, skin)), axis=1)
    return {
        "least_scaled_jacobian": float(quality.min()),
        "mean_scaled_jacobian": float(quality.mean()),
        "boundary_vertices": len(boundary),
        "vertices_off_surface": int((off > _ON_SURFACE * size).sum()),
        "farthest_off_surface": float(off.max()),
        "farthest_left_out": float(left_out.max()),
    }


def _warn_of_gaps(facts: dict[str, Fact], outer: OuterShape) -> None:
    """Warn if the mesh misses parts of the shape, or is in more pieces than the shape."""
    bodies = triangles.piece_volumes(outer.vertices, outer.faces, triangles.face_pieces(outer.faces))
    pieces, share = int(str(facts["pieces"])), float(str(facts["volume_share"]))
    faults = []
    if share < _WELL_FILLED:
        faults.append(f"fill {share:.1%} of the outer shape's volume")
    if pieces > (bodies > 0.0).sum():
        faults.append(f"are in {pieces} pieces")
    if faults:
        warn(
            f"the hexahedra {' and '.join(faults)}: they leave out parts that are thinner or more curved than a cell; "
            "lower cell_size, or set `kind: grid`"
        )
