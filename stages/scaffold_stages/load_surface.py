"""`load_surface`: read an anatomical surface, and let nothing pass that does not bound a solid."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.inputs import require_near_origin, warn_of_odd_size
from scaffold_geometry.files.surfaces import reading
from scaffold_geometry.surfaces import self_intersections, triangles
from scaffold_geometry.surfaces.repair import displacement, mend, modes
from scaffold_geometry.surfaces.repair.log import DOUBLE, MERGED, TURNED, TWICE, RepairLog, RepairOp
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import call_in_child
from scaffold_pipeline.stages.contract import InputFile, Millimetres, Params, stage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scaffold_geometry.files.surfaces.reading import SurfaceFile
    from scaffold_geometry.surfaces.edges import Surface

_BY_HAND = "mend it, for instance in MeshLab or Blender, and load it again"
_REMEDIES = {
    "none": f"set `repair: safe` or `repair: rebuild`, or {_BY_HAND}",
    "safe": f"set `repair: rebuild`, or {_BY_HAND}",
    "rebuild": _BY_HAND,
}
_TOLERANCE = 0.01
"""Share of the diagonal by which a repair may move the surface unless told otherwise: in scans, a pinhole but not an
open end. Rebuilding alone, without a hole, moves it by a ten thousandth."""
_SAMPLES = 5.0
"""Samples to the tolerance, of the distance between what was read and what was made of it."""
_WORTH_A_WARNING = 0.1
"""A dropped piece of this share of the volume kept is hardly debris."""
_FLAT = 1e-9
"""Volume over area to the power 3/2 (0.09 for a ball) below which a closed surface bounds but a sheet."""

_FLATS = RepairOp("triangles_without_area_dropped", "dropped {} triangles without area")
_UNUSED = RepairOp("vertices_dropped", "dropped {} vertices that no triangle uses")
_ALL = RepairOp("pieces_kept", "kept all of {} pieces")
_CAVITIES = RepairOp("cavities", "{} pieces are cavities")
_WRONG_WAY = RepairOp("pieces_turned", "turned {} pieces that faced the wrong way")


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


@stage(writes="outer", version=4, libraries=("lib3mf", "libigl", "manifold3d", "scipy", "vtk"))
def load_surface(*, params: LoadSurfaceParams) -> OuterShape:
    """Read a surface in mm, repair it, turn it outward, and refuse what does not bound a solid.

    What was done and how far it moved the surface is told in the notes and, by number, in the facts; a sound surface
    stays as it is. A `StageError` tells of an unreadable file, an unknown unit, a repair that moves more than
    `tolerance`, and of a surface that still is open, non-manifold, one-sided, flat or passes through itself.
    """
    name = params.path.name
    content = reading.read_surface(params.path)
    scale, unit_note = _scale_to_mm(content, params.units, name)
    log = RepairLog([*content.notes, unit_note], measures={"mode": params.repair})
    read = _turn_up(content.vertices * scale, content, params, log), content.faces
    require_near_origin(read[0], name)
    if params.repair == "none":
        vertices, faces = whole = _clean(*read, log)
    else:
        read = _merge(*read, log)
        vertices, faces = whole = _repair(*read, params, log)
    _require_some(faces, params, log.notes)
    faces, pieces = _orient(vertices, faces, log)
    faces, pieces = _chosen(vertices, faces, pieces, params, log)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    _require_closed(faces, params, log.notes)
    _require_volume(vertices, faces, pieces, params)
    if params.repair != "none":
        _require_near(read, whole, (vertices, faces), params, log)
    _require_no_crossing(vertices, faces, params)
    faces = _outward(vertices, faces, pieces, params, log)
    warn_of_odd_size(vertices, name)
    facts = {f"repair_{name}": fact for name, fact in log.facts.items()}
    facts |= {"space": content.space} if content.space else {}
    return OuterShape(vertices=vertices, faces=faces, notes=tuple(log.notes), facts=facts)


def _scale_to_mm(content: SurfaceFile, units: str | None, name: str) -> tuple[float, str]:
    """Return the mm of one file unit, and a note of where the unit is from."""
    known = reading.MILLIMETRES
    size = reading.size_in_words(content.vertices, content.faces)
    if units is None and content.unit not in known:
        raise StageError(
            f"{name}: the file does not say its unit; set `units` to mm, cm, m or inch "
            f"(the surface measures {size} in the file)"
        )
    if units is not None and content.unit in known and content.unit != units:
        warn(f"{name}: the file says its unit is {content.unit}, `units` says {units}: taken as {units}")
    unit = units or content.unit or ""
    return known[unit], f"unit {unit} ({'given' if units else 'from the file'}), size {size} {unit}"


def _turn_up(vertices: Floats, content: SurfaceFile, params: LoadSurfaceParams, log: RepairLog) -> Floats:
    """Return vertices whose z axis points up."""
    if (params.up or content.up) == "z":
        return vertices
    log.notes.append(f"turned so that y, which points up in the file{'' if params.up else ' by its format'}, is z")
    return reading.turn_up(vertices)


def _clean(vertices: Floats, faces: Ints, log: RepairLog) -> tuple[Floats, Ints]:
    """Merge coincident vertices; drop collapsed, repeated and flat faces and what then is not used."""
    count = len(vertices)
    vertices, faces = triangles.merge_coincident(vertices, faces)
    log.count(MERGED, count - len(vertices))
    faces = _without(faces, triangles.duplicate_vertex_faces(faces), TWICE, log)
    faces = _without(faces, triangles.duplicate_faces(faces), DOUBLE, log)
    faces = _without(faces, triangles.flat_faces(vertices, faces), _FLATS, log)
    count = len(vertices)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    log.count(_UNUSED, count - len(vertices))
    return vertices, faces


def _without(faces: Ints, bad: NDArray[np.bool_], op: RepairOp, log: RepairLog) -> Ints:
    log.count(op, int(bad.sum()))
    return faces[~bad]


def _merge(vertices: Floats, faces: Ints, log: RepairLog) -> Surface:
    """Give the surface one vertex for each place."""
    done = Counter[RepairOp]()
    vertices, faces = mend.merge_vertices(vertices, faces, done)
    log.count_all(done)
    return vertices, faces


def _repair(vertices: Floats, faces: Ints, params: LoadSurfaceParams, log: RepairLog) -> Surface:
    """Mend or rebuild a surface."""
    if params.repair == "safe":
        found = modes.repair_surface(vertices, faces)
    else:
        found = modes.rebuild_surface(vertices, faces, _tolerance(params, vertices), params.path.name)
    log.add(found.log)
    return found.vertices, found.faces


def _tolerance(params: LoadSurfaceParams, vertices: Floats) -> float:
    """Return how far a repair may move the surface, mm."""
    return params.tolerance or _TOLERANCE * float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _require_near(read: Surface, whole: Surface, kept: Surface, params: LoadSurfaceParams, log: RepairLog) -> None:
    """Note what the repair did in numbers, and refuse it where it moved the surface too far."""
    allowed = _tolerance(params, kept[0])
    moved = displacement.measure_displacement(read, whole, kept, allowed / _SAMPLES)
    name, farthest = params.path.name, max(moved.lost, moved.gained, key=lambda side: side.distance)
    volume, area = _volume_and_area(*read)
    is_same = np.array_equal(read[0], whole[0]) and np.array_equal(read[1], whole[1])
    new_volume, new_area = (volume, area) if is_same else _volume_and_area(*whole)
    log.measures.update(
        distance_mm=farthest.distance,
        tolerance_mm=allowed,
        volume_before_mm3=volume,
        volume_after_mm3=new_volume,
        area_before_mm2=area,
        area_after_mm2=new_area,
        area_inside_mm2=moved.inner,
    )
    if farthest.distance == 0.0:
        log.notes.append(f"repair {params.repair}: no place of the surface moved")
        return
    log.notes.append(
        f"repair {params.repair}: what was read lies at most {moved.lost.distance:.3g} mm from the result, the result "
        f"at most {moved.gained.distance:.3g} mm from what was read (tolerance {allowed:.3g} mm); volume {volume:.6g} "
        f"to {new_volume:.6g} mm^3, area {area:.6g} to {new_area:.6g} mm^2"
        + (f", {moved.inner:.3g} mm^2 that lay inside left out" if moved.inner else "")
    )
    if farthest.distance > allowed:
        at = farthest.place
        what = "a filled hole or a new place" if farthest is moved.gained else "a part that was left out"
        raise StageError(
            f"{name}: repair {params.repair} moves the surface by {farthest.distance:.3g} mm ({what} at {at[0]:.4g}, "
            f"{at[1]:.4g}, {at[2]:.4g} mm), more than the tolerance of {allowed:.3g} mm; look whether that is right, "
            f"then set `tolerance: {_rounded_up(farthest.distance):g}`, or {_BY_HAND} [{'; '.join(log.notes)}]"
        )


def _rounded_up(value: float) -> float:
    """Return a number of two digits above `value`."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(np.ceil(1.02 * value / step) * step)


