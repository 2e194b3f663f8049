"""What every reader of volume files makes: points, and blocks of elements of one type, as the file has them.

The corners of an element of any order come first among its nodes, in all of the formats read here.
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
"""The kinds of cells that a volume mesh may have, and their corners."""


class ElementType(NamedTuple):
    """A file's type of element: its name for people, its dimension, and the kind of cell that it is, if it is one.

    `nodes` is how many an element has, 0 where that differs from one to the next.
    """

    name: str
    dimension: int
    kind: str | None
    nodes: int


class Block(NamedTuple):
    """`number` elements of one type; `nodes` (number, k) counts points from 0; it may be empty for what is no cell."""

    type: ElementType
    number: int
    nodes: Ints


class Blocks(NamedTuple):
    """What a file holds: `points` (n, 3) in the file's unit, its blocks of elements, what was left out of it.

    `space` is the anatomical axes that the file names (`RAS`, `LPS`).
    """

    points: Floats
    blocks: list[Block]
    notes: tuple[str, ...] = ()
    space: str | None = None


def complete_types(kind: str, numbers: dict[int, int]) -> dict[int, ElementType]:
    """Return the types of a file's `numbers` -> polynomial order: elements of `kind` with all nodes of their order."""
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
    """Return the type of elements of a usual `shape` with `nodes` nodes each."""
    flat = {"point": 0, "line": 1, "triangle": 2, "quadrangle": 2}
    name = f"{shape} of {nodes} nodes" if nodes else shape
    return ElementType(name, flat.get(shape, 3), shape if shape in CORNERS else None, nodes)


def to_indices(numbers: Floats, place: str) -> Ints:
    """Return numbers that must be whole as integers."""
    with np.errstate(invalid="ignore"):
        whole = numbers.astype(np.int64)
        if (whole != numbers).any():
            raise StageError(f"{place}: a count or a number of a node is no whole number; {AGAIN}")
    return whole


def require_numbers(have: int, needed: int, place: str) -> None:
    """Require that `needed` numbers are there, before anything of that size is made."""
    if not 0 <= needed <= have:
        raise StageError(
            f"{place}: announces {needed} numbers, but {have} follow: the file is cut off or damaged; {AGAIN}"
        )


def places_of(names: Ints, wanted: Ints, file: str) -> Ints:
    """Return where in `names` (n,), the file's own numbers of its nodes, each of `wanted` is."""
    order = np.argsort(names, kind="stable")
    ordered = names[order]
    twice = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twice):
        raise StageError(f"{file}: {len(twice)} nodes have the number of another (one is {ordered[twice[0]]}); {AGAIN}")
    if not len(names):
        raise StageError(f"{file}: has elements, but no nodes; {AGAIN}")
    found = np.minimum(np.searchsorted(ordered, wanted), len(names) - 1)
    missing = ordered[found] != wanted
    if missing.any():
        raise StageError(
            f"{file}: its elements name {len(np.unique(wanted[missing]))} nodes that it does not hold "
            f"(one is {wanted[missing].flat[0]}); {AGAIN}"
        )
    return np.asarray(order[found])
