"""PLY: binary, little-endian, float32; the unit is in a comment (Turk, "The PLY polygon file format", 1994)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scaffold_geometry.files.solids.model import Mesh, Model
from scaffold_geometry.files.solids.readers import mesh_by_trimesh, mesh_by_vtk

_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write(path: Path, model: Model) -> None:
    """Write the model as PLY, not by trimesh, which writes no comments for the unit and the configuration's hash."""
    vertices, faces = model.mesh
    comments = [f"comment {name}: {value}" for name, value in model.notes.items()]
    header = [
        *("ply", "format binary_little_endian 1.0", *comments),
        *(f"element vertex {len(vertices)}", "property float x", "property float y", "property float z"),
        *(f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"),
    ]
    records = np.empty(len(faces), _FACE)
    records["count"], records["corners"] = 3, faces
    with path.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        stream.write(vertices.astype("<f4").tobytes())
        stream.write(records.tobytes())


def read_by_trimesh(path: Path) -> Mesh:
    """Return the mesh read by trimesh."""
    return mesh_by_trimesh(path, "PLY")


def read_by_vtk(path: Path) -> Mesh:
    """Return the mesh read by VTK."""
    from vtkmodules.vtkIOPLY import vtkPLYReader

    return mesh_by_vtk(vtkPLYReader(), path, "PLY")