def _volume_and_area(vertices: Floats, faces: Ints) -> tuple[float, float]:
    """Return what all pieces enclose, each as if closed and outward, and their area."""
    faces = triangles.turn_faces(faces, triangles.consistent_winding(faces).turn)
    volumes = triangles.piece_volumes(vertices, faces, triangles.face_pieces(faces))
    return float(np.abs(volumes).sum()), float(triangles.face_areas(vertices, faces).sum())


def _require_some(faces: Ints, params: LoadSurfaceParams, notes: list[str]) -> None:
    if not len(faces):
        raise StageError(f"{params.path.name}: no triangle is left of it ({'; '.join(notes)}); {_BY_HAND}")


def _orient(vertices: Floats, faces: Ints, log: RepairLog) -> tuple[Ints, Ints]:
    """Make neighbours agree; return the faces and the piece of each, pieces by falling volume."""
    winding = triangles.consistent_winding(faces)
    log.count(TURNED, int(winding.turn.sum()))
    faces = triangles.turn_faces(faces, winding.turn)
    pieces = triangles.face_pieces(faces)
    if not pieces.any():
        return faces, pieces
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    rank = np.empty(len(volumes), dtype=np.int64)
    rank[np.argsort(-volumes, kind="stable")] = np.arange(len(volumes))
    return faces, rank[pieces]


