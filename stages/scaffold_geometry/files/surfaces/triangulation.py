"""Triangulation of polygons in their own planes, convex or not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats, Ints

_FOLDED = 1e-9
"""Share of a polygon's area below which an inverted triangle is a rounding error."""


def cut_polygons(*, vertices: Floats, corners: Ints, sizes: Ints) -> dict[str, NDArray[Any]]:
    """Return `faces` (m, 3): the polygons cut into triangles by VTK, or by manifold3d if VTK fails or makes folds.

    Each polygon of k corners gives k - 2 triangles with its orientation, in the order of the polygons. To be called in
    a child process.
    """
    faces, polygon = _cut_with_vtk(vertices, corners, sizes)
    bad = _badly_cut(vertices, corners, sizes, faces, polygon)
    if not bad.any():
        return {"faces": faces}
    starts = np.cumsum(sizes) - sizes
    again = [
        cut_in_plane(vertices, corners[starts[k] : starts[k] + sizes[k]])
        for k in np.flatnonzero(bad)
    ]  # fmt: skip
    kept = ~bad[polygon]
    faces = np.concatenate([faces[kept], *again])
    polygon = np.concatenate([polygon[kept], np.repeat(np.flatnonzero(bad), [len(part) for part in again])])
    return {"faces": faces[np.argsort(polygon, kind="stable")]}


def _cut_with_vtk(vertices: Floats, corners: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Return triangles (m, 3) and the polygon of each, (m,)."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter

    points, polygons, surface = vtkPoints(), vtkCellArray(), vtkPolyData()
    points.SetData(numpy_to_vtk(vertices, deep=True))
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    polygons.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(corners, deep=True))
    surface.SetPoints(points)
    surface.SetPolys(polygons)
    numbers = numpy_to_vtkIdTypeArray(np.arange(len(sizes)), deep=True)
    numbers.SetName("polygon")
    surface.GetCellData().AddArray(numbers)
    cut = vtkTriangleFilter()
    cut.SetInputData(surface)
    cut.Update()
    found = cut.GetOutput()
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).astype(np.int64).reshape(-1, 3)
    return faces, vtk_to_numpy(found.GetCellData().GetArray("polygon")).astype(np.int64)


def _badly_cut(vertices: Floats, corners: Ints, sizes: Ints, faces: Ints, polygon: Ints) -> Bools:
    """Return which polygons lack triangles, or have an inverted one, (n,)."""
    normals = _area_vectors(vertices, corners, sizes)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    squares = np.einsum("ij,ij->i", normals, normals)
    facing = 0.5 * np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[polygon])
    is_against = np.bincount(polygon, weights=facing < -_FOLDED * squares[polygon], minlength=len(sizes)) > 0
    is_short = np.bincount(polygon, minlength=len(sizes)) != sizes - 2
    bad: Bools = (is_against | is_short) & (squares > 0.0)
    return bad


def _area_vectors(vertices: Floats, corners: Ints, sizes: Ints) -> Floats:
    """Return the vector area of each polygon, (n, 3): its normal times its area (Newell's method)."""
    starts = np.cumsum(sizes) - sizes
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    following = np.arange(len(corners)) + 1
    following[starts + sizes - 1] = starts
    first = vertices[corners[starts]][polygon]
    crossed = np.cross(vertices[corners] - first, vertices[corners[following]] - first)
    sums = [np.bincount(polygon, weights=part, minlength=len(sizes)) for part in crossed.T]
    return np.asarray(0.5 * np.stack(sums, axis=1), np.float64)


def cut_in_plane(vertices: Floats, corners: Ints) -> Ints:
    """Return the triangles (k - 2, 3) of one polygon with `corners` (k,), cut by manifold3d in the polygon's plane."""
    import manifold3d

    (normal,) = _area_vectors(vertices, corners, np.array([len(corners)]))
    normal = normal / np.linalg.norm(normal)
    along = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(along, normal)
    u /= np.linalg.norm(u)
    places = vertices[corners] - vertices[corners[0]]
    flat = np.column_stack([places @ u, places @ np.cross(normal, u)])
    found = np.asarray(manifold3d.triangulate([flat]), np.int64).reshape(-1, 3)
    return np.asarray(corners[found])
