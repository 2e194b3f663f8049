"""The formats: who writes each, and the two programs that read it back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scaffold_geometry.files.solids import glb, obj, ply, stl, three_mf
from scaffold_geometry.files.solids.model import Mesh, Model


@dataclass(frozen=True)
class FileFormat:
    """How to write a model to a file, and how others read it, by their names.

    Each file has a reader that had no part in writing it: one that comes with its writer would share what both get
    wrong. Readers go in order, so that VTK's, which end the process on a file that is cut off, see only what another
    has found whole.
    """

    write: Callable[[Path, Model], None]
    readers: dict[str, Callable[[Path], Mesh]]


FORMATS = {
    "stl": FileFormat(stl.write, {"trimesh": stl.read_by_trimesh, "VTK": stl.read_by_vtk}),
    "3mf": FileFormat(three_mf.write, {"lib3mf": three_mf.read_by_lib3mf, "expat": three_mf.read_by_expat}),
    "obj": FileFormat(obj.write, {"trimesh": obj.read_by_trimesh, "VTK": obj.read_by_vtk}),
    "ply": FileFormat(ply.write, {"trimesh": ply.read_by_trimesh, "VTK": ply.read_by_vtk}),
    "glb": FileFormat(glb.write, {"trimesh": glb.read_by_trimesh, "VTK": glb.read_by_vtk}),
}