def _chosen(
    vertices: Floats, faces: Ints, pieces: Ints, params: LoadSurfaceParams, log: RepairLog
) -> tuple[Ints, Ints]:
    """Keep the largest piece, unless all are asked for."""
    count = int(pieces.max()) + 1
    if params.component == "all" or count == 1:
        log.count(_ALL, count if count > 1 else 0)
        return faces, pieces
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    kept = pieces == 0
    log.measures["pieces_dropped"] = len(volumes) - 1
    log.notes.append(
        f"kept the largest of {len(volumes)} pieces ({volumes[0]:.6g} mm^3) and dropped {len(volumes) - 1} "
        f"({int((~kept).sum())} triangles, the greatest {volumes[1]:.6g} mm^3)"
    )
    if volumes[1] > _WORTH_A_WARNING * volumes[0]:
        warn(
            f"{params.path.name}: dropped a piece of {volumes[1]:.6g} mm^3 beside the largest of {volumes[0]:.6g} "
            "mm^3; set `component: all` to keep every piece"
        )
    return faces[kept], pieces[kept]


def _require_closed(faces: Ints, params: LoadSurfaceParams, notes: list[str]) -> None:
    """Refuse a surface that is open, touches itself at an edge or a vertex, or has one side only."""
    faults = triangles.edge_faults(faces)
    said = [
        f"it is open ({faults.boundary} boundary edges)" if faults.boundary else "",
        f"{faults.non_manifold} edges have more than two faces" if faults.non_manifold else "",
    ]
    if not any(said) and faults.misoriented and not triangles.consistent_winding(faces).orientable:
        said = ["it has one side only, like a Moebius strip"]
    touching = 0 if any(said) else triangles.touching_vertices(faces)
    if touching:
        said = [f"it touches itself at {touching} vertices"]
    if any(said):
        found = " and ".join(filter(None, said))
        remedy = _REMEDIES[params.repair]
        raise StageError(f"{params.path.name}: does not bound a solid: {found}; {remedy} [{'; '.join(notes)}]")


