"""`load_surface`: read an anatomical surface, and let nothing pass that does not bound a solid."""

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
    """What a length of 1 in the file means; required unless the file says it (3MF; GLB is in metres)."""

    up: Literal["y", "z"] | None = None
    """Which axis of the file points up; y is turned to z. Left out, y for GLB and glTF, as they define it,
    and z for all else."""

    component: Literal["largest", "all"] = Field(default="largest")
    """Which of the surface's separate pieces to keep; `all` keeps cavities, too."""

    repair: Literal["none", "safe", "rebuild"] = Field(default="safe")
    """`safe` mends cracks, fills holes of up to 600 edges, drops what is double, flat or bounds nothing, and parts what
    only touches; `rebuild` makes the surface anew around what it winds about, where it crosses itself or is torn;
    `none` drops exact doubles and refuses all else."""

    tolerance: Millimetres | None = Field(default=None, gt=0.0)
    """How far a repair may move the surface, which includes how far the middle of a filled hole lies from its rim; left
    out, 1 % of the diagonal."""


@stage(writes="outer", version=4, metrics=REPAIR_METRICS)
def load_surface(*, params: LoadSurfaceParams) -> OuterShape:
    """Read a surface in mm, repair it, turn it outward, and refuse what does not bound a solid.

    What was done and how far it moved the surface is told in the notes and, by number, in the facts; a sound surface
    stays as it is. A `StageError` tells of an unreadable file, an unknown unit, a repair that moves more than
    `tolerance`, and of a surface that still is open, non-manifold, one-sided, flat or passes through itself.
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
    """Return the mm of one file unit, and a note of where the unit is from."""
    known = reading.MILLIMETRES
    size = size_in_words(content.vertices, content.faces)
    if units is None and content.unit not in known:
        raise StageError(
            f"{name}: the file does not say its unit; set `units` to mm, cm, m or inch "
            f"(the surface measures {size} in the file)"
        )
    if units is not None and content.unit in known and content.unit != units:
        warn(f"{name}: the file says its unit is {content.unit}, `units` says {units}: taken as {units}")
    unit = units or content.unit or ""
    return known[unit], f"unit {unit} ({'given' if units else 'from the file'}), size {size} {unit}"


def _turn_up(vertices: Floats, content: SurfaceFile, params: LoadSurfaceParams) -> tuple[Floats, list[str]]:
    """Return vertices whose z axis points up, and a note where they were turned."""
    if (params.up or content.up) == "z":
        return vertices, []
    note = f"turned so that y, which points up in the file{'' if params.up else ' by its format'}, is z"
    return reading.turn_up(vertices), [note]
