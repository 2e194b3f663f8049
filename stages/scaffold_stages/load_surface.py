"""Stage `load_surface`: read an anatomical surface, and require that it bounds a solid."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_geometry.files.inputs import require_near_origin, warn_of_odd_size
from scaffold_geometry.files.surfaces import reading
from scaffold_geometry.surfaces.repair.log import METRICS as REPAIR_METRICS
from scaffold_geometry.surfaces.repair.outer_shape import RepairRules, make_outer_shape
from scaffold_geometry.surfaces.triangles import size_in_words
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import InputFile, Millimetres, Params, stage

if TYPE_CHECKING:
    from scaffold_geometry.files.surfaces.reading import SurfaceFile


class LoadSurfaceParams(Params):
    """Parameters of `load_surface`."""

    path: InputFile
    """The surface: STL, OBJ, PLY, OFF, 3MF, GLB, glTF, VTP or legacy VTK."""

    units: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of lengths in the file; required unless the file states it (3MF; GLB is in metres)."""

    up: Literal["y", "z"] | None = None
    """Up axis of the file; y is turned to z. By default y for GLB and glTF, as these formats define, and z for all
    other formats."""

    component: Literal["largest", "all"] = Field(default="largest")
    """Which of the surface's separate pieces to keep; `all` also keeps cavities."""

    repair: Literal["none", "safe", "rebuild"] = Field(default="safe")
    """`safe` closes cracks, fills holes of up to 600 edges, removes duplicate and flat triangles, fins and internal
    walls, and splits the surface where it touches itself; `rebuild` also makes a new surface around the enclosed space,
    if the surface intersects itself or is torn; `none` only merges exact duplicates."""

    tolerance: Millimetres | None = Field(default=None, gt=0.0)
    """Greatest distance by which a repair may move the surface, including the distance of a filled hole's middle from
    its rim; by default 1 % of the diagonal."""


@stage(writes="outer", version=4, metrics=REPAIR_METRICS)
def load_surface(*, params: LoadSurfaceParams) -> OuterShape:
    """Read a surface in mm, repair it, orient it outward, and require that it bounds a solid.

    The notes and facts list the repairs and how far they moved the surface; a sound surface is not changed. Raises
    `StageError` for an unreadable file, an unknown unit, a repair that moves the surface by more than `tolerance`, and
    a surface that still is open, non-manifold, one-sided, flat or self-intersecting.
    """
    name = params.path.name
    content = reading.read_surface(params.path)
    scale, unit_note = _scale_to_mm(content, params.units, name)
    vertices, notes = _turn_up(content.vertices * scale, content, params)
    require_near_origin(vertices, name)
    rules = RepairRules(name, params.component, params.repair, params.tolerance)
    outer = make_outer_shape(vertices, content.faces, rules, [*content.notes, unit_note, *notes])
    warn_of_odd_size(outer.vertices, name)
    return replace(outer, facts={**outer.facts, "space": content.space}) if content.space else outer


def _scale_to_mm(content: SurfaceFile, units: str | None, name: str) -> tuple[float, str]:
    """Return the length of the file's unit, mm, and a note of its source."""
    known = reading.MILLIMETRES
    size = size_in_words(content.vertices, content.faces)
    if units is None and content.unit not in known:
        raise StageError(
            f"{name}: the file does not state its unit; set `units` to mm, cm, m or inch "
            f"(the surface measures {size} in the file)"
        )
    if units is not None and content.unit in known and content.unit != units:
        warn(f"{name}: the file's unit is {content.unit}, but `units` is {units}: {units} is used")
    unit = units or content.unit or ""
    return known[unit], f"unit {unit} ({'given' if units else 'from the file'}), size {size} {unit}"


def _turn_up(vertices: Floats, content: SurfaceFile, params: LoadSurfaceParams) -> tuple[Floats, list[str]]:
    """Return vertices with z up, and a note if they were turned."""
    if (params.up or content.up) == "z":
        return vertices, []
    note = f"turned so that y, which points up in the file{'' if params.up else ' by its format'}, is z"
    return reading.turn_up(vertices), [note]
