"""Abaqus input files (.inp), with parts and instances, or without them, as CalculiX has them.

The keywords are described in the Abaqus Keywords Guide. meshio keeps only the nodes of the last part, and connects the
elements of all parts to them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN, numbers_in, read_text
from scaffold_geometry.files.volumes.blocks import (
    Block,
    Blocks,
    ElementType,
    element_type,
    places_of,
    to_indices,
)
from scaffold_pipeline.errors import StageError

_SOLID = re.compile(r"(?:C|DC|DCC|AC|EMC|Q|F)3D(4|5|6|8|10|13|15|18|20|27)(?![0-9])\w*|(?:SC|CSS)(6|8)R?\w*")
"""Names of solid elements, and of continuum shells, which have nodes on both sides."""

_NOT_SOLID = frozenset({"F3D3", "F3D4"})
"""Abaqus's facets of fluid cavities."""

_KINDS = {
    **dict.fromkeys((4, 10), "tetrahedron"),
    **dict.fromkeys((5, 13), "pyramid"),
    **dict.fromkeys((6, 15, 18), "wedge"),
    **dict.fromkeys((8, 20, 27), "hexahedron"),
}

_GENERATORS = frozenset({"INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"})
"""Keywords that generate or move nodes and elements, or read them from other files."""


class _Keyword(NamedTuple):
    """A keyword line and the data lines after it."""

    name: str
    options: dict[str, str]
    line: int
    data: list[bytes]


@dataclass
class _Part:
    """Nodes (id, x, y, z) and elements of one part, block by block."""

    nodes: list[Floats] = field(default_factory=list)
    elements: list[tuple[ElementType, int, Ints]] = field(default_factory=list)


class _Instance(NamedTuple):
    """A part placed in the assembly: `moves` are its data lines, at most a translation and a rotation."""

    part: str
    moves: list[Floats]


def read_abaqus(path: Path) -> Blocks:
    """Read the input file `path`: nodes and elements of all parts, at the positions of their instances."""
    parts: dict[str, _Part] = {"": _Part()}
    instances: list[_Instance] = []
    current = ""
    for keyword in _keywords(path):
        place = f"{path.name}:{keyword.line}: *{keyword.name}"
        if keyword.name == "PART":
            current = keyword.options.get("NAME", "")
            parts[current] = _Part()
        elif keyword.name == "INSTANCE":
            moves = [numbers_in(line.replace(b",", b" "), place) for line in keyword.data]
            current = f"instance {len(instances)}"
            parts[current] = _Part()
            instances += [_Instance(part, moves) for part in (keyword.options.get("PART"), current) if part]
        elif keyword.name in {"END PART", "END INSTANCE"}:
            current = ""
        elif keyword.name == "NODE":
            parts[current].nodes.append(_nodes(keyword, place))
        elif keyword.name == "ELEMENT":
            parts[current].elements.append(_elements(keyword, place))
        elif keyword.name in _GENERATORS:
            raise StageError(
                f"{place} is not supported; export the mesh with all its nodes and elements, for example from "
                "Abaqus/CAE, or as VTU or MSH"
            )
    return _assemble(parts, [_Instance("", []), *instances], path.name)


def _keywords(path: Path) -> Iterator[_Keyword]:
    keyword: _Keyword | None = None
    number = 0
    for number, line in enumerate(read_text(path).split(b"\n"), 1):
        text = line.strip()
        if not text or text.startswith(b"**"):
            continue
        if text.startswith(b"*"):
            if keyword:
                yield keyword
            words = [word.strip() for word in text[1:].decode("latin-1").split(",")]
            pairs = [word.upper().partition("=") for word in words[1:]]
            options = {name.strip(): value.strip() for name, _, value in pairs}
            keyword = _Keyword(" ".join(words[0].upper().split()), options, number, [])
        elif keyword:
            keyword.data.append(text)
        else:
            raise StageError(f"{path.name}: is not an Abaqus input file: line {number} is under no keyword; {AGAIN}")
    if keyword:
        yield keyword


