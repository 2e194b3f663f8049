"""Read one surface file into triangles, or raise a one-line error.

Simple formats have readers of their own, as other libraries often return an empty or incomplete mesh for a damaged file
without an error; lib3mf reads 3MF, and VTK its own formats, in child processes, which may crash. Nothing is merged,
removed or flipped: the triangles are those of the file, with larger polygons cut into triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.inputs import reader_of
from scaffold_geometry.files.surfaces.gltf import read_gltf
from scaffold_geometry.files.surfaces.obj import read_obj
from scaffold_geometry.files.surfaces.off import read_off
from scaffold_geometry.files.surfaces.ply import read_ply
from scaffold_geometry.files.surfaces.polygons import Polygons
from scaffold_geometry.files.surfaces.stl import read_stl
from scaffold_geometry.files.surfaces.three_mf import read_three_mf
from scaffold_geometry.files.surfaces.triangulation import cut_polygons
from scaffold_geometry.files.surfaces.vtk_polydata import read_vtk_polydata
from scaffold_geometry.files.text import AGAIN, quote
from scaffold_geometry.files.vtk_reading import READING_SECONDS
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import call_in_child

MILLIMETRES = {"micron": 1e-3, "mm": 1.0, "cm": 10.0, "inch": 25.4, "foot": 304.8, "m": 1000.0}
"""Length of each unit, mm."""


class SurfaceFile(NamedTuple):
    """The content of a file: `vertices` (n, 3) in the file's unit, `faces` (m, 3), and the unit if the file states it.

    `up` is the up axis of the format, y or z, and `space` the anatomical axes named in the file, RAS or LPS.
    """

    vertices: Floats
    faces: Ints
    unit: str | None
    up: str
    space: str | None
    notes: tuple[str, ...]


def read_surface(path: Path) -> SurfaceFile:
    """Read the surface file `path`; raises `StageError` for an invalid file, and warns of unusual content."""
    reader = reader_of(path, READERS, "surface")
    with np.errstate(all="ignore"):  # invalid numbers are refused below
        polygons = reader(path)
    _require_faces(polygons, path)
    for doubt in polygons.doubts:
        warn(f"{path.name}: {doubt}")
    larger = int((polygons.sizes > 3).sum())  # corners of a triangle
    faces = _triangles(polygons, path) if larger else polygons.corners.reshape(-1, 3)
    notes = [f"read {len(faces)} triangles over {len(polygons.vertices)} vertices from {path.suffix[1:].upper()}"]
    notes += [*polygons.notes, *polygons.doubts]
    if larger:
        notes.append(f"cut {larger} polygons of more than three corners into triangles")
    missing = int((polygons.sizes - 2).sum()) - len(faces)
    if missing:
        notes.append(f"{missing} triangles are missing from polygons that could not be cut")
    if polygons.space:
        notes.append(f"its header gives the axes as {polygons.space}; the coordinates are not changed")
    return SurfaceFile(polygons.vertices, faces, polygons.unit, polygons.up, polygons.space, tuple(notes))


def turn_up(vertices: Floats) -> Floats:
    """Return vertices (n, 3) rotated about x, so that the y axis becomes z, up."""
    x, y, z = vertices.T
    return np.column_stack([x, -z, y])


def _require_faces(polygons: Polygons, path: Path) -> None:
    if not len(polygons.sizes):
        start = path.read_bytes()[:30].splitlines()[0]
        raise StageError(
            f"{path.name}: has no triangles (it begins with {quote(start)}); is it a surface, "
            f"and in the format {path.suffix[1:].upper()}?"
        )
    bad = int((~np.isfinite(polygons.vertices)).any(axis=1).sum())
    if bad:
        raise StageError(f"{path.name}: {bad} of {len(polygons.vertices)} vertices are NaN or infinite; {AGAIN}")
    least, greatest = int(polygons.corners.min()), int(polygons.corners.max())
    if least < 0 or greatest >= len(polygons.vertices):
        raise StageError(
            f"{path.name}: faces name vertices {least}..{greatest}, but those of the file are "
            f"0..{len(polygons.vertices) - 1}; {AGAIN}"
        )


def _triangles(polygons: Polygons, path: Path) -> Ints:
    about = f"the polygons of {path.name} cannot be cut into triangles; export it as triangles"
    arrays = {"vertices": polygons.vertices, "corners": polygons.corners, "sizes": polygons.sizes}
    return call_in_child(cut_polygons, arrays, {}, seconds=READING_SECONDS, about=about)["faces"]


READERS: dict[str, Callable[[Path], Polygons]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    ".3mf": read_three_mf,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".vtp": read_vtk_polydata,
    ".vtk": read_vtk_polydata,
}
