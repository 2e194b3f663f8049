"""From the triangles of a file to the closed, outward boundary of a solid; anything else is an error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import Surface
from scaffold_geometry.surfaces.repair import displacement, mend, modes
from scaffold_geometry.surfaces.repair.log import DOUBLE, MERGED, TURNED, TWICE, RepairLog, RepairOp
from scaffold_geometry.surfaces.self_intersections import require_no_self_intersections
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError, warn

_BY_HAND = "repair it, for instance in MeshLab or Blender, and load it again"
_REMEDIES = {
    "none": f"set `repair: safe` or `repair: rebuild`, or {_BY_HAND}",
    "safe": f"set `repair: rebuild`, or {_BY_HAND}",
    "rebuild": _BY_HAND,
}
_TOLERANCE = 0.01
"""Default tolerance of a repair, as a share of the diagonal: in scans it allows a pinhole, not an open end. Rebuilding
a surface without holes moves it by a ten thousandth."""
_SAMPLES = 5.0
"""Samples per tolerance, for the distance between the original and the repaired surface."""
_WORTH_A_WARNING = 0.1
"""Share of the kept volume above which a dropped piece is reported, as it is hardly debris."""
_FLAT = 1e-9
"""Volume over area to the power 3/2 (0.09 for a ball) below which a closed surface is only a folded sheet."""

_FLATS = RepairOp("triangles_without_area_dropped", "dropped {} triangles without area")
_UNUSED = RepairOp("vertices_dropped", "dropped {} vertices that no triangle uses")
_ALL = RepairOp("pieces_kept", "kept all of {} pieces")
_CAVITIES = RepairOp("cavities", "{} pieces are cavities")
_WRONG_WAY = RepairOp("pieces_turned", "reoriented {} pieces that faced the wrong way")


@dataclass(frozen=True)
class RepairRules:
    """How a surface may be repaired; see the parameters of `load_surface`, which have the same names.

    `name` is the name of the surface in messages; `tolerance` is in mm, None for 1 % of the diagonal.
    """

    name: str
    component: Literal["largest", "all"] = "largest"
    repair: Literal["none", "safe", "rebuild"] = "safe"
    tolerance: float | None = None


def make_outer_shape(vertices: Floats, faces: Ints, rules: RepairRules, notes: Iterable[str] = ()) -> OuterShape:
    """Return the surface repaired and oriented outward, with the repairs in its notes and facts.

    `vertices` (n, 3) mm, `faces` (m, 3); `notes` are earlier notes. Raises `StageError` if a repair moves the surface
    by more than the tolerance, or if it still is open, non-manifold, one-sided, flat or self-intersecting.
    """
    read: Surface = (vertices, faces)
    log = RepairLog([*notes], measures={"mode": rules.repair})
    if rules.repair == "none":
        vertices, faces = whole = _clean(*read, log)
    else:
        read = _merge(*read, log)
        vertices, faces = whole = _repair(*read, rules, log)
    _require_some(faces, rules, log.notes)
    faces, pieces = _orient(vertices, faces, log)
    faces, pieces = _chosen(vertices, faces, pieces, rules, log)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    _require_closed(faces, rules, log.notes)
    _require_volume(vertices, faces, pieces, rules)
    if rules.repair != "none":
        _require_near(read, whole, (vertices, faces), rules, log)
    remedy = _REMEDIES[rules.repair]
    about = f"{rules.name} could not be searched for self-intersections: {remedy}"
    require_no_self_intersections(vertices, faces, rules.name + ":", remedy, about)
    faces = _outward(vertices, faces, pieces, rules, log)
    facts = {f"repair_{name}": fact for name, fact in log.facts.items()}
    return OuterShape(vertices=vertices, faces=faces, notes=tuple(log.notes), facts=facts)


def _clean(vertices: Floats, faces: Ints, log: RepairLog) -> tuple[Floats, Ints]:
    """Merge coincident vertices; remove degenerate, duplicate and flat faces and unused vertices."""
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


def _without(faces: Ints, bad: Bools, op: RepairOp, log: RepairLog) -> Ints:
    log.count(op, int(bad.sum()))
    return faces[~bad]


def _merge(vertices: Floats, faces: Ints, log: RepairLog) -> Surface:
    """Merge coincident vertices."""
    done = Counter[RepairOp]()
    vertices, faces = mend.merge_vertices(vertices, faces, done)
    log.count_all(done)
    return vertices, faces


def _repair(vertices: Floats, faces: Ints, rules: RepairRules, log: RepairLog) -> Surface:
    """Repair or rebuild a surface."""
    if rules.repair == "safe":
        found = modes.repair_surface(vertices, faces)
    else:
        found = modes.rebuild_surface(vertices, faces, _tolerance(rules, vertices), rules.name)
    log.add(found.log)
    return found.vertices, found.faces


def _tolerance(rules: RepairRules, vertices: Floats) -> float:
    """Return how far a repair may move the surface, mm."""
    return rules.tolerance or _TOLERANCE * float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _require_near(read: Surface, whole: Surface, kept: Surface, rules: RepairRules, log: RepairLog) -> None:
    """Log how far the repair moved the surface, and require that this is within the tolerance."""
    allowed = _tolerance(rules, kept[0])
    moved = displacement.measure_displacement(read, whole, kept, allowed / _SAMPLES)
    name, farthest = rules.name, max(moved.lost, moved.gained, key=lambda side: side.distance)
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
        log.notes.append(f"repair {rules.repair}: no part of the surface moved")
        return
    log.notes.append(
        f"repair {rules.repair}: the original is at most {moved.lost.distance:.3g} mm from the result, the result "
        f"at most {moved.gained.distance:.3g} mm from the original (tolerance {allowed:.3g} mm); volume {volume:.6g} "
        f"to {new_volume:.6g} mm^3, area {area:.6g} to {new_area:.6g} mm^2"
        + (f", {moved.inner:.3g} mm^2 inside the solid removed" if moved.inner else "")
    )
    if farthest.distance > allowed:
        at = farthest.place
        what = "a filled hole or a new part" if farthest is moved.gained else "a part that was removed"
        raise StageError(
            f"{name}: repair {rules.repair} moves the surface by {farthest.distance:.3g} mm ({what} at {at[0]:.4g}, "
            f"{at[1]:.4g}, {at[2]:.4g} mm), more than the tolerance of {allowed:.3g} mm; check this place, "
            f"then set `tolerance: {_rounded_up(farthest.distance):g}`, or {_BY_HAND} [{'; '.join(log.notes)}]"
        )


def _rounded_up(value: float) -> float:
    """Return `value` rounded up to two digits."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return float(np.ceil(1.02 * value / step) * step)


