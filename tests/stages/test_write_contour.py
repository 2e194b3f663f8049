"""The drawings of a contour hold its polygons, in mm and in place, and are the same bytes at every run."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from pydantic import ValidationError
from skimage.io import imread

from scaffold_pipeline.artifacts import Contour, Polygons
from scaffold_stages.contour import ContourParams, contour
from scaffold_stages.write_contour import WriteContourParams, write_contour
from shapes import planar_field, squares

SVG = "{http://www.w3.org/2000/svg}"


def rings_field(x, y):
    """A disc of radius 1, a ring around it from 2 to 3, both off the middle."""
    r = np.hypot(x - 0.7, y + 0.2)
    return np.maximum(1.0 - r, 0.5 - np.abs(r - 2.5))


CONTOUR = contour(planar_field(rings_field, 4.0, 0.1), squares((8, 6), 1.0), params=ContourParams(iso=0.0))


def written(out: Path, given: Contour = CONTOUR, **params: object):
    return write_contour(given, params=WriteContourParams.model_validate(params), out=out)


def svg_rings(path: Path) -> list[np.ndarray]:
    """Return the rings of the only path of an SVG file, y up again."""
    (shape,) = etree.parse(path).getroot().iter(f"{SVG}path")
    assert shape.get("fill-rule") == "evenodd"
    parts = [part for part in re.split("[MZ]", shape.get("d")) if part.strip()]
    return [np.array([pair.split(",") for pair in part.split()], float) * [1.0, -1.0] for part in parts]


def test_the_svg_holds_the_polygons_in_their_place(tmp_path: Path):
    written(tmp_path)
    rings = svg_rings(tmp_path / "contour.svg")
    assert [len(ring) for ring in rings] == CONTOUR.solid.counts.tolist()
    assert np.abs(np.concatenate(rings) - CONTOUR.solid.points).max() <= 0.51e-6
    assert Polygons.of(rings).area == pytest.approx(CONTOUR.solid.area, abs=1e-5)


def test_the_svg_measures_what_it_shows_in_mm(tmp_path: Path):
    written(tmp_path, name='a <plate> & "more"')
    root = etree.parse(tmp_path / "contour.svg").getroot()
    left, top, width, height = map(float, root.get("viewBox").split())
    assert root.get("width") == f"{width:g}mm"
    assert root.get("height") == f"{height:g}mm"
    assert (left, -top, left + width, -top - height) == pytest.approx((-4.16, 3.16, 4.16, -3.16))
    assert root.findtext(f"{SVG}title") == 'a <plate> & "more"'


def test_two_runs_write_the_same_bytes(tmp_path: Path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        facts = written(tmp_path / name).facts
    for path in sorted((tmp_path / "one").iterdir()):
        content = path.read_bytes()
        assert content == (tmp_path / "two" / path.name).read_bytes()
        assert facts[f"{path.suffix[1:]}_bytes"] == len(content)


def test_the_png_is_dark_where_the_contour_is_solid(tmp_path: Path):
    written(tmp_path, pixels=832)
    image = imread(tmp_path / "contour.png")
    assert image.shape == (632, 832, 3)
    darkness = (255.0 - image[:, :, 0]) / (255.0 - 51.0)
    assert darkness.sum() * 0.01**2 == pytest.approx(CONTOUR.solid.area, rel=1e-3)
    for x, y, is_solid in ((0.7, -0.2, 1.0), (0.7, 1.3, 0.0), (0.7, 2.3, 1.0), (-1.8, -0.2, 1.0), (3.9, -2.9, 0.0)):
        assert darkness[round(100 * (3.16 - y)), round(100 * (x + 4.16))] == is_solid


def test_only_what_is_asked_for_is_written(tmp_path: Path):
    written(tmp_path, formats=["svg"])
    assert [path.name for path in tmp_path.iterdir()] == ["contour.svg"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"formats": []}, "at least 1"),
        ({"formats": ["svg", "svg"]}, "each format once"),
        ({"name": "two\nlines"}, "printable"),
        ({"pixels": 8001}, "less than or equal to 8000"),
    ],
)
def test_what_makes_no_drawing_is_no_parameter(given: dict[str, object], said: str):
    with pytest.raises(ValidationError, match=said):
        WriteContourParams.model_validate(given)


def test_a_ring_crosses_no_other(tmp_path: Path):
    written(tmp_path)
    radii = sorted(np.hypot(*(ring - [0.7, -0.2]).T).mean() for ring in svg_rings(tmp_path / "contour.svg"))
    assert all(b - a > 0.4 for a, b in pairwise(radii))
