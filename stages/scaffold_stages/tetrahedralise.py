"""Stage `tetrahedralise`: the outer shape filled with tetrahedra of one size, by fTetWild.

Hu, Schneider, Wang, Zorin, Panozzo, "Fast tetrahedral meshing in the wild", ACM Transactions on Graphics 39 (2020).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.volumes.ftetwild import run_ftetwild
from scaffold_pipeline.artifacts import Fact, OuterShape, VolumeMesh
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import call_in_child
from scaffold_pipeline.stages.contract import Millimetres, Params, Unit, stage

TOLERANCE = 0.15
"""How far the mean edge, or the number of cells, may be from what was asked for."""

ATTEMPTS = 8
"""fTetWild takes a target, not a promise. On bones and cartilage one or two attempts met the tolerance; simple shapes
of a few hundred cells, two meshes of which can differ by a third, took up to five, rarely more."""

FIRST_TARGET = 1.08
"""First target edge, in edges asked for: on bones the mean edge came out at 0.89 to 0.98 of the target."""

GREATEST_GROWTH = 1.7
"""Greatest growth of the envelope from one attempt to the next, see `_next_size`."""

EDGE_CELL_VOLUME = 0.109
"""Volume of a mean cell in cubes of the mean edge (a regular tetrahedron has 0.118)."""

LIMITS = (2e-4, 0.05)
"""Envelope as a share of the bounding box's diagonal outside of which fTetWild crashes or does not return."""

FACTOR_LIMITS = (0.015, 0.5)
"""The same for the target edge."""

_TURN = (0.4, 0.7, 0.3)
"""Axis times angle of the turn, see `_mesh`: any that brings no axis near another."""

_MOST_SLACK = 0.5
"""How much of the envelope times the area the volume may differ by: it was 0.04 to 0.15 on bones, as the mesh lies on
either side of the surface."""


class TetrahedraliseParams(Params):
    """Parameters of `tetrahedralise`: `edge_length` or `cells`, one of them."""

    edge_length: Millimetres | None = Field(default=None, gt=0.0)
    """Mean edge length of the cells, met within 15 %; about the distance from pore to pore."""

    cells: int | None = Field(default=None, ge=1)
    """Number of cells instead of an edge length, met within 15 %."""

    envelope: Millimetres | None = Field(default=None, gt=0.0)
    """How far the mesh may lie off the surface; by default a tenth of the edge length, so that cells come out even, and
    more where that keeps cells too small. The solid is cut to the exact surface all the same."""

    time_limit: Annotated[float, Unit("s")] = Field(default=1800.0, gt=0.0)
    """Time after which an attempt is given up."""

    @model_validator(mode="after")
    def _one_size(self) -> TetrahedraliseParams:
        if (self.edge_length is None) == (self.cells is None):
            raise ValueError("give either edge_length or cells")
        return self


@stage(writes="mesh", version=2, repeatable=False)
def tetrahedralise(outer: OuterShape, *, params: TetrahedraliseParams) -> VolumeMesh:
    """Fill the outer shape with tetrahedra whose mean edge is the one asked for.

    fTetWild cannot repeat itself: the result is stored, and a later run goes on from it. Raises `StageError` where
    no attempt meets the size within 15 %, or the mesher dies or does not return in time.
    """
    diagonal = float(np.linalg.norm(np.ptp(outer.bounds, axis=0)))
    wanted = params.edge_length or _edge_for(outer.volume, params.cells or 1)
    _require_edge_within(wanted, diagonal)
    size = _first_size(wanted, params.envelope, diagonal)
    tried: list[_Tried] = []
    while len(tried) < ATTEMPTS:
        vertices, cells = _mesh(outer, size, params.time_limit)
        facts: dict[str, Fact] = {"attempts": len(tried) + 1, "envelope": size.envelope}
        mesh = VolumeMesh(vertices, cells, facts=facts)
        ratio, off = _edge_ratio(mesh, wanted, params.cells)
        if off <= TOLERANCE:
            _require_volume(mesh, outer, size.envelope)
            return mesh
        tried.append(_Tried(size, ratio, f"{len(cells)} cells" if params.cells else f"{ratio * wanted:.3g} mm"))
        size = _next_size(tried, diagonal, may_coarsen=params.envelope is None)
    got = ", ".join(attempt.got for attempt in tried)
    asked = f"cells {params.cells}" if params.cells else f"edge_length {wanted:.3g} mm"
    raise StageError(f"{asked}: {ATTEMPTS} attempts gave {got}, none within 15 %; {_reason(outer, wanted, size)}")


@dataclass(frozen=True)
class _Size:
    """What fTetWild is asked for, mm: the target edge and how far the mesh may lie off the surface."""

    target: float
    envelope: float


def _reason(outer: OuterShape, wanted: float, size: _Size) -> str:
    """Say why no size was met, and what to do: twice the volume over the area is the thickness of a plate."""
    thickness = 2.0 * outer.volume / outer.area
    if thickness < wanted:
        return (
            f"the shape is about {thickness:.3g} mm thick, less than an edge of {wanted:.3g} mm: ask for smaller cells"
        )
    return (
        f"the surface's details (envelope {size.envelope:.3g} mm) limit the size: raise envelope, or ask for another "
        "size"
    )


