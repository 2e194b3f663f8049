"""MEDIT mesh files in text form; the format is described in the documentation of libMeshb."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.files.text import AGAIN, numbers_in, read_text
from scaffold_geometry.files.volumes.blocks import (
    Block,
    Blocks,
    element_type,
    require_numbers,
    to_indices,
)
from scaffold_pipeline.errors import StageError

_TYPES = {
    "Edges": element_type("line", 2),
    "Triangles": element_type("triangle", 3),
    "Quadrilaterals": element_type("quadrangle", 4),
    "Tetrahedra": element_type("tetrahedron", 4),
    "Pyramids": element_type("pyramid", 5),
    "Prisms": element_type("wedge", 6),
    "Hexahedra": element_type("hexahedron", 8),
    "Hexaedra": element_type("hexahedron", 8),
    "TetrahedraP2": element_type("tetrahedron", 10),
    "PyramidsP2": element_type("pyramid", 14),
    "PrismsP2": element_type("wedge", 18),
    "HexahedraQ2": element_type("hexahedron", 27),
    "Polyhedra": element_type("polyhedron", 0),
}


def read_medit(path: Path) -> Blocks:
    """Read the vertices and elements of the MEDIT file `path`; all other sections are ignored."""
    text = re.sub(rb"#[^\n]*", b"", read_text(path))
    if not text.lstrip().startswith(b"MeshVersionFormatted"):
        raise StageError(f"{path.name}: is not a MEDIT text file (no `MeshVersionFormatted`); {AGAIN}")
    # Words begin with a letter, but numbers may be `nan` or `inf`.
    parts = re.split(rb"(?<!\S)(?!nan\b|inf\b)([A-Za-z]\w*)", text, flags=re.IGNORECASE)
    sections = [(word.decode(), body) for word, body in zip(parts[1::2], parts[2::2], strict=True)]
    dimension = next((body.split()[:1] for word, body in sections if word == "Dimension"), [])
    if dimension != [b"3"]:
        got = b" ".join(dimension).decode("ascii", "replace") or "none"
        raise StageError(f"{path.name}: Dimension must be 3, got {got}; export it as a mesh in space")
    points, blocks = np.empty((0, 3)), []
    for word, body in sections:
        place = f"{path.name}: {word}"
        if word == "Vertices":
            points = _rows(body, 3, place)
        elif word in _TYPES:
            nodes = to_indices(_rows(body, _TYPES[word].nodes, place), place) - 1
            blocks.append(Block(_TYPES[word], len(nodes), nodes))
    return Blocks(points, blocks)


def _rows(body: bytes, width: int, place: str) -> Floats:
    """Return the rows of a section, (m, width), without the reference number at the end of each."""
    numbers = numbers_in(body, place)
    require_numbers(len(numbers), 1, place)
    (count,) = to_indices(numbers[:1], place)
    if not width:
        return np.empty((count, 0))
    require_numbers(len(numbers) - 1, int(count) * (width + 1), place)
    return numbers[1 : 1 + count * (width + 1)].reshape(count, width + 1)[:, :width]
