"""What the readers of VTK's files share: its complaints, its marks for cells that are not there, its axes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Bools, Ints
from scaffold_geometry.files.text import drop_byte_order_mark, has_byte_order_mark, unify_line_ends

READING_SECONDS = 120.0
"""VTK reads a million cells in a few seconds: what takes longer never ends."""

_HEAD = 256
"""Bytes of a file's head: in any of VTK's there is a line end among them, and in a binary one soon a zero."""
_GHOSTS, _OLD_GHOSTS = "vtkGhostType", "vtkGhostLevels"
_NOT_THERE = 1 | 8 | 16 | 32
"""Bits of a cell's `vtkGhostType`: a copy of another process's cell, refined into others, outside, hidden."""
_HIDDEN_POINT = 2
"""The bit of a point's `vtkGhostType` that hides the cells at it."""


def without_mark(path: str) -> str:
    """Return `path`, or where a byte order mark or old line ends keep VTK from reading it, a copy without.

    The copy lies in the working folder, a temporary one of the child process.
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
    """Return whether a file that begins so is text whose lines end by CR alone."""
    return b"\0" not in start and b"\r" in start and b"\n" not in start


def first_complaint(complaint: str | bytes) -> str:
    """Return VTK's first message without its source line, its object's address and the file's name."""
    text = complaint.decode("ascii", "replace") if isinstance(complaint, bytes) else complaint
    first = re.split(r"\n\n", text.strip())[0].splitlines()[-1]
    return re.sub(r"^\w+ \(0x\w+\): | for file: .*$", "", first)[:120]


def ghost_types(found: Any) -> tuple[Ints, Ints]:  # noqa: ANN401 - VTK's types are unknown to mypy
    """Return the marks of cells and of points; 0 where there are none. Old files count levels instead of bits."""
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
    """Return which cells are not there, (m,): hidden, copies, or at a hidden point."""
    hidden: Bools = (of_cells & _NOT_THERE) > 0
    if (of_points & _HIDDEN_POINT).any():
        cell_of_corner = np.repeat(np.arange(len(sizes)), sizes)
        is_known = (corners >= 0) & (corners < len(of_points))
        is_hidden = is_known & ((of_points[np.where(is_known, corners, 0)] & _HIDDEN_POINT) > 0)
        hidden |= np.bincount(cell_of_corner, weights=is_hidden, minlength=len(sizes)) > 0
    return hidden


def space_of(found: Any, reader: Any) -> bytes:  # noqa: ANN401
    """Return the words in which a file may name its anatomical axes: its title, or a field called SPACE."""
    title = reader.GetHeader() if hasattr(reader, "GetHeader") else ""
    field = found.GetFieldData().GetAbstractArray("SPACE")
    said = str(field.GetValue(0)) if field is not None and field.GetNumberOfValues() else ""
    return f"{title or ''}\n{'' if '=' in said else 'SPACE='}{said}".encode("ascii", "replace")
