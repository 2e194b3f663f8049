"""VTK's files mark cells that are not there, and axes: the first are dropped by number, the second told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import VTK_HEXAHEDRON, vtkCellArray, vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

from scaffold_geometry.files.surfaces.reading import read_surface
from scaffold_geometry.files.volumes.reading import read_volume
from shapes import ball, hexahedra

VERTICES, FACES = ball(7.0, divisions=2)
MESH = hexahedra((3, 2, 2), 5.0)
WRITERS = {
    ".vtp": vtkXMLPolyDataWriter,
    ".vtk": vtkPolyDataWriter,
    ".vtu": vtkXMLUnstructuredGridWriter,
    "grid.vtk": vtkUnstructuredGridWriter,
}


def cell_array(cells: np.ndarray):
    array = vtkCellArray()
    offsets = numpy_to_vtkIdTypeArray(np.arange(0, cells.size + 1, cells.shape[1]), deep=True)
    array.SetData(offsets, numpy_to_vtkIdTypeArray(cells.ravel(), deep=True))
    return array


def with_points(data, vertices: np.ndarray):
    points = vtkPoints()
    points.SetData(numpy_to_vtk(vertices, deep=True))
    data.SetPoints(points)
    return data


def surface(vertices: np.ndarray = VERTICES, faces: np.ndarray = FACES):
    data = with_points(vtkPolyData(), vertices)
    data.SetPolys(cell_array(faces))
    return data


def grid():
    data = with_points(vtkUnstructuredGrid(), MESH.vertices)
    data.SetCells(VTK_HEXAHEDRON, cell_array(MESH.hexahedra))
    return data


def mark(attributes, values: np.ndarray, name: str = "vtkGhostType"):
    array = numpy_to_vtk(np.asarray(values, np.uint8), deep=True)
    array.SetName(name)
    attributes.AddArray(array)


def written(path: Path, data, title: str = ""):
    writer = WRITERS["grid.vtk" if path.suffix == ".vtk" and data.IsA("vtkUnstructuredGrid") else path.suffix]()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    if title:
        writer.SetHeader(title)
    writer.Write()
    return path


THERE, GONE = (2, 4), (1, 8, 16, 32, 33)
"""Bits of a cell: of high or low connectivity; a copy, refined, outside, hidden."""


@pytest.mark.parametrize("suffix", [".vtp", ".vtk"])
@pytest.mark.parametrize("bit", [*THERE, *GONE])
def test_polygons_that_are_copies_or_hidden_are_left_out_and_said_so(tmp_path: Path, suffix: str, bit: int):
    data = surface()
    mark(data.GetCellData(), np.where(np.arange(len(FACES)) < 10, bit, 0))
    found = read_surface(written(tmp_path / f"a{suffix}", data))
    assert np.array_equal(found.faces, FACES if bit in THERE else FACES[10:])
    said = "left out 10 polygons that the file marks as hidden or duplicate (vtkGhostType)"
    assert (said in found.notes) == (bit in GONE)


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize(("name", "value"), [("vtkGhostType", 1), ("vtkGhostType", 32), ("vtkGhostLevels", 2)])
def test_cells_that_are_copies_or_hidden_are_left_out_and_said_so(tmp_path: Path, suffix: str, name: str, value: int):
    data = grid()
    mark(data.GetCellData(), np.where(np.arange(12) < 4, value, 0), name)
    found = read_volume(written(tmp_path / f"a{suffix}", data))
    assert np.array_equal(found.cells["hexahedron"], MESH.hexahedra[4:])
    assert any(note.startswith("left out 4 cells that the file marks as hidden") for note in found.notes)


def test_a_hidden_point_hides_the_cells_at_it_and_a_copied_one_does_not(tmp_path: Path):
    for bit, gone in ((2, 1), (1, 0)):
        data = grid()
        mark(data.GetPointData(), np.where(np.arange(len(MESH.vertices)) == MESH.hexahedra[0, 0], bit, 0))
        found = read_volume(written(tmp_path / "a.vtu", data))
        assert len(found.cells["hexahedron"]) == 12 - gone


def test_strips_are_cut_into_triangles(tmp_path: Path):
    data = with_points(vtkPolyData(), VERTICES)
    data.SetStrips(cell_array(np.array([[0, 1, 2, 3, 4]])))
    mark(data.GetCellData(), np.array([0]))
    found = read_surface(written(tmp_path / "a.vtp", data))
    assert found.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]


def test_anatomical_axes_of_a_title_or_a_field_are_told(tmp_path: Path):
    assert read_surface(written(tmp_path / "a.vtk", surface(), "3D Slicer output. SPACE=LPS")).space == "LPS"
    assert read_volume(written(tmp_path / "b.vtk", grid(), "3D Slicer output. SPACE=RAS")).space == "RAS"
    data = surface()
    field = vtkStringArray()
    field.SetName("SPACE")
    field.InsertNextValue("RAS")
    data.GetFieldData().AddArray(field)
    assert read_surface(written(tmp_path / "a.vtp", data)).space == "RAS"
    assert read_surface(written(tmp_path / "c.vtp", surface())).space is None


@pytest.mark.parametrize("suffix", [".vtp", ".vtk"])
@pytest.mark.parametrize(("encoding", "line_end"), [("utf-8-sig", "\n"), ("utf-16", "\r\n"), ("utf-8", "\r")])
def test_text_may_have_any_line_ends_and_byte_order_mark(tmp_path: Path, suffix: str, encoding: str, line_end: str):
    writer = WRITERS[suffix]()
    writer.SetFileName(str(tmp_path / f"plain{suffix}"))
    writer.SetInputData(surface())
    writer.SetDataModeToAscii() if suffix == ".vtp" else writer.SetFileTypeToASCII()
    writer.Write()
    text = (tmp_path / f"plain{suffix}").read_text(encoding="utf-8")
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text.replace("\n", line_end).encode(encoding))
    assert np.array_equal(read_surface(path).faces, FACES)
