"""A contour becomes a plate of its area and height, with a handle for each hole."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.surfaces.self_intersections import self_intersecting_faces
from scaffold_pipeline.artifacts import Contour, Polygons, Solid
from scaffold_stages.contour import ContourParams, contour
from scaffold_stages.extrude import ExtrudeParams, extrude
from shapes import planar_field, require_closed, squares

MESH = squares((4, 3), 2.0, 1.5)


def grid(x, y):
    """Bars along the edges of the tiles, a pore in the middle of each."""
    return np.maximum(np.cos(np.pi * x), -np.cos(np.pi * y))


def holed(values=grid, *, porosity: float = 0.4) -> Contour:
    return contour(planar_field(values, 4.0, 0.08, 1.5), MESH, params=ContourParams(porosity=porosity))


def plate_of(given: Contour, height: float = 2.5) -> Solid:
    return extrude(given, params=ExtrudeParams(height=height))


def euler(solid: Solid) -> int:
    return len(solid.vertices) - 3 * len(solid.faces) // 2 + len(solid.faces)


@pytest.mark.parametrize("porosity", [0.1, 0.4, 0.6])
def test_a_plate_has_the_area_and_height_of_its_contour(porosity: float):
    given = holed(porosity=porosity)
    plate = plate_of(given)
    require_closed(plate.vertices, plate.faces)
    assert not self_intersecting_faces(plate.vertices, plate.faces).any()
    assert plate.volume == pytest.approx(2.5 * given.solid.area, rel=1e-6)
    assert plate.bounds == pytest.approx(np.array([(-4.0, -3.0, 1.5), (4.0, 3.0, 4.0)]), abs=1e-6)
    assert plate.pore_volumes.sum() == pytest.approx(2.5 * (48.0 - given.solid.area), rel=1e-6)


def test_a_plate_has_a_handle_for_each_hole():
    given = holed()
    assert (given.pieces, given.holes) == (1, 12)
    assert euler(plate_of(given)) == 2 - 2 * 12
    pieces = holed(lambda x, y: -grid(x, y), porosity=0.8)
    assert (pieces.pieces, pieces.holes) == (12, 0)
    assert euler(plate_of(pieces)) == 2 * 12


def test_far_from_the_origin_a_plate_is_still_one_that_a_file_holds():
    given = holed()
    place = np.array([3000.0, -500.0])
    moved = [Polygons.of([ring + place for ring in each.rings]) for each in (given.solid, given.outline)]
    plate = plate_of(Contour(*moved, 1.5, given.iso))
    require_closed(plate.vertices, plate.faces)
    assert np.array_equal(plate.vertices, plate.vertices.astype(np.float32))
    assert plate.volume == pytest.approx(2.5 * given.solid.area, rel=1e-4)


@pytest.mark.parametrize("height", [0.0, -1.0, None])
def test_a_plate_needs_a_height(height: float | None):
    with pytest.raises(ValidationError):
        ExtrudeParams.model_validate({"height": height} if height is not None else {})
