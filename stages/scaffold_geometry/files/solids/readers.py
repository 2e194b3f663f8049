"""Readers of other libraries: their failures as `StageError`, their meshes as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.files.solids.model import Mesh, mesh_as_read
from scaffold_pipeline.errors import StageError

TRIANGLE = 3


@contextmanager
def reading(kind: str, reader: str) -> Iterator[None]:
    """Convert errors of a reader to a `StageError` with its name."""
    try:
        yield
    except StageError:
        raise
    except Exception as error:  # a reader can fail in any way on a bad file
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise StageError(f"must be valid {kind}, but {reader} says: {reason}") from error


def mesh_by_trimesh(path: Path, kind: str) -> Mesh:
    """Return the one mesh that trimesh reads from a file of format `kind`, in the order of the file."""
    import trimesh

    with reading(kind, "trimesh"):
        found = trimesh.load_mesh(path, process=False, maintain_order=True)
        return mesh_as_read(found.vertices, found.faces)


def mesh_by_vtk(reader: Any, path: Path, kind: str) -> Mesh:  # noqa: ANN401 - VTK's types are unknown to mypy
    """Return the mesh that a reader of VTK reads from a file of format `kind`."""
    with reading(kind, "VTK"):
        reader.SetFileName(str(path))
        reader.Update()
        return mesh_of_polydata(reader.GetOutput(), kind)


def mesh_of_polydata(polydata: Any, kind: str) -> Mesh:  # noqa: ANN401
    """Return the triangles of VTK's mesh."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    cells = polydata.GetPolys()
    if not polydata.GetNumberOfPoints() or cells.IsHomogeneous() != TRIANGLE:
        raise StageError(f"must be valid {kind} with triangles only, but VTK finds none, or other cells")
    points = vtk_to_numpy(polydata.GetPoints().GetData())
    return mesh_as_read(points, vtk_to_numpy(cells.GetConnectivityArray()).reshape(-1, TRIANGLE).astype(np.int64))
