"""Wavefront OBJ: text; nine digits restore each float32 exactly; the unit is in a comment."""

from __future__ import annotations

from pathlib import Path

from scaffold_geometry.files.solids.model import Mesh, Model, Text, rows
from scaffold_geometry.files.solids.readers import mesh_by_trimesh, mesh_by_vtk


def write(path: Path, model: Model) -> None:
    """Write the model as OBJ, not by trimesh, which writes eight decimals, too few near the origin."""
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(_text(model))


def _text(model: Model) -> Text:
    for name, value in model.notes.items():
        yield f"# {name}: {value}\n"
    yield "o solid\n"
    yield from rows("v %.9g %.9g %.9g\n", model.mesh.vertices)
    yield from rows("f %d %d %d\n", model.mesh.faces + 1)


def read_by_trimesh(path: Path) -> Mesh:
    """Return the mesh read by trimesh."""
    return mesh_by_trimesh(path, "OBJ")


def read_by_vtk(path: Path) -> Mesh:
    """Return the mesh read by VTK."""
    from vtkmodules.vtkIOGeometry import vtkOBJReader

    return mesh_by_vtk(vtkOBJReader(), path, "OBJ")
