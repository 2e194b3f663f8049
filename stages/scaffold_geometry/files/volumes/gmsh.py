"""Gmsh's MSH files of versions 1, 2 and 4, as text or binary; Gmsh's manual describes them under "File formats".

meshio ends the interpreter on version 1, and cannot read binary version 2 unless nodes are numbered 1..n.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN, drop_byte_order_mark, numbers_in, unify_line_ends
from scaffold_geometry.files.volumes.blocks import (
    Block,
    Blocks,
    ElementType,
    complete_types,
    element_type,
    places_of,
    require_numbers,
    to_indices,
)
from scaffold_pipeline.errors import StageError

_TYPES = {
    **complete_types("line", {1: 1, 8: 2, 26: 3, 27: 4, 28: 5, 62: 6, 63: 7, 64: 8, 65: 9, 66: 10}),
    **complete_types("triangle", {2: 1, 9: 2, 21: 3, 23: 4, 25: 5, 42: 6, 43: 7, 44: 8, 45: 9, 46: 10}),
    **complete_types("quadrangle", {3: 1, 10: 2, 36: 3, 37: 4, 38: 5, 47: 6, 48: 7, 49: 8, 50: 9, 51: 10}),
    **complete_types("tetrahedron", {4: 1, 11: 2, 29: 3, 30: 4, 31: 5, 71: 6, 72: 7, 73: 8, 74: 9, 75: 10}),
    **complete_types("hexahedron", {5: 1, 12: 2, 92: 3, 93: 4, 94: 5, 95: 6, 96: 7, 97: 8, 98: 9}),
    **complete_types("wedge", {6: 1, 13: 2, 90: 3, 91: 4, 106: 5, 107: 6, 108: 7, 109: 8, 110: 9}),
    **complete_types("pyramid", {7: 1, 14: 2, 118: 3, 119: 4, 120: 5, 121: 6, 122: 7, 123: 8, 124: 9}),
    15: element_type("point", 1),
    16: element_type("quadrangle", 8),
    17: element_type("hexahedron", 20),
    18: element_type("wedge", 15),
    19: element_type("pyramid", 13),
    20: element_type("triangle", 9),
}
"""Gmsh's type numbers of complete elements of any order, and of the common incomplete (serendipity) ones."""

_SIZE, _INT, _DOUBLE = "u8", "i4", "f8"

_MOST_TAGS = 10_000
"""Greatest number of tags of an element: two, and one for each partition of a mesh for parallel computing."""


class _Elements(NamedTuple):
    """Elements of one type: `nodes` (m, k) are the file's own node numbers."""

    type: ElementType
    nodes: Ints


class _Header(NamedTuple):
    """A file's version, and the byte order of its numbers: `<` or `>`, or empty for a text file."""

    version: float
    byte_order: str


