"""VTK's PolyData, XML (.vtp) and legacy (.vtk), read by VTK in a child process, which may crash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Ints
from scaffold_geometry.files.surfaces.polygons import Polygons, split_strip
from scaffold_geometry.files.text import space_in
from scaffold_geometry.files.vtk_reading import (
    READING_SECONDS,
    find_hidden_cells,
    first_complaint,
    ghost_types,
    space_of,
    update_reader,
)
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import call_in_child


def read_vtk_polydata(path: Path) -> Polygons:
    """Read the PolyData file `path`, without hidden and duplicate polygons and strips."""
    about = f"{path.name} cannot be read; export it again, as PolyData, or download it again"
    found = call_in_child(vtk_polygons, {}, {"path": str(path.resolve())}, seconds=READING_SECONDS, about=about)
    hidden = int(found["hidden"])
    notes = (f"left out {hidden} polygons that the file marks as hidden or duplicate (vtkGhostType)",) if hidden else ()
    space = space_in(bytes(found["space"]))
    return Polygons(found["vertices"], found["corners"], found["sizes"], space=space, notes=notes)


def vtk_polygons(*, path: str) -> dict[str, NDArray[Any]]:
    """Return `vertices`, `corners` and `sizes` of the PolyData file `path`; for the child process."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    reader = vtkXMLPolyDataReader() if path.lower().endswith(".vtp") else vtkPolyDataReader()
    complaint = update_reader(reader, path)
    if "error" in complaint.lower():
        # After an error VTK still returns a part of the surface.
        raise StageError(f"VTK says: {first_complaint(complaint)}")
    surface = reader.GetOutput()
    if not surface.GetNumberOfPolys() + surface.GetNumberOfStrips():
        empty = np.empty(0, np.int64)
        return {
            "vertices": np.empty((0, 3)),
            "corners": empty,
            "sizes": empty,
            "hidden": np.array(0),
            "space": np.empty(0, np.uint8),
        }
    corners, sizes, hidden = _visible_polygons(surface)
    return {
        "vertices": vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64),
        "corners": corners,
        "sizes": sizes,
        "hidden": np.array(hidden),
        "space": np.frombuffer(space_of(surface, reader), np.uint8),
    }


def _visible_polygons(surface: Any) -> tuple[Ints, Ints, int]:  # noqa: ANN401 - VTK's types are unknown to mypy
    """Return corners and sizes of the polygons and of the strips' triangles, and the number of hidden ones."""
    of_cells, of_points = ghost_types(surface)
    # The cells of a surface are vertices, lines, polygons and strips, in this order.
    first = surface.GetNumberOfVerts() + surface.GetNumberOfLines()
    middle = first + surface.GetNumberOfPolys()
    corners, sizes, hidden = _visible(surface.GetPolys(), of_cells[first:middle], of_points)
    in_strips, strip_sizes, hidden_strips = _visible(surface.GetStrips(), of_cells[middle:], of_points)
    faces = [split_strip(strip) for strip in np.split(in_strips, np.cumsum(strip_sizes)[:-1])]
    of_strips = np.concatenate([np.empty((0, 3), np.int64), *faces])
    corners = np.concatenate([corners, of_strips.ravel()])
    return corners, np.concatenate([sizes, np.full(len(of_strips), 3)]), hidden + hidden_strips


def _visible(cells: Any, of_cells: Ints, of_points: Ints) -> tuple[Ints, Ints, int]:  # noqa: ANN401
    """Return corners and sizes of the cells that are not hidden, and the number of hidden ones."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if not cells.GetNumberOfCells():
        return np.empty(0, np.int64), np.empty(0, np.int64), 0
    corners = vtk_to_numpy(cells.GetConnectivityArray()).astype(np.int64)
    sizes = np.diff(vtk_to_numpy(cells.GetOffsetsArray())).astype(np.int64)
    hidden = find_hidden_cells(corners, sizes, of_cells, of_points)
    return corners[np.repeat(~hidden, sizes)], sizes[~hidden], int(hidden.sum())
