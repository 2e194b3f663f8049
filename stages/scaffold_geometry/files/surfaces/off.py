"""OFF as text; normals, colours and texture coordinates after the positions are ignored (Geomview's manual, "OFF")."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scaffold_geometry.files.surfaces.polygons import Polygons, first_three
from scaffold_geometry.files.text import AGAIN, read_text, rows_to_numbers
from scaffold_pipeline.errors import StageError

_HEADER = re.compile(rb"(?:ST)?C?N?OFF(\d*)", re.IGNORECASE)
"""Some programs write no space after the keyword: `OFF490 518 0`."""
_OTHER_SPACE = re.compile(rb"(?:ST)?C?N?(?:4n?|n)OFF")
"""4 means four coordinates; n means that their number follows."""


class _Row(NamedTuple):
    line: int
    words: list[bytes]


def read_off(path: Path) -> Polygons:
    """Read the OFF file `path`."""
    text = read_text(path)
    rows = _rows(text)
    counts = _counts(rows, path.name)
    body = list(rows)
    try:
        n_vertices, n_faces = (int(word) for word in counts[:2])
        if len(body) != n_vertices + n_faces or n_vertices < 0:
            raise StageError(
                f"{path.name}: announces {n_vertices} vertices and {n_faces} faces, "
                f"but {len(body)} rows follow; {AGAIN}"
            )
        faces = [[int(word) for word in row.words[: int(row.words[0]) + 1]] for row in body[n_vertices:]]
    except ValueError as error:
        raise StageError(f"{path.name}: a count or index is not a whole number; {AGAIN}") from error
    if any(not face or len(face) != face[0] + 1 or face[0] < 3 for face in faces):  # corners of a triangle
        raise StageError(f"{path.name}: a face has fewer corners than it announces, or fewer than 3; {AGAIN}")
    vertices = [first_three(row.words, path.name, row.line) for row in body[:n_vertices]]
    corners = [corner for face in faces for corner in face[1:]]
    sizes = [face[0] for face in faces]
    places = rows_to_numbers(vertices, text, path.name)
    return Polygons(places, np.array(corners, np.int64), np.array(sizes, np.int64))


def _counts(rows: Iterator[_Row], name: str) -> list[bytes]:
    """Return the words of the counts, which may have a header of any kind."""
    first = next(rows, _Row(1, [b""])).words
    header = _HEADER.fullmatch(first[0])
    if header and b"BINARY" in [word.upper() for word in first]:
        raise StageError(f"{name}: is a binary OFF file, which is not supported; export it as text, or as PLY or STL")
    if _OTHER_SPACE.fullmatch(first[0]):
        raise StageError(f"{name}: its vertices are not in 3-D ({first[0].decode()}); export it in x, y, z")
    if header:
        return [word for word in (header[1], *first[1:]) if word] or next(rows, _Row(1, [])).words
    if len(first) in (2, 3) and all(word.isdigit() for word in first):  # the keyword is optional
        return first
    raise StageError(f"{name}: is not an ASCII OFF file (no `OFF` in its first line); {AGAIN}")


def _rows(text: bytes) -> Iterator[_Row]:
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.partition(b"#")[0].split()
        if words:
            yield _Row(number, words)
