"""STL, binary and text; the header alone does not distinguish them, so size, keywords and counts are used."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from scaffold_geometry.files.surfaces.polygons import Polygons, of_corners
from scaffold_geometry.files.text import AGAIN, drop_byte_order_mark, rows_to_numbers, space_in, unify_line_ends
from scaffold_pipeline.errors import StageError

_HEADER, _FACET = 84, 50
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_UNCOUNTED = (0, 0xFFFFFFFF)
"""Placeholders for the count that some writers never replace."""
_PADDING = b"\0\x1a \t\r\n"
"""Bytes with which old systems pad or end a text file."""
_SOLID, _END = rb"^[ \t]*solid\b[^\n]*$", rb"^[ \t]*end[ _]?solid\b[^\n]*$"


def read_stl(path: Path) -> Polygons:
    """Read the STL file `path`, binary or text."""
    content = path.read_bytes()
    announced = int.from_bytes(content[80:_HEADER], "little") if len(content) >= _HEADER else -1
    if len(content) == _HEADER + _FACET * announced:
        return _polygons(content, announced)
    text = drop_byte_order_mark(content, path.name).rstrip(_PADDING).lstrip()
    if (
        text[:5].lower() == b"solid"
        and b"\0" not in text
        and re.search(rb"\bfacet\b|\bend\s*solid\b", text, re.IGNORECASE)
    ):
        return _read_text(unify_line_ends(text), path.name)
    return _read_odd_size(content, announced, path.name)


def _polygons(content: bytes, count: int, doubt: str = "") -> Polygons:
    records = np.frombuffer(content, _RECORD, count, _HEADER)
    return of_corners(records["corners"].astype(np.float64))._replace(
        space=space_in(content[:80]), doubts=(doubt,) if doubt else ()
    )


def _read_odd_size(content: bytes, announced: int, name: str) -> Polygons:
    """Read a binary STL whose size does not match its count: extra bytes at the end, or no count."""
    have, rest = divmod(len(content) - _HEADER, _FACET)
    if announced in _UNCOUNTED and have > 0 and not rest and _are_triangles(content, 0, have):
        return _polygons(content, have, f"its header announces {announced} triangles; read all {have} that follow")
    extra = len(content) - _HEADER - _FACET * announced
    if announced > 0 and extra > 0:
        if extra >= _FACET and _are_triangles(content, announced, 1):
            raise StageError(
                f"{name}: announces {announced} triangles, but more than that follow ({have} would fit); {AGAIN}"
            )
        return _polygons(content, announced, f"left out {extra} bytes after its last triangle")
    raise StageError(
        f"{name}: is not an STL file, or damaged: {len(content)} bytes, where its header announces "
        + (f"{_HEADER + _FACET * announced} ({announced} triangles)" if announced >= 0 else "more")
        + "; export or download it again"
    )


def _are_triangles(content: bytes, start: int, count: int) -> bool:
    """Return whether the `count` records from `start` on look like triangles: finite, of similar size as the others."""
    corners = np.frombuffer(content, _RECORD, start + count, _HEADER)["corners"].astype(np.float64)
    after = corners[start:]
    if not np.isfinite(after).all() or not after.any():
        return False
    size = float(np.abs(corners[:start]).max(initial=0.0)) if start else 1e9
    return bool(1e-6 * min(size, 1.0) <= np.abs(after).max() <= 10.0 * size)  # text or zeros are neither


def _read_text(text: bytes, name: str) -> Polygons:
    """Read STL as text; the name of a solid may be any keyword of the format."""
    begun, ended = (len(re.findall(line, text, re.IGNORECASE | re.MULTILINE)) for line in (_SOLID, _END))
    body = re.sub(_SOLID, b"", text, flags=re.IGNORECASE | re.MULTILINE) if text.count(b"\n") > 1 else text
    ends = list(
        re.finditer(_END if body.count(b"\n") > 1 else rb"\bend[ _]?solid\b", body, re.IGNORECASE | re.MULTILINE)
    )
    tail = body[ends[-1].end() :] if ends else b""
    is_whole = bool(ends) and not re.search(rb"\bendfacet\b|\bvertex\b", tail, re.IGNORECASE) and begun <= max(ended, 1)
    facets = re.sub(_END, b"", body[: ends[-1].start()] if ends else body, flags=re.IGNORECASE | re.MULTILINE)
    words = re.findall(rb"\bvertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", facets, re.IGNORECASE)
    opened, closed = (
        len(re.findall(word, facets, re.IGNORECASE)) for word in (rb"\bfacet\s+normal\b", rb"\bendfacet\b")
    )
    if opened != closed or len(words) != 3 * closed or not is_whole:
        raise StageError(
            f"{name}: its ASCII STL is cut off or damaged: {opened} facets begin, {closed} end, with {len(words)} "
            f"vertices{'' if is_whole else ' and no `endsolid` at the end'}; export or download it again"
        )
    notes = (f"its {ended} solids are read as one surface",) if ended > 1 else ()
    corners = rows_to_numbers(words, text, name).reshape(-1, 3, 3)
    return of_corners(corners)._replace(space=space_in(text[:200]), notes=notes)
