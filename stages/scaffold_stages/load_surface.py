"""`load_surface`: read an anatomical surface, and let nothing pass that does not bound a solid."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.contract import InputFile, Params, stage
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.isolation import call_in_child
from scaffold_stages._kernels import surface_files, triangles

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scaffold_stages._kernels.surface_files import SurfaceFile
    from scaffold_stages._kernels.triangles import Floats, Ints

_REPAIR = "repair the surface, for instance in MeshLab or Blender, and load it again"
_SMALLEST, _LARGEST = 1.0, 2000.0
"""mm: between a bone of the ear and a whole body; what is outside has most likely the wrong unit."""
_WORTH_A_WARNING = 0.1
"""A dropped piece of this share of the volume kept is hardly debris."""
_FLAT = 1e-9
"""Volume over area to the power 3/2 (0.09 for a ball) below which a closed surface bounds but a sheet."""


class LoadSurfaceParams(Params):
    """Parameters of `load_surface`."""

    path: InputFile
    """The surface: STL, OBJ, PLY, OFF, 3MF, GLB, VTP or legacy VTK."""

    units: Literal["mm", "cm", "m", "inch"] | None = None
    """What a length of 1 in the file means; required unless the file says it (3MF; GLB is in metres)."""

    component: Literal["largest", "all"] = Field(default="largest")
    """Which of the surface's separate pieces to keep; `all` keeps cavities, too."""


@stage(writes="outer", version=1)
def load_surface(*, params: LoadSurfaceParams) -> OuterShape:
    """Read a closed surface in mm, clean it, turn it outward, and refuse what does not bound a solid.

    Exact duplicates and what has no area go, by number in the notes; no vertex is moved. A `StageError`
    tells of an unreadable file, an unknown unit, and of a surface that is open, non-manifold, one-sided,
    flat or passes through itself.
    """
    name = params.path.name
    content = surface_files.read_surface(params.path)
    scale, unit_note = _scale_to_mm(content, params.units, name)
    notes = [*content.notes, unit_note]
    vertices, faces = _cleaned(content.vertices * scale, content.faces, notes)
    _require_some(faces, name, notes)
    faces, pieces = _wound(vertices, faces, notes)
    faces, pieces = _chosen(vertices, faces, pieces, params, notes)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    _require_closed(faces, name, notes)
    _require_volume(vertices, faces, pieces, name)
    _require_no_self_intersection(vertices, faces, name)
    faces = _outward(vertices, faces, pieces, name, notes)
    _warn_of_odd_size(vertices, name)
    return OuterShape(vertices=vertices, faces=faces, notes=tuple(notes))


def _scale_to_mm(content: SurfaceFile, units: str | None, name: str) -> tuple[float, str]:
    """Return the mm of one file unit, and a note of where the unit is from."""
    known = surface_files.MILLIMETRES
    size = surface_files.size_in_words(content.vertices, content.faces)
    if units is None and content.unit not in known:
        raise StageError(
            f"{name}: the file does not say its unit; set `units` to mm, cm, m or inch "
            f"(the surface measures {size} in the file)"
        )
    if units is not None and content.unit in known and content.unit != units:
        warnings.warn(
            f"{name}: the file says its unit is {content.unit}, `units` says {units}: taken as {units}",
            PipelineWarning,
            stacklevel=3,
        )
    unit = units or content.unit or ""
    return known[unit], f"unit {unit} ({'given' if units else 'from the file'}), size {size} {unit}"


def _cleaned(vertices: Floats, faces: Ints, notes: list[str]) -> tuple[Floats, Ints]:
    """Merge coincident vertices; drop collapsed, repeated and flat faces and what then is not used."""
    count = len(vertices)
    vertices, faces = triangles.merge_coincident(vertices, faces)
    _note(notes, count - len(vertices), "merged {} coincident vertices")
    faces = _without(faces, triangles.collapsed_faces(faces), "dropped {} triangles that use a vertex twice", notes)
    faces = _without(faces, triangles.repeated_faces(faces), "dropped {} duplicate triangles", notes)
    faces = _without(faces, triangles.flat_faces(vertices, faces), "dropped {} triangles without area", notes)
    count = len(vertices)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    _note(notes, count - len(vertices), "dropped {} vertices that no triangle uses")
    return vertices, faces


def _without(faces: Ints, bad: NDArray[np.bool_], said: str, notes: list[str]) -> Ints:
    _note(notes, int(bad.sum()), said)
    return faces[~bad]


def _note(notes: list[str], count: int, said: str) -> None:
    if count:
        notes.append(said.format(count))


def _require_some(faces: Ints, name: str, notes: list[str]) -> None:
    if not len(faces):
        raise StageError(f"{name}: no triangle is left of it ({'; '.join(notes)}); {_REPAIR}")


