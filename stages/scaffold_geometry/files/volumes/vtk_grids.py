"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), read by VTK in a child process, as VTK may crash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.files.text import AGAIN, space_in
from scaffold_geometry.files.volumes.blocks import Block, Blocks, ElementType, element_type
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

_SHAPES = {
    "point": (1, 2),
    "line": (3, 4, 21, 35, 60, 68, 75),
    "triangle": (5, 6, 22, 34, 61, 69, 76),
    "quadrangle": (8, 9, 23, 28, 30, 62, 70, 77),
    "tetrahedron": (10, 24, 64, 71, 78),
    "pyramid": (14, 27, 37, 66, 74, 81),
    "wedge": (13, 26, 31, 32, 65, 73, 80),
    "hexahedron": (12, 25, 29, 33, 67, 72, 79),
}
"""VTK's cell types of each shape: linear, quadratic, cubic, and Lagrange and Bezier cells of any order."""

_TYPES = {
    **{number: element_type(shape, 0) for shape, numbers in _SHAPES.items() for number in numbers},
    **{number: ElementType("polygon", 2, None, 0) for number in (7, 36)},
    15: ElementType("pentagonal prism", 3, None, 10),
    16: ElementType("hexagonal prism", 3, None, 12),
    41: ElementType("convex point set", 3, None, 0),
    42: ElementType("polyhedron", 3, None, 0),
}

_EMPTY, _VOXEL = 0, 11
_HEXAHEDRON_OF_VOXEL = [0, 1, 3, 2, 4, 5, 7, 6]
"""The corners of a voxel are numbered row by row, those of a hexahedron around its faces."""


def read_vtk_grid(path: Path) -> Blocks:
    """Read the unstructured grid of the file `path`."""
    about = f"{path.name} cannot be read; export it again, as an unstructured grid, or download it again"
    grid = call_in_child(vtk_grid, {}, {"path": str(path.resolve())}, seconds=READING_SECONDS, about=about)
    types, offsets, nodes = grid["types"], grid["offsets"], grid["nodes"]
    sizes = np.diff(offsets)
    if (
        len(sizes) != len(types)
        or (sizes < 0).any()
        or (len(offsets) and not offsets[0] == 0 <= offsets[-1] <= len(nodes))
    ):
        raise StageError(f"{path.name}: the numbers of cells, types and nodes do not match; {AGAIN}")
    hidden = np.zeros(len(types), dtype=bool)
    if grid["of_cells"].any() or grid["of_points"].any():
        hidden = find_hidden_cells(nodes[: offsets[-1]], sizes, grid["of_cells"], grid["of_points"])
    blocks = [
        _block(int(number), int(size), nodes, offsets[:-1][(types == number) & (sizes == size) & ~hidden])
        for number, size in np.unique(np.column_stack([types, sizes])[~hidden], axis=0)
        if number != _EMPTY
    ]
    count = int(hidden.sum())
    notes = (f"left out {count} cells that the file marks as hidden or as copies (vtkGhostType)",) if count else ()
    return Blocks(grid["points"], blocks, notes, space_in(bytes(grid["space"])))


def _block(number: int, size: int, nodes: NDArray[np.int64], starts: NDArray[np.int64]) -> Block:
    """Return the cells of type `number` with `size` nodes that begin in `nodes` at `starts`."""
    rows = nodes[starts[:, None] + np.arange(size)]
    if number == _VOXEL and size == len(_HEXAHEDRON_OF_VOXEL):
        return Block(element_type("hexahedron", size), len(rows), rows[:, _HEXAHEDRON_OF_VOXEL])
    of_type = _TYPES.get(number, ElementType(f"cell of VTK's type {number}", 3, None, 0))
    return Block(of_type._replace(nodes=size), len(rows), rows)


def vtk_grid(*, path: str) -> dict[str, NDArray[Any]]:
    """Return `points` (n, 3), `types` (m,), `offsets` (m + 1,) and `nodes` of a file; runs in a child process."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOLegacy import vtkDataSetReader
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader = vtkXMLUnstructuredGridReader() if path.lower().endswith(".vtu") else vtkDataSetReader()
    complaint = update_reader(reader, path)
    if "error" in complaint.lower():  # VTK then returns the part of the cells that it could read
        raise StageError(f"VTK reports: {first_complaint(complaint)}")
    grid = reader.GetOutput()
    if grid is None or not grid.IsA("vtkUnstructuredGrid"):
        kind = grid.GetClassName() if grid is not None else "nothing"
        raise StageError(f"must contain an unstructured grid, got {kind}")
    if not grid.GetNumberOfCells() or not grid.GetNumberOfPoints():
        names = ("types", "offsets", "nodes", "of_cells", "of_points", "space")
        return {"points": np.empty((0, 3)), **{name: np.empty(0, np.int64) for name in names}}
    of_cells, of_points = ghost_types(grid)
    return {
        "points": vtk_to_numpy(grid.GetPoints().GetData()).astype(np.float64),
        "types": np.array([grid.GetCellType(i) for i in range(grid.GetNumberOfCells())], np.int64),
        "offsets": vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64),
        "nodes": vtk_to_numpy(grid.GetCells().GetConnectivityArray()).astype(np.int64),
        "of_cells": of_cells,
        "of_points": of_points,
        "space": np.frombuffer(space_of(grid, reader), np.uint8),
    }
