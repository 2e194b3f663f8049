"""Stage `tetrahedralise`: fill the outer shape with tetrahedra of uniform size, by fTetWild.

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
"""Greatest relative difference between the requested and the actual mean edge length, or number of cells."""

ATTEMPTS = 8
"""fTetWild meets its target edge only roughly. On bones and cartilage one or two attempts met the tolerance; simple
shapes of a few hundred cells, where two meshes can differ by a third, took up to five, rarely more."""

FIRST_TARGET = 1.08
"""First target edge, in requested edge lengths: on bones the mean edge was 0.89 to 0.98 of the target."""

GREATEST_GROWTH = 1.7
"""Greatest factor on the envelope from one attempt to the next, see `_next_size`."""

EDGE_CELL_VOLUME = 0.109
"""Mean volume of a cell over the cubed mean edge length (a regular tetrahedron has 0.118)."""

LIMITS = (2e-4, 0.05)
"""Range of the envelope, as shares of the bounding box's diagonal; outside of it fTetWild crashes or never returns."""

FACTOR_LIMITS = (0.015, 0.5)
"""The same range for the target edge."""

_TURN = (0.4, 0.7, 0.3)
"""Rotation vector, see `_mesh`: any rotation that maps no axis close to another."""

_MOST_SLACK = 0.5
"""Greatest difference in volume over envelope x area: it was 0.04 to 0.15 on bones, as the mesh lies on both sides of
the surface."""


class TetrahedraliseParams(Params):
    """Parameters of `tetrahedralise`: either `edge_length` or `cells`."""

    edge_length: Millimetres | None = Field(default=None, gt=0.0)
    """Mean edge length of the cells, met within 15 %; roughly the distance between pore centres."""

    cells: int | None = Field(default=None, ge=1)
    """Number of cells, instead of an edge length; met within 15 %."""

    envelope: Millimetres | None = Field(default=None, gt=0.0)
    """Greatest distance between mesh and surface; by default a tenth of the edge length, for even cells, and more if
    cells stay too small. It does not affect the outer shape of the solid, which is cut to the exact surface."""

    time_limit: Annotated[float, Unit("s")] = Field(default=1800.0, gt=0.0)
    """Time limit of one attempt."""

    @model_validator(mode="after")
    def _one_size(self) -> TetrahedraliseParams:
        if (self.edge_length is None) == (self.cells is None):
            raise ValueError("give either edge_length or cells")
        return self


@stage(writes="mesh", version=2, repeatable=False)
def tetrahedralise(outer: OuterShape, *, params: TetrahedraliseParams) -> VolumeMesh:
    """Fill the outer shape with tetrahedra of a given mean edge length or number.

    fTetWild is not deterministic: the mesh is stored, and later runs use the stored mesh. Raises `StageError` if no
    attempt meets the size within 15 %, or if fTetWild crashes or exceeds the time limit.
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
    """fTetWild's parameters, mm: the target edge, and the greatest distance between mesh and surface."""

    target: float
    envelope: float


def _reason(outer: OuterShape, wanted: float, size: _Size) -> str:
    """Return the reason why the size was not met, and the remedy; 2 volume / area is the thickness of a plate."""
    thickness = 2.0 * outer.volume / outer.area
    if thickness < wanted:
        return f"the shape is about {thickness:.3g} mm thick, less than an edge of {wanted:.3g} mm: use smaller cells"
    return (
        f"the surface's details (envelope {size.envelope:.3g} mm) limit the size: raise envelope, or use a different "
        "size"
    )


def _first_size(wanted: float, envelope: float | None, diagonal: float) -> _Size:
    least, greatest = (share * diagonal for share in LIMITS)
    if envelope is not None and not least <= envelope <= greatest:
        raise StageError(
            f"envelope {envelope:.3g} mm: must be from {least:.3g} to {greatest:.3g} mm for a shape with a diagonal of "
            f"{diagonal:.4g} mm; outside of this range fTetWild crashes or never returns"
        )
    target = min(FIRST_TARGET * wanted, FACTOR_LIMITS[1] * diagonal)
    return _Size(target, envelope or float(np.clip(wanted / 10.0, least, greatest)))


@dataclass(frozen=True)
class _Tried:
    """An attempt: its size, the ratio of the actual to the requested mean edge, and its result as text."""

    size: _Size
    ratio: float
    got: str


def _next_size(tried: list[_Tried], diagonal: float, *, may_coarsen: bool) -> _Size:
    """Correct the last target by its result; interpolate between attempts that were too small and too large.

    Details of the surface limit the cell size whatever the target: on the heel bone at 8 mm, with an envelope of a
    tenth, targets of 8 and 10.4 mm gave mean edges of 6.5 and 6.9 mm; with an envelope 1.5 times as wide, 8.0 mm. So
    the envelope is widened if cells are too small.
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
            f"edge_length {edge:.3g} mm (given, or computed from cells): must be from {least:.3g} to {greatest:.3g} "
            f"mm for a shape with a diagonal of {diagonal:.4g} mm; outside of this range fTetWild never returns; "
            "use one within it, or see that the shape is in mm"
        )


def _edge_ratio(mesh: VolumeMesh, wanted: float, cells: int | None) -> tuple[float, float]:
    """Return the ratio of the actual to the requested mean edge, and the relative error of the edge or cell number."""
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
            f"volume of the cells: must be that of the outer shape, {outer.volume:.6g} mm^3, within {allowed:.3g} mm^3 "
            f"(envelope {envelope:.3g} mm), got {mesh.volume:.6g}; check the surface, or lower envelope"
        )


def _mesh(outer: OuterShape, size: _Size, seconds: float) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and tetrahedra (m, 4); the shape is meshed at the origin, and rotated off the axes.

    fTetWild starts from a lattice along the axes, and fills a box with whole numbers of layers: targets of 1.7, 2.0 and
    2.2 mm gave 1,200, 2,100 and 800 cells; rotated, 900, 680 and 500.
    """
    from scipy.spatial.transform import Rotation

    centre, turn = outer.bounds.mean(axis=0), Rotation.from_rotvec(_TURN).as_matrix()
    about = f"outer shape of {len(outer.faces)} triangles, target edge {size.target:.3g} mm"
    answer = call_in_child(
        run_ftetwild,
        {"vertices": (outer.vertices - centre) @ turn, "faces": outer.faces},
        asdict(size),
        seconds=seconds,
        about=f"{about}; after a crash or a time-out raise edge_length or envelope",
    )
    return answer["vertices"] @ turn.T + centre, answer["cells"]
