"""Meshes and fields to and from trimesh and pyvista; no other module of the engine uses these libraries.

They are imported when they are used: a run without conversions does not load them here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from scaffold_pipeline.artifacts.cells import CELL_TYPES, Floats, Ints
from scaffold_pipeline.errors import StageError, warn

if TYPE_CHECKING:
    import pyvista
    import trimesh

    from scaffold_pipeline.artifacts.cell_meshes import CellMesh
    from scaffold_pipeline.artifacts.fields import ScalarField
    from scaffold_pipeline.artifacts.meshes import SurfaceMesh

_VTK_NUMBERS = {"triangle": 5, "quadrangle": 9, "tetrahedron": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14}
"""VTK's numbers of the cell types; corners are in its order."""

_SMALLEST = 1.0
"""The longest side of a surface, mm, below which it may be in metres: a metre of bone is the most there is."""

_MILLIMETRES = {None, "mm", "millimeter", "millimeters", "millimetre", "millimetres"}


def surface_to_trimesh(surface: SurfaceMesh) -> trimesh.Trimesh:
    """Return the surface as a `trimesh.Trimesh` in mm: the same vertices and faces in the same order."""
    import trimesh

    mesh = trimesh.Trimesh(surface.vertices.copy(), surface.faces.copy(), process=False)
    mesh.units = "mm"
    return mesh


def surface_from_trimesh(mesh: object) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) mm and faces (m, 3) of a `trimesh.Trimesh`.

    Raises `StageError` for other types, such as a scene, and for a mesh whose `units` are not mm.
    """
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh):
        remedy = "; join its parts with mesh.to_mesh()" if isinstance(mesh, trimesh.Scene) else ""
        raise StageError(f"from_trimesh: must be a trimesh.Trimesh, got {_kind(mesh)}{remedy}")
    if mesh.units not in _MILLIMETRES:
        raise StageError(f"from_trimesh: must be in mm, got {mesh.units!r}; call mesh.convert_units('mm') first")
    vertices = np.array(mesh.vertices, np.float64)
    if mesh.units is None:
        _warn_of_odd_size(vertices, "from_trimesh", "mesh.apply_scale(1000)")
    return vertices, np.array(mesh.faces, np.int64)


def surface_to_pyvista(surface: SurfaceMesh) -> pyvista.PolyData:
    """Return the surface as a `pyvista.PolyData`, mm."""
    import pyvista

    return pyvista.PolyData.from_regular_faces(surface.vertices.copy(), surface.faces.copy())


def surface_from_pyvista(mesh: object) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) mm and faces (m, 3) of a `pyvista.PolyData`, polygons cut into triangles.

    Raises `StageError` for other types, and for a mesh with lines or points, or without faces.
    """
    import pyvista

    if not isinstance(mesh, pyvista.PolyData):
        remedy = "; take mesh.extract_surface()" if isinstance(mesh, pyvista.DataSet) else ""
        raise StageError(f"from_pyvista: must be a pyvista.PolyData, got {_kind(mesh)}{remedy}")
    others = {"points": mesh.n_verts, "lines": mesh.n_lines, "strips": mesh.n_strips}
    if any(others.values()) or not mesh.n_cells:
        found = ", ".join(f"{count} {name}" for name, count in others.items() if count) or "no faces"
        remedy = "; take mesh.triangulate()" if mesh.n_strips and not (mesh.n_verts or mesh.n_lines) else ""
        raise StageError(f"from_pyvista: must hold faces and nothing else, but it has {found}{remedy}")
    triangles = mesh if mesh.is_all_triangles else mesh.triangulate()
    vertices = np.array(triangles.points, np.float64)
    _warn_of_odd_size(vertices, "from_pyvista", "mesh.scale(1000, inplace=True)")
    return vertices, np.array(triangles.regular_faces, np.int64)


def _warn_of_odd_size(vertices: Floats, place: str, remedy: str) -> None:
    """Warn where a mesh that says no unit is smaller than any bone is in mm: bones are often stored in metres."""
    longest = float(np.ptp(vertices, axis=0).max(initial=0.0)) if len(vertices) else _SMALLEST
    if longest < _SMALLEST:  # not a number compares as false, and is refused next
        warn(f"{place}: the longest side is {longest:.4g} mm: is the mesh in mm? From metres, call {remedy}")


def cells_to_pyvista(mesh: CellMesh) -> pyvista.UnstructuredGrid:
    """Return the cells as a `pyvista.UnstructuredGrid`, mm."""
    import pyvista

    cells = {_VTK_NUMBERS[kind]: corners.copy() for kind, corners in mesh.cells.items()}
    return pyvista.UnstructuredGrid(cells, mesh.vertices.copy())


def cells_from_pyvista(grid: object, *, is_planar: bool) -> tuple[Floats, dict[str, Ints]]:
    """Return the vertices (n, 3) mm and the cells, by plural name, of a `pyvista.UnstructuredGrid`.

    Points, edges and, among solid cells, faces are left out, as are vertices that no cell has. Raises `StageError`
    for other types, and for cells of other kinds, such as those of second order.
    """
    import pyvista

    if not isinstance(grid, pyvista.UnstructuredGrid):
        remedy = "; take mesh.cast_to_unstructured_grid()" if isinstance(grid, pyvista.Grid) else ""
        raise StageError(f"from_pyvista: must be a pyvista.UnstructuredGrid, got {_kind(grid)}{remedy}")
    kinds = {number: CELL_TYPES[kind] for kind, number in _VTK_NUMBERS.items()}
    fitting = {number: kind for number, kind in kinds.items() if kind.is_planar == is_planar}
    others = [number for number in np.unique(grid.celltypes) if number not in fitting]
    foreign = [pyvista.CellType(number).name for number in others if not _is_lesser(number, is_planar=is_planar)]
    if foreign:
        rule = f"must hold {', '.join(kind.plural for kind in fitting.values())}"
        raise StageError(f"from_pyvista: {rule}, but it has cells of type {', '.join(foreign)}")
    found = {fitting[number].plural: cells for number, cells in grid.cells_dict.items() if number in fitting}
    return _without_unused(np.array(grid.points, np.float64), found)


def field_to_pyvista(field: ScalarField) -> pyvista.ImageData:
    """Return the field as a `pyvista.ImageData`, mm, its values as the point data `field`."""
    import pyvista

    image = pyvista.ImageData(dimensions=field.values.shape, spacing=(field.spacing,) * 3, origin=tuple(field.origin))
    image.point_data["field"] = field.values.ravel(order="F")  # VTK's first axis is the fastest
    return image


def _is_lesser(number: int, *, is_planar: bool) -> bool:
    """Return whether VTK's cell type `number` has fewer dimensions than the requested cells."""
    vertex_to_polyline, triangle_to_quadrangle = range(5), range(5, 10)
    return number in vertex_to_polyline or (not is_planar and number in triangle_to_quadrangle)


def _without_unused(vertices: Floats, cells: dict[str, Any]) -> tuple[Floats, dict[str, Ints]]:
    is_used = np.zeros(len(vertices), bool)
    for corners in cells.values():
        is_used[corners] = True
    numbers = np.cumsum(is_used) - 1
    return vertices[is_used], {name: np.asarray(numbers[corners], np.int64) for name, corners in cells.items()}


def _kind(value: object) -> str:
    return f"{type(value).__module__.partition('.')[0]}.{type(value).__qualname__}"