def _nodes(keyword: _Keyword, place: str) -> Floats:
    """Return rows of id, x, y, z."""
    if {"INPUT", "SYSTEM"} & set(keyword.options):
        raise StageError(f"{place} with INPUT or SYSTEM is not supported; write the nodes as x, y, z into the file")
    joined = b"\n".join(keyword.data).replace(b"D", b"E").replace(b"d", b"e")  # Fortran's exponents
    numbers = numbers_in(joined.replace(b",", b" "), place)
    if len(numbers) != 4 * len(keyword.data):
        raise StageError(
            f"{place}: must have 4 numbers per node (number, x, y, z), got {len(numbers)} for {len(keyword.data)} "
            f"nodes; {AGAIN}"
        )
    return numbers.reshape(-1, 4)


def _elements(keyword: _Keyword, place: str) -> tuple[ElementType, int, Ints]:
    """Return a block's type, its number of elements, and the numbers of their nodes if they are solid elements."""
    name = keyword.options.get("TYPE", "")
    if "INPUT" in keyword.options:
        raise StageError(f"{place} with INPUT is not supported; write the elements into the file itself")
    solid = None if name in _NOT_SOLID else _SOLID.fullmatch(name)
    if not solid:
        lines = sum(not line.endswith(b",") for line in keyword.data)
        return ElementType(f"element {name}", 2, None, 0), lines, np.empty((0, 0), np.int64)
    size = int(solid[1] or solid[2])
    joined = b"\n".join(keyword.data).replace(b",", b" ")
    numbers = to_indices(numbers_in(joined, place), place)
    if len(numbers) % (size + 1):
        raise StageError(
            f"{place}, TYPE={name}: must have {size + 1} numbers per element (its own and its {size} nodes), got "
            f"{len(numbers)} numbers in all; {AGAIN}"
        )
    rows = numbers.reshape(-1, size + 1)[:, 1:]
    return element_type(_KINDS[size], size), len(rows), rows


def _assemble(parts: dict[str, _Part], instances: list[_Instance], name: str) -> Blocks:
    """Return the nodes and elements of all instances together; a part without an instance is taken as it is."""
    placed = {instance.part for instance in instances}
    missing = placed - set(parts)
    if missing:
        raise StageError(f"{name}: has an instance of part {min(missing)!r}, but no such part; {AGAIN}")
    alone = [_Instance(part, []) for part in parts if part not in placed]
    points, blocks, start = [np.empty((0, 3))], [], 0
    for instance in [*instances, *alone]:
        part = parts[instance.part]
        nodes = np.concatenate([np.empty((0, 4)), *part.nodes])
        ids = to_indices(nodes[:, 0], f"{name}: *NODE")
        for of_type, number, wanted in part.elements:
            places = start + places_of(ids, wanted, name) if wanted.size else wanted
            blocks.append(Block(of_type, number, places))
        points.append(_place_instance(nodes[:, 1:], instance.moves, name))
        start += len(nodes)
    return Blocks(np.concatenate(points), blocks)


def _place_instance(points: Floats, moves: list[Floats], name: str) -> Floats:
    """Return points translated by a line of 3 numbers and rotated by a line of 7: two points of the axis, degrees."""
    for move in moves:
        if len(move) == 3:
            points = points + move
        elif len(move) == 7 and (move[:3] != move[3:6]).any():
            from scipy.spatial.transform import Rotation

            axis = (move[3:6] - move[:3]) / np.linalg.norm(move[3:6] - move[:3])
            points = Rotation.from_rotvec(axis * move[6], degrees=True).apply(points - move[:3]) + move[:3]
        else:
            raise StageError(
                f"{name}: an instance's position must be 3 numbers, or 7 with an axis, got {move.tolist()}; {AGAIN}"
            )
    return points
