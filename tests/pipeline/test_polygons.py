"""Polygons know their areas wherever they lie, and a contour its pieces, holes and porosity."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_pipeline.artifacts import Contour, Polygons
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.runs.store import Store

SQUARE = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])
HOLE = (SQUARE / 4.0 + 1.0)[::-1]
FAR = SQUARE / 2.0 + 10.0


def test_areas_are_signed_and_keep_their_digits_far_from_the_origin():
    for place in (0.0, 1e7):
        polygons = Polygons.of([SQUARE + place, HOLE + place, FAR + place])
        assert polygons.areas == pytest.approx([16.0, -1.0, 4.0], abs=1e-6)
        assert polygons.area == pytest.approx(19.0)
        assert all(np.array_equal(a, b + place) for a, b in zip(polygons.rings, (SQUARE, HOLE, FAR), strict=True))


def test_no_rings_are_polygons_without_area():
    nothing = Polygons.of([])
    assert (nothing.rings, nothing.area) == ([], 0.0)


@pytest.mark.parametrize("counts", [[4, 3], [8, 4], [2, 2], []])
def test_counts_that_do_not_fit_the_points_are_refused(counts: list[int]):
    with pytest.raises(StageError, match=r"^Polygons\.counts: must be 3 or more for each ring and 4 in all"):
        Polygons(SQUARE, np.array(counts, int))


def test_a_contour_tells_its_porosity_pieces_and_holes():
    contour = Contour(Polygons.of([SQUARE, HOLE, FAR]), Polygons.of([5.0 * SQUARE]), 1.5, 0.25, 0.9)
    assert (contour.pieces, contour.holes, contour.porosity) == (2, 1, pytest.approx(1.0 - 19.0 / 400.0))
    assert contour.summary()["area_mm2"] == pytest.approx(19.0)
    assert contour.summary()["porosity_requested"] == 0.9


@pytest.mark.parametrize(("solid", "outline"), [([], [SQUARE]), ([SQUARE], []), ([SQUARE[::-1]], [SQUARE])])
def test_a_contour_without_area_is_refused(solid: list[np.ndarray], outline: list[np.ndarray]):
    with pytest.raises(StageError, match=r"^Contour: must enclose an area within an outline"):
        Contour(Polygons.of(solid), Polygons.of(outline), 0.0, 0.0)


def test_a_contour_comes_back_from_the_store(tmp_path):
    store = Store(tmp_path)
    store.prepare()
    contour = Contour(Polygons.of([SQUARE, HOLE]), Polygons.of([SQUARE]), 1.5, 0.25)
    again = store.load(store.save(contour))
    assert isinstance(again, Contour)
    assert np.array_equal(again.solid.points, contour.solid.points)
    assert again.summary() == contour.summary()