def _outward(vertices: Floats, faces: Ints, pieces: Ints, params: LoadSurfaceParams, log: RepairLog) -> Ints:
    """Turn bodies outward and cavities inward.

    A piece that the file winds against the piece it lies in is a cavity of it (or a body in a cavity).
    """
    volumes = triangles.piece_volumes(vertices, faces, pieces)
    depth, container = _nesting(vertices, faces, pieces)
    same = [k for k, c in enumerate(container) if c >= 0 and (volumes[k] > 0) == (volumes[c] > 0)]
    if same:
        raise StageError(
            f"{params.path.name}: {len(same)} of {len(volumes)} pieces lie inside another and face the same way, "
            "so they are neither its cavities nor apart from it; set `component: largest`, `repair: rebuild` to make "
            "them part of it, or turn them inward"
        )
    log.count(_CAVITIES, int((depth % 2 == 1).sum()))
    turned = (volumes > 0) == (depth % 2 == 1)
    log.count(_WRONG_WAY, int(turned.sum()))
    return triangles.turn_faces(faces, turned[pieces])


def _nesting(vertices: Floats, faces: Ints, pieces: Ints) -> tuple[Ints, Ints]:
    """Return for each piece how many contain it, and the smallest that does or -1, (k,) and (k,)."""
    parts = [faces[pieces == k] for k in range(int(pieces.max()) + 1)]
    depth, container = np.zeros(len(parts), dtype=np.int64), np.full(len(parts), -1)
    for inner, part in enumerate(parts):
        # Pieces fall in volume: only an earlier one can contain this one, and the last that does is the smallest.
        for outer in range(inner):
            if _contains(vertices, parts[outer], part):
                depth[inner] += 1
                container[inner] = outer
    return depth, container


def _contains(vertices: Floats, outer: Ints, inner: Ints) -> bool:
    """Return whether closed surface `outer` winds about `inner`, which does not pass through it."""
    corners, box = vertices[inner], vertices[outer]
    if (corners.min(axis=(0, 1)) < box.min(axis=(0, 1))).any() or (
        corners.max(axis=(0, 1)) > box.max(axis=(0, 1))
    ).any():
        return False
    # A few points, as one may be where the two touch.
    points = corners[:: -(-len(inner) // 5)].mean(axis=1)
    windings = [abs(triangles.winding_number(point, vertices, outer)) for point in points]
    return bool(np.median(windings) > 0.5)  # halfway between outside and inside


def _require_volume(vertices: Floats, faces: Ints, pieces: Ints, params: LoadSurfaceParams) -> None:
    """Refuse pieces whose volume is nothing beside their area, as is that of a sheet folded onto itself."""
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    areas = np.bincount(pieces, weights=triangles.face_areas(vertices, faces))
    flat = int((volumes <= _FLAT * areas**1.5).sum())
    if flat:
        raise StageError(
            f"{params.path.name}: encloses no volume: {flat} of {len(volumes)} pieces are flat "
            f"({reading.size_in_words(vertices, faces)} mm); load a surface that bounds a body"
        )


def _require_no_crossing(vertices: Floats, faces: Ints, params: LoadSurfaceParams) -> None:
    """Refuse a surface that passes through itself or lies upon itself."""
    name, remedy = params.path.name, _REMEDIES[params.repair]
    found = call_in_child(
        self_intersections.find_self_intersections,
        {"vertices": vertices, "faces": faces},
        {},
        seconds=60.0 + len(faces) / 5_000,  # exact arithmetic; millions of sound triangles take seconds
        about=f"{name} could not be searched for self-intersections: {remedy}",
    )["faces"]
    if len(found):
        at = vertices[faces[found[0]]].mean(axis=0)
        raise StageError(
            f"{name}: passes through itself: {len(found)} triangles intersect others "
            f"(one at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm); {remedy}"
        )
