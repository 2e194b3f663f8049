"""Binary STL: float32 triangles; the unit is only in the header text."""

from __future__ import annotations

from pathlib import Path

from scaffold_geometry.files.binary_stl import to_stl
from scaffold_geometry.files.solids.model import APPLICATION, Mesh, Model, mesh_of_corners
from scaffold_geometry.files.solids.readers import mesh_by_vtk, reading


def write(path: Path, model: Model) -> None:
    """Write the model as binary STL."""
    path.write_bytes(to_stl(*model.mesh, f"{APPLICATION}, unit: mm"))


def read_by_trimesh(path: Path) -> Mesh:
    """Return the mesh read by trimesh, with corners of equal coordinates merged."""
    from trimesh.exchange.stl import load_stl_binary

    with reading("STL", "trimesh"), path.open("rb") as stream:
        loaded = load_stl_binary(stream)
    return mesh_of_corners(loaded["vertices"][loaded["faces"]])


def read_by_vtk(path: Path) -> Mesh:
    """Return the mesh read by VTK, with corners of equal coordinates merged."""
    from vtkmodules.vtkIOGeometry import vtkSTLReader

    reader = vtkSTLReader()
    reader.MergingOff()
    vertices, faces = mesh_by_vtk(reader, path, "STL")
    return mesh_of_corners(vertices[faces])
