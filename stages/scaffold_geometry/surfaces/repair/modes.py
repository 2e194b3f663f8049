"""The two repairs of a surface: repair its defects, or rebuild it as the boundary of what it encloses."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.edges import Surface, edges_of
from scaffold_geometry.surfaces.repair import exact_union, fins_and_walls, holes, mend, winding_number
from scaffold_geometry.surfaces.repair.log import TURNED, OpCounts, RepairLog, RepairOp
from scaffold_geometry.surfaces.repair.non_manifold import try_split_non_manifold
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays, call_in_child

_TORN = 0.3
"""Share of open edges above which holes are not filled: the triangles are hardly connected."""

_FINEST, _COARSEST = 250.0, 50.0
"""Most (one or two minutes of computing) and fewest samples along the diagonal."""

_PER_TOLERANCE = 2.0
"""Samples per tolerance: the surface is found to a fraction of the distance between samples."""

_INSIDE = 0.5
"""Winding number halfway between outside and inside."""


_PIECES = RepairOp("pieces_turned", "reoriented {} pieces that faced inward")
_TOO_LONG = RepairOp("holes_left", f"left {{}} holes of more than {holes.LONGEST} edges open")


class Repaired(NamedTuple):
    """A repaired surface and its log."""

    vertices: Floats
    faces: Ints
    log: RepairLog


def repair_surface(vertices: Floats, faces: Ints) -> Repaired:
    """Repair the defects of a surface with distinct vertices; its sound parts and other defects are not changed."""
    done, log = Counter[RepairOp](), RepairLog()
    vertices, faces = _prepare(vertices, faces, done)
    vertices, faces, filling = _fill(vertices, faces)
    vertices, faces = try_split_non_manifold(vertices, faces, done)
    log.count_all(done)
    log.add(filling)
    return Repaired(vertices, faces, log)


def rebuild_surface(vertices: Floats, faces: Ints, tolerance: float, name: str) -> Repaired:
    """Return the boundary of what a surface with distinct vertices encloses.

    If its holes can be filled, its triangles are cut where they cross, and the boundary of the inside is kept exactly.
    Otherwise the winding number is sampled on a grid. Raises `StageError` if there is no inside either.
    """
    done, log = Counter[RepairOp](), RepairLog()
    vertices, faces = _prepare(vertices, faces, done)
    log.count_all(done)
    if not len(faces):
        return Repaired(vertices, faces, log)
    seconds = 300.0 + len(faces) / 500.0
    try:
        *whole, closing = _close(vertices, faces)
        answer = call_in_child(
            exact_union.resolve_self_intersections,
            dict(zip(_NAMES, whole, strict=True)),
            {},
            seconds=seconds,
            about=_CUT,
        )
        log.add(closing)
        how = "rebuilt by cutting it where it crosses itself and keeping the boundary of what it encloses"
    except StageError as error:
        answer, spacing = _rebuild_on_grid(vertices, faces, tolerance, seconds, name)
        reason = str(error).removesuffix(f"; {_CUT}")
        how = f"rebuilt from its winding number on a grid of {spacing:.3g} mm, as {reason}"
        log.measures["grid_mm"] = spacing
    log.notes.append(how)
    return Repaired(answer["vertices"], answer["faces"], log)


_NAMES = ("vertices", "faces")
_CUT = "in cutting it where it crosses itself"


def _prepare(vertices: Floats, faces: Ints, done: OpCounts) -> Surface:
    """Clean the mesh, remove fins and internal walls, and orient faces consistently."""
    vertices, faces = mend.clean_mesh(vertices, faces, done)
    vertices, faces = fins_and_walls.remove_fins_and_internal_walls(vertices, faces, done)
    turn = triangles.consistent_winding(faces).turn
    done[TURNED] += int(turn.sum())
    return np.ascontiguousarray(vertices), np.ascontiguousarray(triangles.turn_faces(faces, turn))


def _fill(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, RepairLog]:
    """Return the surface with its holes filled, except long ones; unchanged if too many edges are open."""
    log = RepairLog()
    share = float((edges_of(faces).uses == 1).mean()) if len(faces) else 0.0
    if share > _TORN:
        log.notes.append(f"filled no holes, as {share:.0%} of its edges are open")
        return vertices, faces, log
    found = holes.fill_holes(vertices, faces)
    count = int(found.patches.max(initial=-1)) + 1
    log.count(RepairOp("holes_filled", f"filled {{}} holes with {len(found.patches)} triangles"), count)
    log.count(_TOO_LONG, found.too_long)
    return found.vertices, found.faces, log


def _close(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, RepairLog]:
    """Return the surface filled and each piece oriented outward; raises `StageError` if it cannot be closed."""
    vertices, faces, log = _fill(vertices, faces)
    left = int((edges_of(faces).net != 0).sum())
    if left:
        raise StageError(f"{left} of its edges stay open")
    faces, turned = _outward(vertices, faces)
    log.count(_PIECES, turned)
    return vertices, faces, log


def _outward(vertices: Floats, faces: Ints) -> tuple[Ints, int]:
    """Return the faces with closed pieces oriented outward, except cavities: opposite to the piece around them."""
    import igl

    pieces = triangles.face_pieces(faces)
    volumes = triangles.piece_volumes(vertices, faces, pieces)
    if volumes.sum() < 0.0:
        flipped, count = _outward(vertices, np.ascontiguousarray(faces[:, ::-1]))
        return flipped, len(volumes) - count
    bodies = np.ascontiguousarray(faces[(volumes > 0.0)[pieces]])
    turned = np.zeros(len(volumes), bool)
    for piece in np.flatnonzero(volumes < 0.0):
        own = faces[pieces == piece]
        points = vertices[own[:: -(-len(own) // 20)]].mean(axis=1)
        turned[piece] = np.median(igl.fast_winding_number(vertices, bodies, points)) < _INSIDE
    return triangles.turn_faces(faces, turned[pieces]), int(turned.sum())


def _rebuild_on_grid(
    vertices: Floats, faces: Ints, tolerance: float, seconds: float, name: str
) -> tuple[Arrays, float]:
    """Return the surface rebuilt on a grid, and the grid's spacing, mm."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    spacing = float(np.clip(tolerance / _PER_TOLERANCE, diagonal / _FINEST, diagonal / _COARSEST))
    answer = call_in_child(
        winding_number.winding_number_isosurface,
        {"vertices": vertices, "faces": faces},
        {"spacing": spacing},
        seconds=2.0 * seconds,
        about=f"{name} cannot be rebuilt: repair it in another program, or load a surface that bounds a body",
    )
    return answer, spacing
