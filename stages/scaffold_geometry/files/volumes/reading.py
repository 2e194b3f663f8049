"""Read a volume file into cells of the four kinds; if it cannot be read, the error is one line.

Text formats and Gmsh files are read here, VTK files by VTK: on damaged files meshio may end the interpreter, print
messages, or return a wrong mesh. Nothing is merged, dropped or reoriented.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.inputs import reader_of
from scaffold_geometry.files.text import AGAIN
from scaffold_geometry.files.volumes.abaqus import read_abaqus
from scaffold_geometry.files.volumes.blocks import CORNERS, Block, Blocks
from scaffold_geometry.files.volumes.gmsh import read_gmsh
from scaffold_geometry.files.volumes.medit import read_medit
from scaffold_geometry.files.volumes.vtk_grids import read_vtk_grid
from scaffold_pipeline.artifacts.cells import CELL_TYPES
from scaffold_pipeline.errors import StageError

_EXPORT = "export the mesh as tetrahedra, hexahedra, wedges and pyramids"


class VolumeFile(NamedTuple):
    """The content of a file: `vertices` (n, 3) in its unit, `cells` kind -> (m, corners), and notes for the user."""

    vertices: Floats
    cells: dict[str, Ints]
    notes: tuple[str, ...]
    space: str | None = None


def read_volume(path: Path) -> VolumeFile:
    """Read the volume file `path`; raises `StageError` if it is damaged or has other cells than the four kinds."""
    reader = reader_of(path, _READERS, "volume mesh")
    with np.errstate(all="ignore"):  # places that are no numbers are refused by who uses them
        points, blocks, left_out, space = reader(path)
    _require_known(blocks, path.name)
    cells = _cells(blocks, len(points), path.name)
    counts = ", ".join(f"{len(corners)} {CELL_TYPES[kind].plural}" for kind, corners in cells.items())
    notes = [
        f"read {counts} over {len(points)} points from {path.suffix[1:].upper()}",
        *left_out,
        *_list_ignored(blocks),
    ]
    return VolumeFile(points, cells, tuple(notes), space)


def _require_known(blocks: list[Block], name: str) -> None:
    """Refuse volume cells other than the four kinds, and files without cells."""
    foreign = [block for block in blocks if block.type.dimension == 3 and not block.type.kind and block.number]
    if foreign:
        raise StageError(f"{name}: has cells that are not supported: {_count_elements(foreign)}; {_EXPORT}")
    if not any(block.number for block in blocks if block.type.kind):
        rest = _count_elements([block for block in blocks if block.number])
        raise StageError(f"{name}: has no volume cells ({rest or 'no elements at all'}); {_EXPORT}")


def _count_elements(blocks: list[Block]) -> str:
    """Return the number of elements of each type, as text."""
    counts: dict[str, int] = {}
    for block in blocks:
        counts[block.type.name] = counts.get(block.type.name, 0) + block.number
    return ", ".join(f"{count} of type {name}" for name, count in sorted(counts.items()))


def _cells(blocks: list[Block], count: int, name: str) -> dict[str, Ints]:
    """Return the corners of the cells, by kind; nodes other than corners are dropped."""
    cells = {}
    for kind, corners in CORNERS.items():
        short = [
            block for block in blocks if block.type.kind == kind and block.number and block.nodes.shape[1] < corners
        ]
        if short:
            raise StageError(f"{name}: a {kind} needs {corners} nodes, but there are {_count_elements(short)}; {AGAIN}")
        of_kind = [block.nodes[:, :corners] for block in blocks if block.type.kind == kind and block.number]
        if of_kind:
            cells[kind] = np.concatenate(of_kind)
            least, greatest = int(cells[kind].min()), int(cells[kind].max())
            if least < 0 or greatest >= count:
                raise StageError(
                    f"{name}: the points of cells must be 0..{count - 1} (from 0), got {least}..{greatest}; {AGAIN}"
                )
    return cells


def _list_ignored(blocks: list[Block]) -> list[str]:
    curved = [block for block in blocks if block.type.kind and block.nodes.shape[1] > CORNERS[block.type.kind]]
    beside = [block for block in blocks if not block.type.kind and block.number]
    notes = []
    if curved:
        notes.append(f"reduced {sum(block.number for block in curved)} cells of higher order to their corners")
    if beside:
        notes.append(
            f"ignored {sum(block.number for block in beside)} elements that fill no space ({_count_elements(beside)})"
        )
    return notes


_READERS: dict[str, Callable[[Path], Blocks]] = {
    ".vtu": read_vtk_grid,
    ".vtk": read_vtk_grid,
    ".msh": read_gmsh,
    ".mesh": read_medit,
    ".inp": read_abaqus,
}