def _volume_and_area(vertices: Floats, faces: Ints) -> tuple[float, float]:
    """Return the volume of all pieces, each as if closed and outward, and their area."""
    faces = triangles.turn_faces(faces, triangles.consistent_winding(faces).turn)
    volumes = triangles.piece_volumes(vertices, faces, triangles.face_pieces(faces))
    return float(np.abs(volumes).sum()), float(triangles.face_areas(vertices, faces).sum())


def _require_some(faces: Ints, rules: RepairRules, notes: list[str]) -> None:
    if not len(faces):
        raise StageError(f"{rules.name}: has no triangles left ({'; '.join(notes)}); {_BY_HAND}")


def _orient(vertices: Floats, faces: Ints, log: RepairLog) -> tuple[Ints, Ints]:
    """Orient faces consistently; return the faces and the piece of each, pieces in descending order of volume."""
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


def _chosen(vertices: Floats, faces: Ints, pieces: Ints, rules: RepairRules, log: RepairLog) -> tuple[Ints, Ints]:
    """Keep the largest piece, or all if requested."""
    count = int(pieces.max()) + 1
    if rules.component == "all" or count == 1:
        log.count(_ALL, count if count > 1 else 0)
        return faces, pieces
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    kept = pieces == 0
    log.measures["pieces_dropped"] = len(volumes) - 1
    log.notes.append(
        f"kept the largest of {len(volumes)} pieces ({volumes[0]:.6g} mm^3) and dropped {len(volumes) - 1} "
        f"({int((~kept).sum())} triangles, the largest {volumes[1]:.6g} mm^3)"
    )
    if volumes[1] > _WORTH_A_WARNING * volumes[0]:
        warn(
            f"{rules.name}: dropped a piece of {volumes[1]:.6g} mm^3; the largest, kept, has {volumes[0]:.6g} "
            "mm^3; set `component: all` to keep every piece"
        )
    return faces[kept], pieces[kept]


