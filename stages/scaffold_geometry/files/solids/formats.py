"""The formats, each with its writer and the two programs that read it back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scaffold_geometry.files.solids import glb, obj, ply, stl, three_mf
from scaffold_geometry.files.solids.model import Mesh, Model


@dataclass(frozen=True)
class FileFormat:
    """The writer of a format, and its readers by their names.

    At least one reader is independent of the writer, as a writer and reader of one library can share an error. VTK's
    readers are last, as they end the process on a file that is cut off: another reader has then found it complete.
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
