"""Read one surface file into triangles, or say in one line why not.

STL, OBJ and OFF are read here, since what a reader makes of a damaged one is often a mesh that is silently
empty or short; trimesh reads PLY, 3MF and GLB; VTK reads its own formats, in a child process that may die.
Nothing is merged, dropped or turned: the triangles are those of the file, larger polygons cut into triangles.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.inputs import reader_of
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import call_in_child

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


MILLIMETRES = {"micron": 1e-3, "mm": 1.0, "cm": 10.0, "inch": 25.4, "foot": 304.8, "m": 1000.0}
"""How many mm each unit is."""

_UNIT_NAMES = {"millimeter": "mm", "centimeter": "cm", "meter": "m", "meters": "m"}
"""The words of 3MF and GLB, where they are not ours."""

READING_SECONDS = 120.0
"""VTK reads a million triangles in a few seconds: what takes longer never ends."""

_STL_HEADER, _STL_FACET = 84, 50


class SurfaceFile(NamedTuple):
    """What a file holds: `vertices` (n, 3) in the file's unit, `faces` (m, 3), the unit where it carries one."""

    vertices: Floats
    faces: Ints
    unit: str | None
    notes: tuple[str, ...]


class _Polygons(NamedTuple):
    """Faces of any number of corners: `corners` is their corner indices in a row, `sizes` how many each has."""

    vertices: Floats
    corners: Ints
    sizes: Ints
    unit: str | None = None


def read_surface(path: Path) -> SurfaceFile:
    """Read the surface file `path`; a `StageError` names what is wrong with it."""
    polygons = reader_of(path, _READERS, "surface")(path)
    _require_faces(polygons, path)
    larger = int((polygons.sizes > 3).sum())  # corners of a triangle
    faces = _triangles(polygons, path) if larger else polygons.corners.reshape(-1, 3)
    notes = [f"read {len(faces)} triangles over {len(polygons.vertices)} vertices from {path.suffix[1:].upper()}"]
    if larger:
        notes.append(f"cut {larger} polygons of more than three corners into triangles")
    missing = int((polygons.sizes - 2).sum()) - len(faces)
    if missing:
        notes.append(f"{missing} triangles are missing from polygons too crooked to cut")
    return SurfaceFile(polygons.vertices, faces, polygons.unit, tuple(notes))


def _require_faces(polygons: _Polygons, path: Path) -> None:
    if not len(polygons.sizes):
        start = path.read_bytes()[:30].decode("ascii", "replace").split("\n")[0]
        printable = "".join(letter if letter.isprintable() else "." for letter in start)
        raise StageError(
            f"{path.name}: holds no triangles (it begins with {printable!r}); is it a surface, "
            f"and really of the format {path.suffix[1:].upper()}?"
        )
    bad = int((~np.isfinite(polygons.vertices)).any(axis=1).sum())
    if bad:
        raise StageError(f"{path.name}: {bad} of {len(polygons.vertices)} vertices are NaN or infinite; {_AGAIN}")
    least, greatest = int(polygons.corners.min()), int(polygons.corners.max())
    if least < 0 or greatest >= len(polygons.vertices):
        raise StageError(
            f"{path.name}: faces name vertices {least}..{greatest}, but those of the file are "
            f"0..{len(polygons.vertices) - 1}; {_AGAIN}"
        )


_AGAIN = "the file is damaged, export or download it again"


def _triangle_soup(corners: Floats) -> _Polygons:
    """Return the polygons of triangles given by their own corners, (m, 3, 3)."""
    count = len(corners)
    return _Polygons(corners.reshape(-1, 3), np.arange(3 * count), np.full(count, 3))


def _read_stl(path: Path) -> _Polygons:
    content = path.read_bytes()
    announced = int.from_bytes(content[80:84], "little") if len(content) >= _STL_HEADER else -1
    if len(content) == _STL_HEADER + _STL_FACET * announced:
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        facets = np.frombuffer(content, facet, offset=_STL_HEADER)
        return _triangle_soup(facets["corners"].astype(np.float64))
    if content.lstrip()[:5].lower() == b"solid":
        return _read_ascii_stl(content, path.name)
    raise StageError(
        f"{path.name}: is no STL file or a damaged one: {len(content)} bytes, where its header announces "
        + (f"{_STL_HEADER + _STL_FACET * announced} ({announced} triangles)" if announced >= 0 else "more")
        + "; export or download it again"
    )