def _first_size(wanted: float, envelope: float | None, diagonal: float) -> _Size:
    least, greatest = (share * diagonal for share in LIMITS)
    if envelope is not None and not least <= envelope <= greatest:
        raise StageError(
            f"envelope {envelope:.3g} mm: must be from {least:.3g} to {greatest:.3g} mm for a shape {diagonal:.4g} mm "
            "across its diagonal; fTetWild crashes or does not return outside of that"
        )
    target = min(FIRST_TARGET * wanted, FACTOR_LIMITS[1] * diagonal)
    return _Size(target, envelope or float(np.clip(wanted / 10.0, least, greatest)))


@dataclass(frozen=True)
class _Tried:
    """An attempt: its size, the mean edge got over the one asked for, and what was got, in words."""

    size: _Size
    ratio: float
    got: str


def _next_size(tried: list[_Tried], diagonal: float, *, may_coarsen: bool) -> _Size:
    """Correct the last target by what it gave; between attempts on either side of what is wanted, interpolate.

    Details of the surface hold the size of cells down whatever the target: on the heel bone at 8 mm, with an envelope
    of a tenth, targets of 8 and 10.4 mm gave mean edges of 6.5 and 6.9 mm; with an envelope half as wide again, 8.0 mm.
    So a mesh of too small cells may leave the surface more.
    """
    last = tried[-1]
    small = next((attempt for attempt in reversed(tried) if attempt.ratio < 1.0), None)
    large = next((attempt for attempt in reversed(tried) if attempt.ratio >= 1.0), None)
    if small and large:
        is_repeated = (tried[-2].ratio < 1.0) == (last.ratio < 1.0)
        share = 0.5 if is_repeated else float(np.log(small.ratio) / np.log(small.ratio / large.ratio))
        return _Size(
            small.size.target * (large.size.target / small.size.target) ** share,
            small.size.envelope * (large.size.envelope / small.size.envelope) ** share,
        )
    least, greatest = (factor * diagonal for factor in FACTOR_LIMITS)
    growth = float(np.clip(last.ratio**-2.0, 1.0, GREATEST_GROWTH)) if may_coarsen else 1.0
    envelope = max(min(growth * last.size.envelope, LIMITS[1] * diagonal), last.size.envelope)
    return _Size(float(np.clip(last.size.target / last.ratio, least, greatest)), envelope)


def _edge_for(volume: float, cells: int) -> float:
    return float((volume / (cells * EDGE_CELL_VOLUME)) ** (1.0 / 3.0))


def _require_edge_within(edge: float, diagonal: float) -> None:
    least, greatest = (factor * diagonal for factor in FACTOR_LIMITS)
    if not least <= edge <= greatest:
        raise StageError(
            f"edge_length {edge:.3g} mm (given, or following from cells): must be from {least:.3g} to {greatest:.3g} "
            f"mm for a shape {diagonal:.4g} mm across its diagonal; fTetWild does not return outside of that"
        )


def _edge_ratio(mesh: VolumeMesh, wanted: float, cells: int | None) -> tuple[float, float]:
    """Return the mean edge got over the one asked for, and how far the edge, or the number of cells, is off."""
    if cells is not None:
        got = len(mesh.tetrahedra) / cells
        return got ** (-1.0 / 3.0), abs(got - 1.0)
    ends = mesh.vertices[mesh.edges]
    ratio = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean() / wanted)
    return ratio, abs(ratio - 1.0)


def _require_volume(mesh: VolumeMesh, outer: OuterShape, envelope: float) -> None:
    allowed = _MOST_SLACK * envelope * outer.area
    if abs(mesh.volume - outer.volume) > allowed:
        raise StageError(
            f"the cells fill {mesh.volume:.6g} mm^3 of an outer shape of {outer.volume:.6g} mm^3; an envelope of "
            f"{envelope:.3g} mm explains {allowed:.3g} mm^3 of difference; check the surface, or lower envelope"
        )


def _mesh(outer: OuterShape, size: _Size, seconds: float) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and tetrahedra (m, 4): meshed about the origin, and turned off the axes.

    fTetWild starts from a lattice along the axes, and fits cells into a box by whole numbers of layers: targets of 1.7,
    2.0 and 2.2 mm gave 1,200, 2,100 and 800 cells; turned, 900, 680 and 500.
    """
    from scipy.spatial.transform import Rotation

    centre, turn = outer.bounds.mean(axis=0), Rotation.from_rotvec(_TURN).as_matrix()
    about = f"outer shape of {len(outer.faces)} triangles, target edge {size.target:.3g} mm"
    answer = call_in_child(
        run_ftetwild,
        {"vertices": (outer.vertices - centre) @ turn, "faces": outer.faces},
        asdict(size),
        seconds=seconds,
        about=f"{about}; where it died or took too long, raise edge_length or envelope",
    )
    return answer["vertices"] @ turn.T + centre, answer["cells"]