def _require_closed(faces: Ints, rules: RepairRules, notes: list[str]) -> None:
    """Require that a surface is closed, does not touch itself at an edge or vertex, and is orientable."""
    faults = triangles.edge_faults(faces)
    faulty = [
        f"it is open ({faults.boundary} boundary edges)" if faults.boundary else "",
        f"{faults.non_manifold} edges have more than two faces" if faults.non_manifold else "",
    ]
    if not any(faulty) and faults.misoriented and not triangles.consistent_winding(faces).orientable:
        faulty = ["it is not orientable, like a Moebius strip"]
    touching = 0 if any(faulty) else triangles.touching_vertices(faces)
    if touching:
        faulty = [f"it touches itself at {touching} vertices"]
    if any(faulty):
        found = " and ".join(filter(None, faulty))
        remedy = _REMEDIES[rules.repair]
        raise StageError(f"{rules.name}: does not bound a solid: {found}; {remedy} [{'; '.join(notes)}]")


def _outward(vertices: Floats, faces: Ints, pieces: Ints, rules: RepairRules, log: RepairLog) -> Ints:
    """Orient bodies outward and cavities inward.

    A piece with the opposite orientation of the piece around it is a cavity of it (or a body in a cavity).
    """
    volumes = triangles.piece_volumes(vertices, faces, pieces)
    depth, container = _nesting(vertices, faces, pieces)
    same = [k for k, c in enumerate(container) if c >= 0 and (volumes[k] > 0) == (volumes[c] > 0)]
    if same:
        raise StageError(
            f"{rules.name}: {len(same)} of {len(volumes)} pieces are inside another with the same orientation, "
            "so they are neither cavities nor separate; set `component: largest`, or `repair: rebuild` to unite "
            "them with it, or orient them inward"
        )
    log.count(_CAVITIES, int((depth % 2 == 1).sum()))
    turned = (volumes > 0) == (depth % 2 == 1)
    log.count(_WRONG_WAY, int(turned.sum()))
    return triangles.turn_faces(faces, turned[pieces])


def _nesting(vertices: Floats, faces: Ints, pieces: Ints) -> tuple[Ints, Ints]:
    """Return for each piece the number of pieces around it, and the smallest of these or -1, (k,) and (k,)."""
    parts = [faces[pieces == k] for k in range(int(pieces.max()) + 1)]
    depth, container = np.zeros(len(parts), dtype=np.int64), np.full(len(parts), -1)
    for inner, part in enumerate(parts):
        # In descending order of volume only an earlier piece can contain this one; the last such is the smallest.
        for outer in range(inner):
            if _contains(vertices, parts[outer], part):
                depth[inner] += 1
                container[inner] = outer
    return depth, container


def _contains(vertices: Floats, outer: Ints, inner: Ints) -> bool:
    """Return whether closed surface `outer` encloses `inner`, which does not cross it."""
    corners, box = vertices[inner], vertices[outer]
    if (corners.min(axis=(0, 1)) < box.min(axis=(0, 1))).any() or (
        corners.max(axis=(0, 1)) > box.max(axis=(0, 1))
    ).any():
        return False
    # Several points, as one may be where the two touch.
    points = corners[:: -(-len(inner) // 5)].mean(axis=1)
    windings = [abs(triangles.winding_number(point, vertices, outer)) for point in points]
    return bool(np.median(windings) > 0.5)  # halfway between outside and inside


def _require_volume(vertices: Floats, faces: Ints, pieces: Ints, rules: RepairRules) -> None:
    """Require that no piece is flat, with a negligible volume for its area, as a sheet folded onto itself."""
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    areas = np.bincount(pieces, weights=triangles.face_areas(vertices, faces))
    flat = int((volumes <= _FLAT * areas**1.5).sum())
    if flat:
        raise StageError(
            f"{rules.name}: encloses no volume: {flat} of {len(volumes)} pieces are flat "
            f"({triangles.size_in_words(vertices, faces)} mm); load a surface that bounds a body"
        )
