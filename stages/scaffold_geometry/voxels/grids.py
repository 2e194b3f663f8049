"""Regular grids over a shape: where their samples lie, and which of them lie inside."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints


def grid_over(bounds: Floats, spacing: float, margin: int) -> tuple[Floats, tuple[int, int, int]]:
    """Return origin (3,) and shape of the grid that covers `bounds` (2, 3) and `margin` samples more on each side.

    The grid is centred on the bounds, so that a symmetric shape gets a symmetric grid.
    """
    size = bounds[1] - bounds[0]
    intervals = np.ceil(size / spacing - 1e-9).astype(int) + 2 * margin
    origin = bounds.mean(axis=0) - spacing * intervals / 2.0
    return origin, (int(intervals[0]) + 1, int(intervals[1]) + 1, int(intervals[2]) + 1)


def samples_inside(vertices: Floats, faces: Ints, origin: Floats, spacing: float, shape: tuple[int, int, int]) -> Bools:
    """Tell which samples of a grid lie inside a closed surface, (nx, ny, nz): VTK's scan-line stencil."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

    stencil = vtkPolyDataToImageStencil()
    stencil.SetInputData(_poly_data(vertices - origin, faces))
    stencil.SetOutputSpacing(spacing, spacing, spacing)
    stencil.SetOutputOrigin(0.0, 0.0, 0.0)
    stencil.SetOutputWholeExtent(0, shape[0] - 1, 0, shape[1] - 1, 0, shape[2] - 1)
    stencil.SetTolerance(0.0)
    image = vtkImageStencilToImage()
    image.SetInputConnection(stencil.GetOutputPort())
    image.SetOutputScalarTypeToUnsignedChar()
    image.SetInsideValue(1)
    image.SetOutsideValue(0)
    image.Update()
    flat = vtk_to_numpy(image.GetOutput().GetPointData().GetScalars())
    return np.ascontiguousarray(flat.reshape(shape, order="F")).astype(bool)


def _poly_data(vertices: Floats, faces: Ints) -> object:
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    points, cells, surface = vtkPoints(), vtkCellArray(), vtkPolyData()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
    starts = np.arange(0, 3 * len(faces) + 1, 3, dtype=np.int64)
    corners = np.array(faces, np.int64).ravel()
    cells.SetData(numpy_to_vtkIdTypeArray(starts, deep=True), numpy_to_vtkIdTypeArray(corners, deep=True))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    return surface


def dilate(inside: Bools, steps: int) -> Bools:
    """Return the samples within `steps` of `inside`, diagonal neighbours included."""
    result = inside.copy()
    for axis in range(inside.ndim):
        before, line = result.copy(), np.moveaxis(result, axis, 0)
        given = np.moveaxis(before, axis, 0)
        for step in range(1, steps + 1):
            line[step:] |= given[:-step]
            line[:-step] |= given[step:]
    return result
