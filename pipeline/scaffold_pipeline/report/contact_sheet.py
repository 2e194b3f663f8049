"""Pictures side by side: thumbnails for a page, and one picture of many with captions, for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from math import ceil, sqrt
from pathlib import Path
from statistics import mode
from typing import TYPE_CHECKING, TypeAlias

from PIL import Image, ImageDraw, ImageFont, ImageOps

from scaffold_pipeline.artifacts import Drawing

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont
    from PIL.ImageFont import ImageFont as BitmapFont

    Font: TypeAlias = FreeTypeFont | BitmapFont

_QUALITY = 88
"""JPEG quality without visible artefacts on a rendered surface."""

_PICTURE, _GAP, _MARGIN = 300, 12, 40  # pixels
_NAME, _TEXT, _LINE = 30, 24, 30  # pixels: sizes of type, and a line of text
_MOST_WIDTH = 3 * _PICTURE
"""Width, pixels, of a cell with a long name."""
_TALL = 1.25
"""Gives a sheet of many cells about the aspect ratio of a page of paper."""
_MOST_LINES = 9
_PAPER, _INK, _FAINT = (255, 255, 255), (35, 39, 46), (102, 112, 128)


@dataclass(frozen=True)
class Cell:
    """One point of a contact sheet: its name, the lines under it, and its pictures."""

    name: str
    lines: tuple[str, ...]
    pictures: tuple[Image.Image, ...]


def in_order(names: Sequence[str], drawings: Sequence[Drawing]) -> list[str]:
    """Return the names of the pictures among some files: declared ones in their order, then others.

    >>> declared = [Drawing("mesh.png", "Mesh", ""), Drawing("preview.png", "Solid", "")]
    >>> in_order(["preview.png", "solid.stl", "a.png", "mesh.png"], declared)
    ['mesh.png', 'preview.png', 'a.png']
    """
    ranks = {drawing.file: number for number, drawing in enumerate(drawings)}
    pictures = sorted(name for name in names if name.lower().endswith(".png"))
    return sorted(pictures, key=lambda name: ranks.get(name, len(ranks)))


def thumbnail(path: Path) -> Image.Image | None:
    """Return a thumbnail of the picture in a file, on white; None if it cannot be read."""
    try:
        with Image.open(path) as picture:
            whole = ImageOps.contain(picture.convert("RGBA"), (_PICTURE, _PICTURE), Image.Resampling.LANCZOS)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    image = Image.new("RGB", whole.size, _PAPER)
    image.paste(whole, mask=whole.getchannel("A"))
    return image


def to_jpeg(picture: Image.Image) -> bytes:
    """Return a picture as a JPEG file."""
    stream = BytesIO()
    picture.save(stream, "JPEG", quality=_QUALITY)
    return stream.getvalue()


def draw_sheet(title: str, cells: Sequence[Cell]) -> Image.Image:
    """Return a picture of all cells in rows, each with its pictures side by side and its lines under them.

    Cells have room for the most common number of pictures; more pictures are drawn smaller.
    """
    across = max(1, mode(len(cell.pictures) for cell in cells))
    names = max(_font(_NAME).getlength(cell.name) for cell in cells)
    width = max(across * (_PICTURE + _GAP) - _GAP, min(ceil(names), _MOST_WIDTH))
    columns = max(1, min(len(cells), round(sqrt(_TALL * len(cells) / across))))
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    texts = [[_wrap_lines(cell.lines, width) for cell in row] for row in rows]
    heights = [_PICTURE + 2 * _NAME + _LINE * max(map(len, text)) + _MARGIN for text in texts]
    size = (_MARGIN + columns * (width + _MARGIN), _MARGIN + 3 * _NAME + sum(heights))
    sheet = Image.new("RGB", size, _PAPER)
    ImageDraw.Draw(sheet).text((_MARGIN, _MARGIN), title, _INK, _font(_NAME * 3 // 2))
    y = _MARGIN + 3 * _NAME
    for row, text, height in zip(rows, texts, heights, strict=True):
        for column, (cell, lines) in enumerate(zip(row, text, strict=True)):
            _draw_cell(
                sheet, (_MARGIN + column * (width + _MARGIN), y, width), cell, (_fit_width(cell.name, width), *lines)
            )
        y += height
    return sheet


def _draw_cell(sheet: Image.Image, place: tuple[int, int, int], cell: Cell, text: Sequence[str]) -> None:
    """Draw a cell at x, y of the given width."""
    x, y, width = place
    pen = ImageDraw.Draw(sheet)
    side = min(_PICTURE, (width + _GAP) // max(1, len(cell.pictures)) - _GAP)
    for number, picture in enumerate(cell.pictures):
        small = picture if side == _PICTURE else ImageOps.contain(picture, (side, side))
        sheet.paste(small, (x + number * (side + _GAP), y + (_PICTURE - small.height) // 2))
    if not cell.pictures:
        pen.text((x, y + _PICTURE // 2), "no picture", _FAINT, _font(_TEXT))
    name, *lines = text
    pen.text((x, y + _PICTURE + _NAME // 4), name, _INK, _font(_NAME))
    for number, line in enumerate(lines):
        pen.text((x, y + _PICTURE + 7 * _NAME // 4 + number * _LINE), line, _FAINT, _font(_TEXT))


def _fit_width(name: str, width: int) -> str:
    """Return the end of a name that is too long: the ends of points' names differ."""
    font = _font(_NAME)
    starts = (name, *(f"\u2026{name[start:]}" for start in range(1, len(name))))
    return next((start for start in starts if font.getlength(start) <= width), name[-1:])


def _wrap_lines(lines: Sequence[str], width: int) -> list[str]:
    """Return `lines` broken at blanks to `width` pixels; further lines are replaced by an ellipsis."""
    font, broken = _font(_TEXT), []
    for line in lines:
        current = ""
        for word in line.split():
            longer = f"{current} {word}".strip()
            if current and font.getlength(longer) > width:
                broken.append(current)
                longer = word
            current = longer
        broken.append(current)
    return broken if len(broken) <= _MOST_LINES else [*broken[: _MOST_LINES - 1], f"{broken[_MOST_LINES - 1]} \u2026"]


def _font(size: int) -> Font:
    return ImageFont.load_default(size)
