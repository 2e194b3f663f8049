"""Text files of other programs: byte order marks, line ends, numbers, and the line of an invalid number."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.errors import StageError

AGAIN = "the file is damaged, export or download it again"

_MARKS = {
    b"\xef\xbb\xbf": "utf-8",
    b"\xff\xfe\x00\x00": "utf-32-le",
    b"\x00\x00\xfe\xff": "utf-32-be",
    b"\xff\xfe": "utf-16-le",
    b"\xfe\xff": "utf-16-be",
}
"""Byte order marks and their encodings, longer ones first, as the mark of UTF-16 begins that of UTF-32."""

_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+([eE][-+]?\d+)?")


def has_byte_order_mark(content: bytes) -> bool:
    """Return whether `content` begins with a byte order mark."""
    return content.startswith(tuple(_MARKS))


def drop_byte_order_mark(content: bytes, name: str) -> bytes:
    """Return `content` without a byte order mark; UTF-16 and UTF-32 become UTF-8."""
    mark = next((mark for mark in _MARKS if content.startswith(mark)), b"")
    rest = content[len(mark) :]
    if _MARKS.get(mark, "utf-8") == "utf-8":
        return rest
    try:
        return rest.decode(_MARKS[mark]).encode()
    except UnicodeError as error:
        raise StageError(
            f"{name}: begins as {_MARKS[mark].upper()} text but is not valid text of that encoding; {AGAIN}"
        ) from error


def read_text(path: Path) -> bytes:
    """Return the text of a file as UTF-8 without a byte order mark, each line ended by one newline."""
    return unify_line_ends(drop_byte_order_mark(path.read_bytes(), path.name))


def unify_line_ends(content: bytes) -> bytes:
    """Return text with CR LF and CR as LF."""
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in content else content


def numbers_in(text: bytes, place: str) -> Floats:
    """Return the numbers in `text`, separated by white space; anything else is an error at `place`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy stops at the first word that is not a number, with this warning
            return np.fromstring(text, np.float64, sep=" ")
    except (DeprecationWarning, ValueError) as error:
        line, word = next(
            (
                (number, word)
                for number, row in enumerate(text.split(b"\n"), 1)
                for word in row.split()
                if not_number(word)
            ),
            (1, b""),
        )
        raise StageError(f"{place}: must be numbers, got {quote(word)} in its line {line}; {cause(word)}") from error


def rows_to_numbers(rows: Sequence[Sequence[bytes]], content: bytes, name: str) -> Floats:
    """Return rows of three words as numbers, (n, 3); `content` gives the line of an invalid one for the error."""
    try:
        return np.array(rows, dtype=np.bytes_).reshape(-1, 3).astype(np.float64)
    except ValueError as error:
        word = next((word for row in rows for word in row if not_number(word)), b"")
        line = next((number for number, row in enumerate(content.split(b"\n"), 1) if word in row.split()), 0)
        place = f"{name}:{line}" if line else name
        raise StageError(f"{place}: a vertex must be three numbers, got {quote(word)}; {cause(word)}") from error


def not_number(word: bytes) -> bool:
    """Return whether a word is not a number."""
    try:
        float(word)
    except ValueError:
        return True
    return False


def cause(word: bytes) -> str:
    """Return why a word is not a number, and the remedy."""
    if _DECIMAL_COMMA.fullmatch(word):
        return "it has a decimal comma: export it with decimal points (set the program's or the system's number format)"
    return AGAIN


def quote(words: bytes, most: int = 40) -> str:
    """Return the beginning of a file's text, in quotes and printable."""
    start = words[:most].decode("utf-8", "replace")
    return repr("".join(letter if letter.isprintable() else "." for letter in start))


def space_in(text: bytes) -> str | None:
    """Return the anatomical axes in a header or comment, as 3D Slicer writes them: `SPACE=RAS` or `SPACE=LPS`."""
    found = re.search(rb"\bSPACE\s*[=:]\s*(RAS|LPS)\b", text, re.IGNORECASE)
    return found[1].decode().upper() if found else None