def _wound(vertices: Floats, faces: Ints, notes: list[str]) -> tuple[Ints, Ints]:
    """Make neighbours agree; return the faces and the piece of each, pieces by falling volume."""
    winding = triangles.consistent_winding(faces)
    _note(notes, int(winding.turn.sum()), "turned {} triangles that were wound against their neighbours")
    faces = triangles.turn_faces(faces, winding.turn)
    pieces = triangles.face_pieces(faces)
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    rank = np.empty(len(volumes), dtype=np.int64)
    rank[np.argsort(-volumes, kind="stable")] = np.arange(len(volumes))
    return faces, rank[pieces]


def _chosen(
    vertices: Floats, faces: Ints, pieces: Ints, params: LoadSurfaceParams, notes: list[str]
) -> tuple[Ints, Ints]:
    """Keep the largest piece, unless all are asked for."""
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    if params.component == "all" or len(volumes) == 1:
        _note(notes, len(volumes) if len(volumes) > 1 else 0, "kept all of {} pieces")
        return faces, pieces
    kept = pieces == 0
    notes.append(
        f"kept the largest of {len(volumes)} pieces ({volumes[0]:.6g} mm^3) and dropped {len(volumes) - 1} "
        f"({int((~kept).sum())} triangles, the greatest {volumes[1]:.6g} mm^3)"
    )
    if volumes[1] > _WORTH_A_WARNING * volumes[0]:
        warnings.warn(
            f"{params.path.name}: dropped a piece of {volumes[1]:.6g} mm^3 beside the largest of {volumes[0]:.6g} "
            "mm^3; set `component: all` to keep every piece",
            PipelineWarning,
            stacklevel=3,
        )
    return faces[kept], pieces[kept]


def _require_closed(faces: Ints, name: str, notes: list[str]) -> None:
    """Refuse a surface that is open, has an edge of more than two faces, or has one side only."""
    faults = triangles.edge_faults(faces)
    said = [
        f"it is open ({faults.boundary} boundary edges)" if faults.boundary else "",
        f"{faults.non_manifold} edges have more than two faces" if faults.non_manifold else "",
    ]
    if not any(said) and not triangles.consistent_winding(faces).orientable:
        said = ["it has one side only, like a Moebius strip"]
    if any(said):
        found = " and ".join(filter(None, said))
        raise StageError(f"{name}: does not bound a solid: {found}; {_REPAIR} [{'; '.join(notes)}]")


def _outward(vertices: Floats, faces: Ints, pieces: Ints, name: str, notes: list[str]) -> Ints:
    """Turn bodies outward and cavities inward.

    A piece that the file winds against the piece it lies in is a cavity of it (or a body in a cavity).
    """
    volumes = triangles.piece_volumes(vertices, faces, pieces)
    depth, container = _nesting(vertices, faces, pieces)
    same = [k for k, c in enumerate(container) if c >= 0 and (volumes[k] > 0) == (volumes[c] > 0)]
    if same:
        raise StageError(
            f"{name}: {len(same)} of {len(volumes)} pieces lie inside another and face the same way, "
            "so they are neither its cavities nor apart from it; set `component: largest`, or delete them "
            "or turn them inward"
        )
    _note(notes, int((depth % 2 == 1).sum()), "{} pieces are cavities")
    turned = (volumes > 0) == (depth % 2 == 1)
    _note(notes, int(turned.sum()), "turned {} pieces that faced the wrong way")
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
    return bool(np.median(windings) > 0.5)  # noqa: PLR2004 - halfway between outside and inside


def _require_volume(vertices: Floats, faces: Ints, pieces: Ints, name: str) -> None:
    """Refuse pieces whose volume is nothing beside their area, as is that of a sheet folded onto itself."""
    volumes = np.abs(triangles.piece_volumes(vertices, faces, pieces))
    areas = np.bincount(pieces, weights=triangles.face_areas(vertices, faces))
    flat = int((volumes <= _FLAT * areas**1.5).sum())
    if flat:
        raise StageError(
            f"{name}: encloses no volume: {flat} of {len(volumes)} pieces are flat "
            f"({surface_files.size_in_words(vertices, faces)} mm); load a surface that bounds a body"
        )


def _require_no_self_intersection(vertices: Floats, faces: Ints, name: str) -> None:
    # Seconds are enough for millions of triangles; on some tangles the search never ends.
    seconds = 60.0 + len(faces) / 20_000
    found = call_in_child(
        triangles.self_intersections,
        {"vertices": vertices, "faces": faces},
        {},
        seconds=seconds,
        about=f"{name} could not be searched for self-intersections: {_REPAIR}",
    )["faces"]
    if len(found):
        at = vertices[faces[found[0]]].mean(axis=0)
        raise StageError(
            f"{name}: passes through itself: {len(found)} triangles intersect others "
            f"(one at {at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g} mm); {_REPAIR}"
        )


def _warn_of_odd_size(vertices: Floats, name: str) -> None:
    longest = float(np.ptp(vertices, axis=0).max())
    # A surface scaled to the unit cube has no unit at all.
    if not _SMALLEST < longest <= _LARGEST:
        warnings.warn(
            f"{name}: its longest side is {longest:.4g} mm, not between {_SMALLEST:g} and {_LARGEST:g} mm: "
            "is `units` right?",
            PipelineWarning,
            stacklevel=3,
        )
