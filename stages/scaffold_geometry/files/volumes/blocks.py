"""The common form of volume files: points, and blocks of elements of one type, as they are in the file.

In all formats read here the corners of an element, whatever its order, are its first nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import StageError

CORNERS = {name: kind.corners for name, kind in CELL_TYPES.items() if not kind.is_planar}
"""The kinds of cells of a volume mesh, and their numbers of corners."""


class ElementType(NamedTuple):
    """A type of element in a file: its name in messages, its dimension, and its kind of cell, None if it is no cell.

    `nodes` is the number of nodes of an element, 0 if it varies.
    """

    name: str
    dimension: int
    kind: str | None
    nodes: int


class Block(NamedTuple):
    """`number` elements of one type; `nodes` (number, k) are indices of points, or empty if they are no cells."""

    type: ElementType
    number: int
    nodes: Ints


class Blocks(NamedTuple):
    """The content of a file: `points` (n, 3) in the file's unit, its blocks of elements, notes on what was left out.

    `space` is the anatomical axes that the file names (`RAS`, `LPS`).
    """

    points: Floats
    blocks: list[Block]
    notes: tuple[str, ...] = ()
    space: str | None = None


def complete_types(kind: str, numbers: dict[int, int]) -> dict[int, ElementType]:
    """Return the element types by a file's `numbers` -> polynomial order: complete elements of `kind`."""
    node_counts: dict[str, Callable[[int], int]] = {
        "line": lambda p: p + 1,
        "triangle": lambda p: (p + 1) * (p + 2) // 2,
        "quadrangle": lambda p: (p + 1) ** 2,
        "tetrahedron": lambda p: (p + 1) * (p + 2) * (p + 3) // 6,
        "pyramid": lambda p: (p + 1) * (p + 2) * (2 * p + 3) // 6,
        "wedge": lambda p: (p + 1) ** 2 * (p + 2) // 2,
        "hexahedron": lambda p: (p + 1) ** 3,
    }
    return {number: element_type(kind, node_counts[kind](order)) for number, order in numbers.items()}


def element_type(shape: str, nodes: int) -> ElementType:
    """Return the type of elements of a common `shape` with `nodes` nodes each."""
    flat = {"point": 0, "line": 1, "triangle": 2, "quadrangle": 2}
    name = f"{shape} of {nodes} nodes" if nodes else shape
    return ElementType(name, flat.get(shape, 3), shape if shape in CORNERS else None, nodes)


def to_indices(numbers: Floats, place: str) -> Ints:
    """Return numbers as integers; raises `StageError` if one is not whole."""
    with np.errstate(invalid="ignore"):
        whole = numbers.astype(np.int64)
        if (whole != numbers).any():
            raise StageError(f"{place}: counts and node numbers must be whole numbers; {AGAIN}")
    return whole


def require_numbers(have: int, needed: int, place: str) -> None:
    """Require that `needed` of `have` numbers exist, before an array of that size is made."""
    if not 0 <= needed <= have:
        raise StageError(f"{place}: announces {needed} numbers, but {have} follow: the file is truncated; {AGAIN}")


def places_of(names: Ints, wanted: Ints, file: str) -> Ints:
    """Return the index in `names` (n,), the file's own node numbers, of each of `wanted`."""
    order = np.argsort(names, kind="stable")
    ordered = names[order]
    twice = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twice):
        raise StageError(f"{file}: {len(twice)} node numbers are used twice (one is {ordered[twice[0]]}); {AGAIN}")
    if not len(names):
        raise StageError(f"{file}: has elements, but no nodes; {AGAIN}")
    places = np.minimum(np.searchsorted(ordered, wanted), len(names) - 1)
    missing = ordered[places] != wanted
    if missing.any():
        raise StageError(
            f"{file}: its elements use {len(np.unique(wanted[missing]))} nodes that are not in the file "
            f"(one is {wanted[missing].flat[0]}); {AGAIN}"
        )
    return np.asarray(order[places])
