"""Tetrahedral meshes of the solid as VTU and as Abaqus input, coordinates in mm as float64."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scaffold_geometry.files.solids.model import APPLICATION, Text, rows
from scaffold_geometry.files.volumes.reading import read_volume
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.errors import StageError

_VTK_TETRAHEDRON = 10


def write_vtu(path: Path, mesh: VolumeMesh) -> None:
    """Write the mesh by VTK: float64 points, int64 cells, compressed."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    corners = mesh.tetrahedra
    points, cells = vtkPoints(), vtkCellArray()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(mesh.vertices, deep=True))
    offsets = np.arange(0, corners.size + 1, corners.shape[1], dtype=np.int64)
    cells.SetData(*(numpy_to_vtkIdTypeArray(numbers, deep=True) for numbers in (offsets, corners.ravel())))
    grid = vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.SetCells(_VTK_TETRAHEDRON, cells)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.SetHeaderTypeToUInt64()
    if not writer.Write():
        raise StageError("cannot be written; is the disk full?")


def write_inp(path: Path, mesh: VolumeMesh) -> None:
    """Write the mesh as C3D4, nodes and elements numbered from 1 (Abaqus Keywords Guide, *NODE and *ELEMENT)."""
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(_inp_text(mesh))


def _inp_text(mesh: VolumeMesh) -> Text:
    """Yield the input file: 17 digits restore each coordinate exactly."""
    yield f"*HEADING\n{APPLICATION}, unit: mm\n*NODE, NSET=ALL\n"
    numbers = np.arange(1.0, len(mesh.vertices) + 1.0)
    yield from rows("%d, %.17g, %.17g, %.17g\n", np.column_stack([numbers, mesh.vertices]))
    yield "*ELEMENT, TYPE=C3D4, ELSET=SOLID\n"
    corners = mesh.tetrahedra + 1
    yield from rows("%d, %d, %d, %d, %d\n", np.column_stack([np.arange(1, len(corners) + 1), corners]))


WRITERS = {"vtu": write_vtu, "inp": write_inp}


def require_read_back(path: Path, mesh: VolumeMesh) -> None:
    """Require that `load_volume_mesh` reads the mesh from the file, equal to the bit; raises `StageError`."""
    found = read_volume(path)
    if set(found.cells) != {"tetrahedron"} or not np.array_equal(found.cells["tetrahedron"], mesh.tetrahedra):
        raise StageError("must have the mesh's tetrahedra in their order, but others were read back")
    if found.vertices.shape != mesh.vertices.shape:
        raise StageError(f"must have {len(mesh.vertices)} points, but {len(found.vertices)} were read back")
    if not np.array_equal(found.vertices, mesh.vertices):
        moved = np.abs(found.vertices - mesh.vertices)
        raise StageError(
            f"must have the mesh's coordinates to the bit, but {int(moved.any(axis=1).sum())} of {len(moved)} points "
            f"differ, by up to {moved.max():.3g} mm"
        )