def _read_ascii_stl(content: bytes, name: str) -> _Polygons:
    words = re.findall(rb"\bvertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", content, re.IGNORECASE)
    begun = len(re.findall(rb"\bfacet\s+normal\b", content, re.IGNORECASE))
    ended = len(re.findall(rb"\bendfacet\b", content, re.IGNORECASE))
    is_whole = re.search(rb"endsolid[^\n]*\s*\Z", content, re.IGNORECASE)
    if begun != ended or len(words) != 3 * ended or not is_whole:
        raise StageError(
            f"{name}: its ASCII STL is cut off or damaged: {begun} facets begin, {ended} end, with {len(words)} "
            f"vertices{'' if is_whole else ' and no `endsolid` at the end'}; export or download it again"
        )
    return _triangle_soup(_to_floats(words, name).reshape(-1, 3, 3))


def _to_floats(words: list[Any], name: str) -> Floats:
    """Return words (n, 3) as numbers."""
    try:
        return np.array(words, dtype=np.bytes_).reshape(-1, 3).astype(np.float64)
    except ValueError as error:
        raise StageError(f"{name}: a vertex is not three numbers ({error}); {_AGAIN}") from error


def _read_obj(path: Path) -> _Polygons:
    vertices: list[list[bytes]] = []
    corners: list[int] = []
    sizes: list[int] = []
    lines = path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.split()
        if words[:1] == [b"v"]:
            vertices.append(_first_three(words[1:], path, number))
        elif words[:1] == [b"f"]:
            face = [_obj_index(word, len(vertices), path, number) for word in words[1:]]
            if len(face) < 3:  # corners of a triangle
                raise StageError(f"{path.name}:{number}: a face has {len(face)} corners, needs 3 or more; {_AGAIN}")
            corners += face
            sizes.append(len(face))
    return _Polygons(_to_floats(vertices, path.name), np.array(corners, np.int64), np.array(sizes, np.int64))


def _first_three(words: list[bytes], path: Path, line: int) -> list[bytes]:
    if len(words) < 3:  # coordinates of a vertex
        raise StageError(f"{path.name}:{line}: a vertex has {len(words)} coordinates, needs 3; {_AGAIN}")
    return words[:3]


def _obj_index(word: bytes, count: int, path: Path, line: int) -> int:
    """Return the vertex, from 0, that a face's `3/1/2` or `-1` names; OBJ counts from 1, or backwards."""
    try:
        index = int(word.partition(b"/")[0])
    except ValueError:
        index = 0
    if index == 0 or index < -count:
        raise StageError(f"{path.name}:{line}: {word.decode('ascii', 'replace')!r} names no vertex; {_AGAIN}")
    return index - 1 if index > 0 else count + index


def _read_off(path: Path) -> _Polygons:
    rows = _off_rows(path)
    header = next(rows, [])
    if not header or not re.fullmatch(rb"(ST)?C?N?OFF", header[0]) or b"BINARY" in header:
        raise StageError(f"{path.name}: is not an ASCII OFF file (no `OFF` in its first line); {_AGAIN}")
    try:
        n_vertices, n_faces = (int(word) for word in (header[1:] or next(rows, []))[:2])
        body = list(rows)
        if len(body) != n_vertices + n_faces:
            raise StageError(
                f"{path.name}: announces {n_vertices} vertices and {n_faces} faces, "
                f"but {len(body)} rows follow; {_AGAIN}"
            )
        faces = [[int(word) for word in row[: int(row[0]) + 1]] for row in body[n_vertices:]]
    except ValueError as error:
        raise StageError(f"{path.name}: a count or an index of its OFF is no whole number; {_AGAIN}") from error
    if any(len(face) != face[0] + 1 or face[0] < 3 for face in faces):  # corners of a triangle
        raise StageError(f"{path.name}: a face has fewer corners than it announces, or fewer than 3; {_AGAIN}")
    vertices = [_first_three(row, path, number) for number, row in enumerate(body[:n_vertices], 1)]
    corners = [corner for face in faces for corner in face[1:]]
    sizes = [face[0] for face in faces]
    return _Polygons(_to_floats(vertices, path.name), np.array(corners, np.int64), np.array(sizes, np.int64))


def _off_rows(path: Path) -> Iterator[list[bytes]]:
    for line in path.read_bytes().splitlines():
        words = line.partition(b"#")[0].split()
        if words:
            yield words


