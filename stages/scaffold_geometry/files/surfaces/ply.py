"""PLY, text and binary of both byte orders (Turk, "The PLY polygon file format", 1994), with strips of triangles.

Not read by trimesh, which refuses faces of several sizes, fans non-convex polygons and prints a traceback if a texture
is missing, or by VTK, which ends the process on a file that is cut off.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Ints
from scaffold_geometry.files.surfaces.polygons import Polygons, no_polygons, of_triangles, split_strip
from scaffold_geometry.files.text import AGAIN, drop_byte_order_mark, numbers_in, quote, space_in, unify_line_ends
from scaffold_pipeline.errors import StageError

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int64": "i8",
    "uint64": "u8",
    "long": "i8",
    "ulong": "u8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_BYTE_ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_STRIP_END = -1


class _Property(NamedTuple):
    """A number of an element, or a list of numbers with a length of type `length` before it."""

    name: str
    type: str
    length: str | None


class _Lists(NamedTuple):
    """A list property of all rows: all values, one row after the other, and the number of values of each row."""

    values: NDArray[Any]
    sizes: Ints


@dataclass(frozen=True)
class _Element:
    name: str
    number: int
    properties: list[_Property]


class _Header(NamedTuple):
    byte_order: str
    elements: list[_Element]
    comments: bytes


def read_ply(path: Path) -> Polygons:
    """Read the PLY file `path`."""
    content = drop_byte_order_mark(path.read_bytes(), path.name)
    found = re.search(rb"(?:\r\n|\n|\r)[ \t]*end_header[ \t]*(\r\n|\n|\r|\Z)", content)
    if not content.startswith(b"ply") or not found:
        raise StageError(f"{path.name}: is not a PLY file (no `ply` ... `end_header`); {AGAIN}")
    header = _header(unify_line_ends(content[: found.start()]), path.name)
    body = content[found.end() :]
    given, rest = _elements(header, body, path.name)
    if "vertex" not in given:
        return no_polygons()
    polygons = _polygons(given, path.name)
    return polygons._replace(
        space=space_in(header.comments),
        doubts=(f"left out {rest} {'bytes' if header.byte_order else 'numbers'} after its last element",)
        if rest
        else (),
    )


def _header(text: bytes, name: str) -> _Header:
    byte_order, elements, comments = None, list[_Element](), b""
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        kind = words[0] if words else b""
        try:
            if kind == b"format":
                byte_order = _BYTE_ORDERS[words[1].lower()]
            elif kind in (b"comment", b"obj_info"):
                comments += line + b"\n"
            elif kind == b"element":
                elements.append(_Element(words[1].decode("latin-1").lower(), _count(words[2]), []))
            elif kind == b"property":
                elements[-1].properties.append(_property(words[1:]))
        except (IndexError, KeyError, ValueError) as error:
            raise StageError(
                f"{name}:{number}: its header has {quote(line)}, which is not a line of PLY; {AGAIN}"
            ) from error
    if byte_order is None:
        raise StageError(f"{name}: its header has no line `format` of ascii or binary; {AGAIN}")
    return _Header(byte_order, elements, comments)


def _count(word: bytes) -> int:
    if not word.isdigit():
        raise ValueError
    return int(word)


def _property(words: list[bytes]) -> _Property:
    names = [word.decode("latin-1") for word in words]
    if names[0] == "list":
        return _Property(names[3], _TYPES[names[2].lower()], _TYPES[names[1].lower()])
    return _Property(names[1], _TYPES[names[0].lower()], None)


def _elements(header: _Header, body: bytes, name: str) -> tuple[dict[str, dict[str, Any]], int]:
    """Return the properties of each element, and the size of the rest."""
    buffer, order, is_text = body, header.byte_order, not header.byte_order
    if is_text:
        announced = sum(element.number for element in header.elements)
        text = unify_line_ends(body)
        rows = sum(1 for line in text.split(b"\n") if line.strip())
        if rows < announced:
            raise StageError(f"{name}: announces {announced} rows, but {rows} follow; {AGAIN}")
        buffer, order = numbers_in(text.strip(b"\0\x1a \t\n"), f"{name}: after its header").tobytes(), "="
    place, given = 0, {}
    for element in header.elements:
        types = [
            (_Property(p.name, "f8", p.length and "f8"), p.type) if is_text else (p, p.type) for p in element.properties
        ]
        columns, place = _read_element(
            _Element(element.name, element.number, [p for p, _ in types]), buffer, place, order, name
        )
        if element.name not in given:
            given[element.name] = {
                of.name: _as_declared(columns[of.name], declared) if is_text else columns[of.name]
                for of, declared in types
            }
    left = len(buffer) - place
    return given, left // 8 if is_text else left  # numbers of text are kept as float64


def _as_declared(values: Any, declared: str) -> Any:  # noqa: ANN401 - a column or lists
    """Round the numbers of a text to their declared type, so that equal positions stay equal."""
    if declared != "f4" or isinstance(values, _Lists):
        return values
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)


def _read_element(element: _Element, buffer: bytes, start: int, order: str, name: str) -> tuple[dict[str, Any], int]:
    """Return the columns of an element's rows, from `start` in `buffer`, and their end."""
    lists = [p for p in element.properties if p.length]
    least = sum(np.dtype(p.length or p.type).itemsize for p in element.properties)
    if element.number * least > len(buffer) - start:
        raise StageError(f"{name}: announces {element.number} of {element.name}, but it is cut off before; {AGAIN}")
    if not lists or not element.number:
        record = _record(element, (), order)
        rows = np.frombuffer(buffer, record, element.number, start)
        columns = {
            p.name: _Lists(np.empty(0), np.zeros(0, np.int64)) if p.length else rows[p.name] for p in element.properties
        }
        return columns, start + element.number * record.itemsize
    sizes, starts, end = _row_starts(element, buffer, start, order, name)
    return _columns(element, buffer, sizes, starts, order), end


