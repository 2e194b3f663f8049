"""Wavefront OBJ: vertices and polygons; normals, textures and groups are ignored."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scaffold_geometry.files.surfaces.polygons import Polygons, first_three
from scaffold_geometry.files.text import AGAIN, quote, read_text, rows_to_numbers, space_in
from scaffold_pipeline.errors import StageError

_CURVED = frozenset({b"surf", b"curv", b"curv2", b"cstype"})
"""Free-form curves and surfaces, which are not polygons."""


def read_obj(path: Path) -> Polygons:
    """Read the OBJ file `path`."""
    text = read_text(path)
    vertices: list[list[bytes]] = []
    corners: list[int] = []
    sizes: list[int] = []
    for number, line in enumerate(text.replace(b"\\\n", b" ").split(b"\n"), 1):
        words = line.split()
        if words[:1] == [b"v"]:
            vertices.append(first_three(words[1:], path.name, number))
        elif words[:1] in ([b"f"], [b"fo"]):
            face = [_index(word, len(vertices), path, number) for word in words[1:]]
            if len(face) < 3:  # corners of a triangle
                raise StageError(f"{path.name}:{number}: a face has {len(face)} corners, needs 3 or more; {AGAIN}")
            corners += face
            sizes.append(len(face))
        elif words and words[0] in _CURVED:
            raise StageError(
                f"{path.name}:{number}: has curved surfaces ({words[0].decode()}), which are not supported; "
                "export it as polygons"
            )
    places = rows_to_numbers(vertices, text, path.name)
    return Polygons(places, np.array(corners, np.int64), np.array(sizes, np.int64), space=space_in(text[:1000]))


def _index(word: bytes, count: int, path: Path, line: int) -> int:
    """Return the vertex, from 0, of a face's `3/1/2` or `-1`; OBJ counts from 1, or backwards from the last."""
    try:
        index = int(word.partition(b"/")[0])
    except ValueError:
        index = 0
    if index == 0 or index < -count:
        raise StageError(f"{path.name}:{line}: {quote(word)} names no vertex; {AGAIN}")
    return index - 1 if index > 0 else count + index