def _read_with_trimesh(path: Path) -> _Polygons:
    import trimesh

    try:
        with np.errstate(all="ignore"):
            mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # its readers fail with whatever the damage leads them to
        raise StageError(
            f"{path.name}: cannot be read as {path.suffix[1:].upper()} "
            f"({type(error).__name__}: {' '.join(str(error).split())[:120]}); export it again, as triangles only"
        ) from error
    faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64).reshape(-1, 3)
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    unit = getattr(mesh, "units", None) if path.suffix.lower() != ".ply" else None
    return _Polygons(vertices, faces.ravel(), np.full(len(faces), 3), _UNIT_NAMES.get(unit or "", unit))


def _read_ply(path: Path) -> _Polygons:
    header, found, body = path.read_bytes().partition(b"end_header")
    if not header.startswith(b"ply") or not found:
        raise StageError(f"{path.name}: is not a PLY file (no `ply` ... `end_header`); {_AGAIN}")
    announced = sum(int(count) for count in re.findall(rb"^element\s+\S+\s+(\d+)", header, re.MULTILINE))
    # trimesh takes what rows there are of an ASCII file; of a binary one it checks the length itself.
    rows = sum(1 for line in body.splitlines() if line.strip())
    if b"format ascii" in header and rows < announced:
        raise StageError(f"{path.name}: announces {announced} rows, but {rows} follow; {_AGAIN}")
    if not re.search(rb"^element\s+face\s+[1-9]", header, re.MULTILINE):
        return _Polygons(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64))
    return _read_with_trimesh(path)


def _read_with_vtk(path: Path) -> _Polygons:
    about = f"{path.name} cannot be read; export it again, as PolyData, or download it again"
    found = call_in_child(vtk_polygons, {}, {"path": str(path.resolve())}, seconds=READING_SECONDS, about=about)
    return _Polygons(found["vertices"], found["corners"], found["sizes"])


def vtk_polygons(*, path: str) -> dict[str, NDArray[Any]]:
    """Return `vertices`, `corners` and `sizes` of the PolyData file `path`: the child's side of reading it."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    window = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    reader = vtkXMLPolyDataReader() if path.lower().endswith(".vtp") else vtkPolyDataReader()
    reader.SetFileName(path)
    cut = vtkTriangleFilter(pass_lines=False, pass_verts=False)
    cut.SetInputConnection(reader.GetOutputPort())
    cut.Update()
    complaint = window.GetOutput()
    if "error" in str(complaint).lower():
        # VTK complains and hands over what it has got: a part of the surface.
        raise StageError(f"VTK says: {_first_complaint(complaint)}")
    surface = cut.GetOutput()
    if not surface.GetNumberOfPolys():
        return {"vertices": np.empty((0, 3)), "corners": np.empty(0, np.int64), "sizes": np.empty(0, np.int64)}
    return {
        "vertices": vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64),
        "corners": vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).astype(np.int64),
        "sizes": np.full(surface.GetNumberOfPolys(), 3),
    }


def _first_complaint(complaint: str | bytes) -> str:
    """Return VTK's first message without its source line, its object's address and the file's name."""
    text = complaint.decode("ascii", "replace") if isinstance(complaint, bytes) else complaint
    first = re.split(r"\n\n", text.strip())[0].splitlines()[-1]
    return re.sub(r"^\w+ \(0x\w+\): | for file: .*$", "", first)[:120]


def _triangles(polygons: _Polygons, path: Path) -> Ints:
    about = f"the polygons of {path.name} cannot be cut into triangles; export it as triangles"
    arrays = {"vertices": polygons.vertices, "corners": polygons.corners, "sizes": polygons.sizes}
    return call_in_child(cut_polygons, arrays, {}, seconds=READING_SECONDS, about=about)["faces"]


def cut_polygons(*, vertices: Floats, corners: Ints, sizes: Ints) -> dict[str, NDArray[Any]]:
    """Return `faces` (m, 3): the polygons cut into triangles, those that are not convex by their ears."""
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
    cut = vtkTriangleFilter()
    cut.SetInputData(surface)
    cut.Update()
    faces = vtk_to_numpy(cut.GetOutput().GetPolys().GetConnectivityArray())
    return {"faces": faces.astype(np.int64).reshape(-1, 3)}


_READERS: dict[str, Callable[[Path], _Polygons]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".off": _read_off,
    ".ply": _read_ply,
    ".3mf": _read_with_trimesh,
    ".glb": _read_with_trimesh,
    ".vtp": _read_with_vtk,
    ".vtk": _read_with_vtk,
}