def _record(element: _Element, sizes: tuple[int, ...], order: str) -> np.dtype[Any]:
    """Return the dtype of a row whose lists have `sizes` values."""
    fields: list[tuple[Any, ...]] = []
    remaining = list(sizes)
    for p in element.properties:
        if p.length:
            fields += [(f"count of {p.name}", order + p.length)]
            fields += [(p.name, order + p.type, (remaining.pop(0) if remaining else 0,))]
        else:
            fields.append((p.name, order + p.type))
    return np.dtype(fields)


def _row_starts(element: _Element, buffer: bytes, start: int, order: str, name: str) -> tuple[Ints, Ints, int]:
    """Return the sizes of each row's lists (n, lists), the start of each row (n,), and the end of the last."""
    first = _sizes_at(element, buffer, start, order, name)
    record = _record(element, first, order)
    end = start + element.number * record.itemsize
    if end <= len(buffer):  # most files have lists of one size
        rows = np.frombuffer(buffer, record, element.number, start)
        lengths = np.column_stack([rows[f"count of {p.name}"] for p in element.properties if p.length])
        if (lengths == np.array(first)).all():
            sizes = np.tile(np.array(first, np.int64), (element.number, 1))
            return sizes, np.arange(start, end, record.itemsize), end
    found, starts, widths = [], [start], dict[tuple[int, ...], int]()
    for _ in range(element.number):
        sizes_here = _sizes_at(element, buffer, starts[-1], order, name)
        if sizes_here not in widths:
            widths[sizes_here] = _record(element, sizes_here, order).itemsize
        found.append(sizes_here)
        starts.append(starts[-1] + widths[sizes_here])
    if starts[-1] > len(buffer):
        raise StageError(f"{name}: announces {element.number} of {element.name}, but it is cut off before; {AGAIN}")
    return np.array(found, np.int64), np.array(starts[:-1], np.int64), starts[-1]


def _sizes_at(element: _Element, buffer: bytes, at: int, order: str, name: str) -> tuple[int, ...]:
    """Return the number of values of each list of the row at `at`."""
    sizes = []
    for p in element.properties:
        kind = np.dtype(order + (p.length or p.type))
        if at + kind.itemsize > len(buffer):
            raise StageError(f"{name}: announces {element.number} of {element.name}, but it is cut off before; {AGAIN}")
        if p.length:
            size = np.frombuffer(buffer, kind, 1, at)[0]
            if not 0 <= size <= len(buffer) or size != int(size):
                raise StageError(f"{name}: a list of {element.name} announces {size} values; {AGAIN}")
            sizes.append(int(size))
            at += int(size) * np.dtype(p.type).itemsize
        at += kind.itemsize
    return tuple(sizes)


