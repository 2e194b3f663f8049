from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scaffold_pipeline.report.contact_sheet import Cell, draw_sheet, thumbnail

RED, BLUE = (200, 40, 40), (40, 40, 200)


def picture(path: Path, size: tuple[int, int], colour: tuple[int, ...] = RED, mode: str = "RGB") -> Path:
    Image.new(mode, size, colour).save(path)
    return path


def cell(name: str = "point", colours: tuple[tuple[int, int, int], ...] = (RED, BLUE), *lines: str) -> Cell:
    return Cell(name, lines, tuple(Image.new("RGB", (300, 200), colour) for colour in colours))


def places(sheet: Image.Image, colour: tuple[int, int, int]) -> np.ndarray:
    """Return the rows and columns of the pixels of a colour."""
    return np.argwhere((np.asarray(sheet) == colour).all(axis=-1))


@pytest.mark.parametrize("size", [(1200, 400), (400, 1200), (900, 900), (40, 20)])
def test_a_picture_keeps_its_proportions(size: tuple[int, int], tmp_path: Path):
    small = thumbnail(picture(tmp_path / "a.png", size))
    assert small is not None
    assert max(small.size) == 300
    assert small.width / small.height == pytest.approx(size[0] / size[1], rel=0.01)


def test_what_is_transparent_is_white(tmp_path: Path):
    small = thumbnail(picture(tmp_path / "a.png", (10, 10), (200, 40, 40, 0), "RGBA"))
    assert small is not None
    assert small.getpixel((5, 5)) == (255, 255, 255)


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_no_picture_is_none(content: bytes, tmp_path: Path):
    (tmp_path / "a.png").write_bytes(content)
    assert thumbnail(tmp_path / "a.png") is None
    assert thumbnail(tmp_path / "gone.png") is None


def test_pictures_of_a_point_stand_side_by_side_in_their_order():
    sheet = draw_sheet("study", [cell()] * 4)
    red, blue = places(sheet, RED), places(sheet, BLUE)
    assert len(red) == len(blue) == 4 * 300 * 200
    assert set(red[:, 0]) == set(blue[:, 0])
    assert blue[:, 1].min() - red[:, 1].min() > 300


def test_where_a_point_has_more_pictures_than_most_they_are_smaller():
    sheet = draw_sheet("study", [cell("a", (RED, RED)), cell("b", (RED, RED)), cell("c", (BLUE, BLUE, BLUE))])
    red, blue = places(sheet, RED), places(sheet, BLUE)
    assert np.ptp(blue[:, 1]) == pytest.approx(602, abs=15)
    assert len(blue) / 3 == pytest.approx(len(red) / 4 * (196 / 300) ** 2, rel=0.05)


def test_a_sheet_of_many_points_has_rows_and_is_about_as_tall_as_a_page():
    sheet = draw_sheet("study", [cell("point", (RED, BLUE), "word " * 20)] * 22)
    assert 1.0 < sheet.height / sheet.width < 1.6


@pytest.mark.parametrize("colours", [(), (RED,), (RED, BLUE)])
def test_no_text_leaves_its_cell_however_long(colours: tuple[tuple[int, int, int], ...]):
    cells = [cell("n" * 100, colours, "word " * 200, "w" * 20), cell("b", colours)]
    sheet = draw_sheet("s", cells)
    alone = draw_sheet("s", cells[:1])
    assert np.argwhere((np.asarray(alone) < 250).any(axis=-1))[:, 1].max() < alone.width - 30
    assert len(places(sheet, RED)) == 300 * 200 * 2 * (RED in colours)


def test_a_point_without_pictures_has_a_place_that_says_so():
    bare, empty = draw_sheet("s", [cell(), cell()]), draw_sheet("s", [cell(), cell("point", ())])
    assert bare.size == empty.size
    assert len(places(empty, RED)) == 300 * 200
    right = np.asarray(empty)[:, empty.width // 2 :]
    assert (right[100:400] < 250).any()
