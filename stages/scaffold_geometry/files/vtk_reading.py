"""Common parts of the readers of VTK files: error messages, ghost and hidden cells, anatomical axes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Bools, Ints
from scaffold_geometry.files.text import drop_byte_order_mark, has_byte_order_mark, unify_line_ends

READING_SECONDS = 120.0
"""Time limit: VTK reads a million cells in a few seconds."""

_HEAD = 256
"""Bytes of a file's head: any VTK file has a line end in them, and a binary one a zero."""
_GHOSTS, _OLD_GHOSTS = "vtkGhostType", "vtkGhostLevels"
_NOT_THERE = 1 | 8 | 16 | 32
"""Bits of a cell's `vtkGhostType`: duplicate of another process, refined, exterior, hidden."""
_HIDDEN_POINT = 2
"""The bit of a point's `vtkGhostType` that hides the cells at it."""


def without_mark(path: str) -> str:
    """Return `path`, or a copy without a byte order mark and old line ends, which VTK cannot read.

    The copy is in the working folder, a temporary one of the child process.
    """
    with Path(path).open("rb") as stream:
        start = stream.read(_HEAD)
    if not has_byte_order_mark(start) and not _has_old_ends(start):
        return path
    content = drop_byte_order_mark(Path(path).read_bytes(), Path(path).name)
    copy = Path("without_mark").with_suffix(Path(path).suffix.lower())
    copy.write_bytes(unify_line_ends(content) if _has_old_ends(content[:_HEAD]) else content)
    return str(copy)


def _has_old_ends(start: bytes) -> bool:
    """Return whether a file with this beginning is text whose lines end with CR only."""
    return b"\0" not in start and b"\r" in start and b"\n" not in start


def update_reader(reader: Any, path: str) -> str:  # noqa: ANN401 - VTK's types are unknown to mypy
    """Have a VTK reader read the file `path`; return what VTK reports meanwhile, which may be an error."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    window = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    reader.SetFileName(without_mark(path))
    reader.Update()
    return str(window.GetOutput())


def first_complaint(complaint: str | bytes) -> str:
    """Return VTK's first message without source line, object address and file name."""
    text = complaint.decode("ascii", "replace") if isinstance(complaint, bytes) else complaint
    first = re.split(r"\n\n", text.strip())[0].splitlines()[-1]
    return re.sub(r"^\w+ \(0x\w+\): | for file: .*$", "", first)[:120]


def ghost_types(found: Any) -> tuple[Ints, Ints]:  # noqa: ANN401 - VTK's types are unknown to mypy
    """Return the ghost types of cells and of points; 0 if there are none. Old files have levels instead of bits."""
    of_points = _marks(found.GetPointData(), _GHOSTS, found.GetNumberOfPoints())
    levels = _marks(found.GetCellData(), _OLD_GHOSTS, found.GetNumberOfCells())
    return _marks(found.GetCellData(), _GHOSTS, found.GetNumberOfCells()) | (levels > 0), of_points


def _marks(attributes: Any, name: str, count: int) -> Ints:  # noqa: ANN401
    from vtkmodules.util.numpy_support import vtk_to_numpy

    array = attributes.GetArray(name)
    if array is None or array.GetNumberOfTuples() != count:
        return np.zeros(count, np.int64)
    return np.asarray(vtk_to_numpy(array).astype(np.int64).reshape(-1))


def find_hidden_cells(corners: Ints, sizes: Ints, of_cells: Ints, of_points: Ints) -> Bools:
    """Return which cells to leave out, (m,): hidden, duplicate, or at a hidden point."""
    hidden: Bools = (of_cells & _NOT_THERE) > 0
    if (of_points & _HIDDEN_POINT).any():
        cell_of_corner = np.repeat(np.arange(len(sizes)), sizes)
        is_known = (corners >= 0) & (corners < len(of_points))
        is_hidden = is_known & ((of_points[np.where(is_known, corners, 0)] & _HIDDEN_POINT) > 0)
        hidden |= np.bincount(cell_of_corner, weights=is_hidden, minlength=len(sizes)) > 0
    return hidden


def space_of(found: Any, reader: Any) -> bytes:  # noqa: ANN401
    """Return the texts that may name a file's anatomical axes: its title, and a field named SPACE."""
    title = reader.GetHeader() if hasattr(reader, "GetHeader") else ""
    field = found.GetFieldData().GetAbstractArray("SPACE")
    named = str(field.GetValue(0)) if field is not None and field.GetNumberOfValues() else ""
    return f"{title or ''}\n{'' if '=' in named else 'SPACE='}{named}".encode("ascii", "replace")