def _columns(element: _Element, buffer: bytes, sizes: Ints, starts: Ints, order: str) -> dict[str, Any]:
    """Return the columns of rows of any sizes; rows of equal sizes are read at once."""
    content = np.frombuffer(buffer, np.uint8)
    kinds, kind_of_row = np.unique(sizes, axis=0, return_inverse=True)
    found: dict[str, list[tuple[NDArray[np.intp], NDArray[Any]]]] = {p.name: [] for p in element.properties}
    for kind, of_kind in enumerate(kinds):
        record = _record(element, tuple(of_kind), order)
        at = np.flatnonzero(kind_of_row.ravel() == kind)
        rows = content[starts[at][:, None] + np.arange(record.itemsize)].reshape(-1).view(record)
        for p in element.properties:
            found[p.name].append((at, rows[p.name]))
    columns: dict[str, Any] = {}
    list_names = [p.name for p in element.properties if p.length]
    for p in element.properties:
        if p.length:
            columns[p.name] = _join_lists(found[p.name], sizes[:, list_names.index(p.name)])
        else:
            column = np.empty(len(starts), np.dtype(p.type))
            for at, values in found[p.name]:
                column[at] = values
            columns[p.name] = column
    return columns


def _join_lists(parts: list[tuple[NDArray[np.intp], NDArray[Any]]], sizes: Ints) -> _Lists:
    """Return the lists of all rows in their order."""
    first = np.cumsum(sizes) - sizes
    joined = np.empty(int(sizes.sum()), parts[0][1].dtype.newbyteorder("="))
    for at, values in parts:
        joined[first[at][:, None] + np.arange(values.shape[1])] = values
    return _Lists(joined, sizes)


def _polygons(given: dict[str, dict[str, Any]], name: str) -> Polygons:
    vertex = given["vertex"]
    missing = [axis for axis in "xyz" if not isinstance(vertex.get(axis), np.ndarray)]
    if missing:
        raise StageError(f"{name}: its vertices have no {', '.join(missing)}; {AGAIN}")
    vertices = np.column_stack([vertex[axis].astype(np.float64) for axis in "xyz"])
    faces, strips = _lists_of(given.get("face", {})), _lists_of(given.get("tristrips", {}))
    if strips is not None:
        of_strips = _split_strips(_indices(strips, name), strips.sizes)
        if faces is None or not len(faces.sizes):
            return of_triangles(vertices, of_strips)
        faces = _Lists(
            np.concatenate([faces.values, of_strips.ravel()]), np.concatenate([faces.sizes, np.full(len(of_strips), 3)])
        )
    if faces is None:
        return no_polygons()
    small = np.flatnonzero(faces.sizes < 3)  # corners of a triangle
    if len(small):
        raise StageError(
            f"{name}: face {small[0]} has {faces.sizes[small[0]]} corners, needs 3 or more ({len(small)} such); {AGAIN}"
        )
    return Polygons(vertices, _indices(faces, name), faces.sizes)


def _lists_of(element: dict[str, Any]) -> _Lists | None:
    return next((element[key] for key in _CORNERS if isinstance(element.get(key), _Lists)), None)


def _indices(lists: _Lists, name: str) -> Ints:
    with np.errstate(invalid="ignore"):
        whole = lists.values.astype(np.int64)
        if (whole != lists.values).any():
            raise StageError(f"{name}: a corner of a face is not a whole number; {AGAIN}")
    return whole


def _split_strips(corners: Ints, sizes: Ints) -> Ints:
    """Return the triangles of strips; a strip ends at the end of a list or at -1."""
    faces = [np.empty((0, 3), np.int64)]
    for strip in np.split(corners, np.cumsum(sizes)[:-1]):
        ends = np.flatnonzero(strip == _STRIP_END)
        faces += [split_strip(part[part != _STRIP_END]) for part in np.split(strip, ends)]
    return np.concatenate(faces)