class _Numbers:
    """The numbers of one section in order, as float64, which is exact for whole numbers below 2^53."""

    def __init__(self, body: bytes, byte_order: str, place: str) -> None:
        self._body, self._byte_order, self._at, self.place = body, byte_order, 0, place
        self._words = None if byte_order else numbers_in(body, place)

    def take(self, count: int, *kinds: str) -> Floats:
        """Return the next `count` records, (count, k): one number for each of `kinds`, the types in a binary file."""
        width = len(kinds)
        if self._words is not None:
            require_numbers(len(self._words) - self._at, count * width, self.place)
            self._at += count * width
            return self._words[self._at - count * width : self._at].reshape(count, width)
        record = np.dtype([(str(i), self._byte_order + kind) for i, kind in enumerate(kinds)])
        require_numbers((len(self._body) - self._at) // record.itemsize, count, self.place)
        records = np.frombuffer(self._body, record, count, self._at)
        self._at += count * record.itemsize
        return np.column_stack([records[str(i)].astype(np.float64) for i in range(width)])

    def ints(self, *kinds: str) -> list[int]:
        """Return the next whole numbers, one for each of `kinds`."""
        return [int(number) for number in to_indices(self.take(1, *kinds), self.place)[0]]

    @property
    def is_at_end(self) -> bool:
        """Whether a text section is read to its end."""
        return self._words is not None and self._at >= len(self._words)

    def ahead(self) -> Floats:
        """Return the rest of a text section."""
        return self._words[self._at :] if self._words is not None else np.empty(0)


def read_gmsh(path: Path) -> Blocks:
    """Read the MSH file `path`."""
    content = drop_byte_order_mark(path.read_bytes(), path.name)
    sections = _sections(content if b"\n" in content else unify_line_ends(content), path.name)
    header = _header(sections, path.name)
    node_name, element_name = ("NOD", "ELM") if header.version < 2 else ("Nodes", "Elements")
    for needed in (node_name, element_name):
        if needed not in sections:
            raise StageError(f"{path.name}: has no section ${needed}; {AGAIN}")
    nodes, elements = (_numbers(sections[of], header, f"{path.name}: ${of}") for of in (node_name, element_name))
    ids, points = _nodes(nodes, header)
    blocks = []
    for block in _elements(elements, header):
        is_wanted = block.type.kind is not None
        places = places_of(ids, block.nodes, path.name) if is_wanted else np.empty((0, 0), np.int64)
        blocks.append(Block(block.type, len(block.nodes), places))
    return Blocks(points, blocks)


def _sections(content: bytes, name: str) -> dict[str, bytes]:
    """Return the text between each `$Name` and its `$EndName`, in version 1 `$ENDNAME`."""
    sections, at = {}, 0
    while begin := re.compile(rb"^\$([A-Za-z]\w*)[ \t]*\r?\n", re.MULTILINE).search(content, at):
        section = begin[1].decode()
        end = content.find(b"$End" + begin[1], begin.end())
        end = end if end >= 0 else content.find(b"$END" + begin[1], begin.end())
        if end < 0:
            raise StageError(f"{name}: section ${section} has no end: the file is truncated; {AGAIN}")
        sections[section], at = content[begin.end() : end], end + 1
    return sections


def _header(sections: dict[str, bytes], name: str) -> _Header:
    if "NOD" in sections:
        return _Header(1.0, "")
    first, _, rest = sections.get("MeshFormat", b"").partition(b"\n")
    words = first.split()
    try:
        version, is_binary = float(words[0]), int(words[1]) != 0
    except (IndexError, ValueError) as error:
        raise StageError(
            f"{name}: is not a Gmsh file (no $MeshFormat); if another program wrote it, export VTU, else {AGAIN}"
        ) from error
    if int(version) not in {2, 4}:
        raise StageError(f"{name}: MSH version must be 1, 2 or 4, got {version:g}; export it as one of these")
    one = int.from_bytes(rest[:4], "little")
    return _Header(version, ("<" if one == 1 else ">") if is_binary else "")


def _numbers(body: bytes, header: _Header, place: str) -> _Numbers:
    return _Numbers(_with_count(body, header, place), header.byte_order, place)


def _with_count(body: bytes, header: _Header, place: str) -> bytes:
    """Return a section's body with its count in the form of its numbers: version 2 has a text count in binary files."""
    if not header.byte_order or header.version >= 4:
        return body
    count, _, rest = body.partition(b"\n")
    counts = to_indices(numbers_in(count, place), place)
    require_numbers(len(counts), 1, place)
    require_numbers(len(rest), int(counts[0]), place)
    return np.array(counts[:1], header.byte_order + _SIZE).tobytes() + rest


def _nodes(section: _Numbers, header: _Header) -> tuple[Ints, Floats]:
    """Return the numbers (n,) and positions (n, 3) of the nodes."""
    coordinates = (_DOUBLE, _DOUBLE, _DOUBLE)
    if header.version < 4:
        (count,) = section.ints(_SIZE)
        rows = section.take(count, _INT, *coordinates)
        return to_indices(rows[:, 0], section.place), rows[:, 1:]
    is_first = header.version < 4.1  # 4.0 has fewer counts, and each number beside its node
    block_count = section.ints(*[_SIZE] * (2 if is_first else 4))[0]
    ids, points = [np.empty(0)], [np.empty((0, 3))]
    for _ in range(block_count):
        one, other, is_parametric, count = section.ints(_INT, _INT, _INT, _SIZE)
        dimension = other if is_first else one
        if not 0 <= dimension <= 3:
            raise StageError(f"{section.place}: the dimension of a block must be 0 to 3, got {dimension}; {AGAIN}")
        parameters = [_DOUBLE] * (dimension if is_parametric else 0)
        if is_first:
            rows = section.take(count, _INT, *coordinates, *parameters)
            ids.append(rows[:, 0])
            points.append(rows[:, 1:4])
        else:
            ids.append(section.take(count, _SIZE)[:, 0])
            points.append(section.take(count, *coordinates, *parameters)[:, :3])
    return to_indices(np.concatenate(ids), section.place), np.concatenate(points)


def _elements(section: _Numbers, header: _Header) -> list[_Elements]:
    if header.version >= 4:
        return _elements_in_blocks(section, header)
    (count,) = section.ints(_SIZE)
    blocks = _binary_elements(section, count) if header.byte_order else _text_elements(section, header)
    have = sum(len(elements.nodes) for elements in blocks)
    if have != count:
        raise StageError(f"{section.place}: announces {count} elements, but {have} follow; {AGAIN}")
    return blocks


def _elements_in_blocks(section: _Numbers, header: _Header) -> list[_Elements]:
    is_first = header.version < 4.1
    number = _INT if is_first else _SIZE
    block_count = section.ints(*[_SIZE] * (2 if is_first else 4))[0]
    blocks = []
    for _ in range(block_count):
        _, _, type_number, count = section.ints(_INT, _INT, _INT, _SIZE)
        of_type = _type(type_number, section.place)
        rows = section.take(count, *[number] * (1 + of_type.nodes))
        blocks.append(_Elements(of_type, to_indices(rows[:, 1:], section.place)))
    return blocks


def _binary_elements(section: _Numbers, count: int) -> list[_Elements]:
    blocks: list[_Elements] = []
    while sum(len(elements.nodes) for elements in blocks) < count:
        type_number, of_block, tags = section.ints(_INT, _INT, _INT)
        of_type = _type(type_number, section.place)
        if of_block < 1 or not 0 <= tags <= _MOST_TAGS:
            raise StageError(f"{section.place}: a block cannot have {of_block} elements of {tags} tags; {AGAIN}")
        rows = section.take(of_block, *[_INT] * (1 + tags + of_type.nodes))
        blocks.append(_Elements(of_type, to_indices(rows[:, 1 + tags :], section.place)))
    return blocks


def _text_elements(section: _Numbers, header: _Header) -> list[_Elements]:
    """Read rows `number type tag-count tags nodes`, in version 1 `number type physical elementary node-count nodes`."""
    column = 4 if header.version < 2 else 2
    blocks, chunk = [], 1
    while not section.is_at_end:
        rest = section.ahead()
        require_numbers(len(rest), column + 1, section.place)
        head = to_indices(rest[: column + 1], section.place)
        of_type = _type(int(head[1]), section.place)
        lead = 5 if header.version < 2 else 3 + int(head[column])
        width = lead + of_type.nodes
        require_numbers(len(rest), width if lead >= column + 1 else -1, section.place)
        rows = rest[: min(len(rest) // width, chunk) * width].reshape(-1, width)
        # A row of a different type still starts at its place, so that its type can be compared.
        is_other = (rows[:, 1] != head[1]) | (rows[:, column] != head[column])
        count = int(np.argmax(is_other)) if is_other.any() else len(rows)
        chunk = 2 * count + 64
        blocks.append(_Elements(of_type, to_indices(section.take(count, *[_INT] * width)[:, lead:], section.place)))
    return blocks


def _type(number: int, place: str) -> ElementType:
    if number not in _TYPES:
        name = {34: " (a polygon)", 35: " (a polyhedron)"}.get(number, "")
        raise StageError(
            f"{place}: elements of Gmsh's type {number}{name} are not supported; export tetrahedra, "
            "hexahedra, wedges and pyramids only"
        )
    return _TYPES[number]
