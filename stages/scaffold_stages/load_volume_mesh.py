"""Stage `load_volume_mesh`: read a mesh of solid cells, and require that it is valid."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Bools, Floats
from scaffold_geometry.files.inputs import require_near_origin, warn_of_odd_size
from scaffold_geometry.files.surfaces.reading import MILLIMETRES
from scaffold_geometry.files.volumes.reading import VolumeFile, read_volume
from scaffold_geometry.volumes import boundary, cells
from scaffold_geometry.volumes.cells import Cells, Faces
from scaffold_pipeline.artifacts import Fact, VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import InputFile, Params, Unit, stage

_REPAIR = "repair the mesh in another program, or load its surface and use tetrahedralise"
_WORTH_A_WARNING = 0.1
"""Share of the kept volume above which a dropped piece is reported, as it is hardly debris."""
_SAME_PLACE = 1e-6
"""Share of the diagonal within which two vertices are taken as one: float32 has 1e-7."""
_WRONG_ORDER = 0.5
"""Share of cells with crossed faces above which the order of corners is wrong; below, `_warn_of_folds` reports the
cells as deformed: a crushed can had 27 of 4,800."""
_AGREEMENT = 1e-6
"""Greatest relative difference of the volumes of cells and boundary; valid meshes agree to 1e-13."""


class LoadVolumeMeshParams(Params):
    """Parameters of `load_volume_mesh`."""

    path: InputFile
    """The volume mesh: VTU, legacy VTK, Gmsh MSH 1, 2 or 4, MEDIT (.mesh) or Abaqus (.inp)."""

    units: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of lengths in the file; required, as none of these formats states it."""

    component: Literal["largest", "all"] = Field(default="largest")
    """Which of the mesh's separate pieces to keep; cells that share a face are connected."""

    merge: Annotated[float | None, Unit("mm")] = Field(default=None, ge=0.0)
    """Distance up to which vertices are merged, to close cracks between cells; by default cracks are only reported."""


@stage(writes="mesh", version=2)
def load_volume_mesh(*, params: LoadVolumeMeshParams) -> VolumeMesh:
    """Read tetrahedra, hexahedra, wedges and pyramids in mm, reorient inverted cells, and check the mesh.

    Cells of higher order are reduced to their corners; duplicate and flat cells are removed and counted in the notes.
    Raises `StageError` for an unreadable file, an unknown unit, cells of other kinds, and cells that overlap or do not
    meet face to face. `extract_outer` makes the outer shape of the mesh.
    """
    name = params.path.name
    content = read_volume(params.path)
    scale, unit_note = _scale_to_mm(content, params.units, name)
    notes = [*content.notes, unit_note]
    vertices, kept = _drop_unused(content.vertices * scale, content.cells, notes)
    _require_sound_places(vertices, name)
    vertices, kept = _merge(vertices, kept, params.merge, notes)
    kept, turned = _clean(vertices, kept, name, notes)
    faces = cells.faces(kept)
    _require_faces_match(vertices, kept, faces, name)
    _warn_of_cracks(vertices, faces, name, notes)
    kept = _chosen(vertices, kept, faces, params, notes)
    vertices, kept = cells.drop_unused_vertices(vertices, kept)
    _require_agreement(vertices, kept, name)
    folded = cells.count_folded_cells(vertices, kept)
    warn_of_odd_size(vertices, name)
    _warn_of_folds(folded, cells.count(kept), name)
    by_name = {CELL_TYPES[kind].plural: corners for kind, corners in kept.items()}
    facts: dict[str, Fact] = {
        **{plural: len(corners) for plural, corners in by_name.items()},
        "cells_turned": turned,
        "cells_folded": folded,
        "notes": "; ".join(notes),
    }
    facts |= {"space": content.space} if content.space else {}
    return VolumeMesh(vertices, facts=facts, **by_name)


def _scale_to_mm(content: VolumeFile, units: str | None, name: str) -> tuple[float, str]:
    """Return the length of the file's unit, mm, and a note of it."""
    corners = np.concatenate([np.unique(of_kind) for of_kind in content.cells.values()])
    size = " x ".join(f"{length:.4g}" for length in np.ptp(content.vertices[corners], axis=0))
    if units is None:
        raise StageError(
            f"{name}: the file does not state its unit; set `units` to mm, cm, m or inch "
            f"(the mesh measures {size} in the file)"
        )
    return MILLIMETRES[units], f"unit {units} (given), size {size} {units}"


def _note(notes: list[str], number: int, text: str) -> None:
    if number:
        notes.append(text.format(number))


def _drop_unused(vertices: Floats, given: Cells, notes: list[str]) -> tuple[Floats, Cells]:
    """Remove the vertices that are not corners of a cell."""
    used, kept = cells.drop_unused_vertices(vertices, given)
    _note(notes, len(vertices) - len(used), "dropped {} points that are no corner of a cell")
    return used, kept


def _require_sound_places(vertices: Floats, name: str) -> None:
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise StageError(f"{name}: {bad} of {len(vertices)} vertices are NaN or infinite; {_REPAIR}")
    require_near_origin(vertices, name)


