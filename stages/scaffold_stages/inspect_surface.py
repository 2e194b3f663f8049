"""Stage `inspect_surface`: measure a surface file with its defects; no defect is an error."""

from __future__ import annotations

from typing import Literal

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.inputs import require_near_origin
from scaffold_geometry.files.surfaces import reading
from scaffold_geometry.surfaces import self_intersections, triangles
from scaffold_pipeline.artifacts import Fact, Metric, Metrics
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import call_in_child
from scaffold_pipeline.stages.contract import InputFile, Params, stage

_SEARCH_SECONDS = 60.0
"""Time limit of the search for self-intersections; a million triangles take seconds, tangled ones may take longer."""


_FILE, _SURFACE = "File", "Surface"

METRICS = (
    Metric("file", "", "File", "The measured file.", _FILE),
    Metric("unit", "", "Unit", "Of the file's lengths, and its source.", _FILE),
    Metric("vertices_in_file", "", "Vertices in the file", "Before coincident ones are merged.", _FILE),
    Metric("vertices", "", "Vertices", "Distinct ones.", _FILE),
    Metric("triangles", "", "Triangles", "Of the surface.", _FILE),
    Metric("degenerate_triangles", "", "Degenerate triangles", "Without area.", _FILE),
    Metric("duplicate_triangles", "", "Duplicate triangles", "With the same corners as another triangle.", _FILE),
    Metric("size_{axis}", "mm", "Size along {axis}", "Of the bounding box.", _SURFACE),
    Metric("area_mm2", "mm\u00b2", "Area", "Of all triangles.", _SURFACE),
    Metric("volume_mm3", "mm\u00b3", "Volume", "If the surface is closed and consistently oriented.", _SURFACE),
    Metric("is_manifold", "", "Manifold", "Yes if each edge belongs to two triangles.", _SURFACE),
    Metric("is_oriented", "", "Oriented", "Yes if neighbouring triangles have the same orientation.", _SURFACE),
    Metric("boundary_edges", "", "Open edges", "With one triangle.", _SURFACE),
    Metric("non_manifold_edges", "", "Non-manifold edges", "With more than two triangles.", _SURFACE),
    Metric("misoriented_edges", "", "Misoriented edges", "Whose two triangles have opposite orientations.", _SURFACE),
    Metric("touching_vertices", "", "Touching vertices", "At which the surface touches itself.", _SURFACE),
    Metric("pieces", "", "Pieces", "Parts connected over edges.", _SURFACE),
    Metric("euler", "", "Euler characteristic", "Vertices minus edges plus triangles.", _SURFACE),
    Metric("genus", "", "Genus", "Handles of all pieces together, of a closed surface.", _SURFACE),
    Metric("self_intersecting_faces", "", "Self-intersecting triangles", "That intersect others.", _SURFACE),
    Metric(
        "self_intersecting_faces_note",
        "",
        "Why self-intersecting triangles were not counted",
        "The search did not end.",
        _SURFACE,
    ),
    Metric("manifold3d", "", "Status in manifold3d", "That library's status of the surface as a solid.", _SURFACE),
    Metric("notes", "", "Notes", "From reading the file.", _FILE),
)
"""The metrics of `inspect_surface`."""


class InspectSurfaceParams(Params):
    """Parameters of `inspect_surface`."""

    path: InputFile
    """The surface: STL, OBJ, PLY, OFF, 3MF, GLB, glTF, VTP or legacy VTK."""

    units: Literal["mm", "cm", "m", "inch"] | None = None
    """Unit of lengths in the file; by default the one that the file states, or else mm."""


@stage(writes="metrics", version=3, metrics=METRICS)
def inspect_surface(*, params: InspectSurfaceParams) -> Metrics:
    """Measure a surface file: unit, size, area, volume, closedness, pieces, self-intersections.

    Coincident vertices count as one. Undefined values are None: the volume and genus of a surface that is open or not
    consistently oriented, and self-intersections if the search did not end.
    """
    content = reading.read_surface(params.path)
    unit = params.units or content.unit
    scale = reading.MILLIMETRES.get(unit or "mm")
    if scale is None:
        raise StageError(f"{params.path.name}: the unit {unit!r} is unknown; set `units` to mm, cm, m or inch")
    read = content.vertices * scale
    require_near_origin(read, params.path.name)
    vertices, faces = triangles.merge_coincident(reading.turn_up(read) if content.up == "y" else read, content.faces)
    vertices, faces = triangles.drop_unreferenced(vertices, faces)
    values = {
        "file": params.path.name,
        "unit": _unit_in_words(unit, is_given=params.units is not None),
        "vertices_in_file": len(content.vertices),
        "vertices": len(vertices),
        "triangles": len(faces),
        "degenerate_triangles": int(triangles.flat_faces(vertices, faces).sum()),
        "duplicate_triangles": int(triangles.duplicate_faces(faces).sum()),
        **_size(vertices, faces),
        **_topology(vertices, faces[~triangles.duplicate_vertex_faces(faces)]),
        **_intersections(vertices, faces, params.path.name),
        "manifold3d": _manifold_status(vertices, faces),
        "notes": "; ".join(content.notes),
    }
    return Metrics(values, has_gates=False)


def _unit_in_words(unit: str | None, *, is_given: bool) -> str:
    if unit is None:
        return "not in the file, taken as mm"
    return f"{unit} (given)" if is_given else f"{unit} (from the file)"


def _size(vertices: Floats, faces: Ints) -> dict[str, Fact]:
    size = np.ptp(vertices, axis=0)
    return {
        **{f"size_{axis}": float(length) for axis, length in zip("xyz", size, strict=True)},
        "area_mm2": float(triangles.face_areas(vertices, faces).sum()),
    }


def _topology(vertices: Floats, faces: Ints) -> dict[str, Fact]:
    """Return facts of edges, vertices and pieces, and volume and genus if they are defined.

    The genus is the sum over all pieces, by Euler's formula for closed surfaces.
    """
    faults = triangles.edge_faults(faces)
    touching = triangles.touching_vertices(faces)
    pieces = triangles.face_pieces(faces)
    count = int(pieces.max(initial=-1)) + 1
    euler = triangles.euler_characteristic(faces)
    is_solid = count > 0 and not any(faults)
    return {
        "is_manifold": count > 0 and not faults.boundary and not faults.non_manifold,
        "is_oriented": not faults.misoriented and not faults.non_manifold,
        "boundary_edges": faults.boundary,
        "non_manifold_edges": faults.non_manifold,
        "misoriented_edges": faults.misoriented,
        "touching_vertices": touching,
        "pieces": count,
        "euler": euler,
        "genus": count - euler // 2 if is_solid and not touching else None,
        "volume_mm3": float(triangles.piece_volumes(vertices, faces, pieces).sum()) if is_solid else None,
    }


def _intersections(vertices: Floats, faces: Ints, name: str) -> dict[str, Fact]:
    try:
        found = call_in_child(
            self_intersections.find_self_intersections,
            {"vertices": vertices, "faces": faces[~triangles.flat_faces(vertices, faces)]},
            {},
            seconds=_SEARCH_SECONDS,
            about=f"self-intersections of {name} are not counted",
        )
    except StageError as error:
        return {"self_intersecting_faces": None, "self_intersecting_faces_note": str(error)}
    return {"self_intersecting_faces": len(found["faces"])}


def _manifold_status(vertices: Floats, faces: Ints) -> str:
    """Return manifold3d's status of the surface as a solid: `NoError`, `NotManifold`, ..."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(vertices), np.array(faces, dtype=np.uint64))
    return str(manifold3d.Manifold(mesh).status()).rpartition(".")[2]