def _merge(vertices: Floats, given: Cells, distance: float | None, notes: list[str]) -> tuple[Floats, Cells]:
    if distance is None:
        return vertices, given
    joined, kept = cells.drop_unused_vertices(vertices, cells.merge_vertices(vertices, given, distance))
    _note(notes, len(vertices) - len(joined), f"merged {{}} vertices within {distance:g} mm of another")
    return joined, kept


def _clean(vertices: Floats, given: Cells, name: str, notes: list[str]) -> tuple[Cells, int]:
    """Remove duplicate and flat cells and reorient inverted ones; return the cells and the number reoriented."""
    collapsed = int(cells.duplicate_vertex_cells(given).sum())
    if collapsed:
        raise StageError(
            f"{name}: {collapsed} of {cells.count(given)} cells use a vertex twice (hexahedra that stand for wedges, "
            "or a `merge` wider than a cell); write them as the cells that they are, or lower merge"
        )
    crossed = int(cells.self_crossing_cells(vertices, given).sum())
    if crossed > _WRONG_ORDER * cells.count(given):
        raise StageError(
            f"{name}: {crossed} of {cells.count(given)} cells have a face whose sides cross: their corners are not in "
            f"the order of the file's format; {_REPAIR}"
        )
    kept = _without(given, cells.duplicate_cells(given), "dropped {} cells with the corners of another", notes)
    kept = _without(kept, cells.flat_cells(vertices, kept), "dropped {} cells without volume", notes)
    if not kept:
        raise StageError(f"{name}: no cell has a volume; is the mesh flat? {_REPAIR} [{'; '.join(notes)}]")
    kept, turned = cells.reorient_cells(vertices, kept)
    _note(notes, turned, "turned {} cells of negative volume")
    return kept, turned


def _without(given: Cells, bad: Bools, text: str, notes: list[str]) -> Cells:
    _note(notes, int(bad.sum()), text)
    return cells.select_cells(given, ~bad)


def _require_faces_match(vertices: Floats, kept: Cells, faces: Faces, name: str) -> None:
    """Require that cells do not overlap: at most two at a face, one on each side."""
    bad = np.unique(np.concatenate([faces.clashing.ravel(), faces.crowded]))
    if len(bad):
        only = np.zeros(cells.count(kept), dtype=bool)
        only[bad[0]] = True
        (corners,) = cells.select_cells(kept, only).values()
        at = vertices[corners[0]].mean(axis=0)
        raise StageError(
            f"{name}: cells overlap: {len(faces.clashing)} pairs are on the same side of the face that they share (one "
            f"of them is inverted) and {len(faces.crowded)} cells are at a face of more than two; one of these "
            f"{len(bad)} cells is at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm; {_REPAIR}"
        )


def _warn_of_cracks(vertices: Floats, faces: Faces, name: str, notes: list[str]) -> None:
    """Warn of coincident vertices of the boundary: cells that touch there, but are not connected."""
    on_boundary = vertices[np.unique(np.concatenate([faces.triangles.ravel(), faces.quadrangles.ravel()]))]
    distance = _SAME_PLACE * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    double = cells.count_coincident_points(on_boundary, distance)
    if double:
        message = f"{double} vertices of the boundary lie within {distance:.2g} mm of another"
        notes.append(message)
        warn(f"{name}: {message}: cells are not connected there; set `merge: {distance:.2g}` to connect them")


def _chosen(vertices: Floats, given: Cells, faces: Faces, params: LoadVolumeMeshParams, notes: list[str]) -> Cells:
    """Keep the largest piece, or all if requested."""
    pieces = cells.pieces(faces.neighbours, cells.count(given))
    volumes = np.bincount(pieces, weights=cells.volumes(vertices, given))
    if params.component == "all" or len(volumes) == 1:
        _note(notes, len(volumes) if len(volumes) > 1 else 0, "kept all of {} pieces")
        return given
    order = np.argsort(-volumes, kind="stable")
    largest, next_one = volumes[order[:2]]
    kept = pieces == order[0]
    notes.append(
        f"kept the largest of {len(volumes)} pieces ({largest:.6g} mm^3) and dropped {len(volumes) - 1} "
        f"({int((~kept).sum())} cells, the greatest {next_one:.6g} mm^3)"
    )
    if next_one > _WORTH_A_WARNING * largest:
        warn(
            f"{params.path.name}: dropped a piece of {next_one:.6g} mm^3; the largest, kept, has {largest:.6g} mm^3 "
            "(cells that share a face are connected); set `component: all` to keep every piece"
        )
    return cells.select_cells(given, kept)


def _require_agreement(vertices: Floats, kept: Cells, name: str) -> None:
    """Require that the boundary encloses the volume of the cells."""
    filled = float(cells.volumes(vertices, kept).sum())
    enclosed = boundary.enclosed_volume(vertices, cells.faces(kept))
    if abs(enclosed - filled) > _AGREEMENT * filled:
        raise StageError(
            f"{name}: the cells fill {filled:.8g} mm^3, but their boundary encloses {enclosed:.8g} mm^3: cells overlap "
            f"or do not meet face to face; {_REPAIR}"
        )


def _warn_of_folds(folded: int, number: int, name: str) -> None:
    if folded:
        warn(
            f"{name}: {folded} of {number} cells are folded: a part of each is not visible from its centre, and "
            "channels may leave the cell there"
        )
