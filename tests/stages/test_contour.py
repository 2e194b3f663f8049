"""A contour has the area of its field's form, is cut to the mesh's outline, and meets the porosity asked for."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.planar import regions
from scaffold_pipeline.artifacts import Contour, OuterShape, PlanarMesh, ScalarField
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from scaffold_stages.contour import ContourParams, contour
from scaffold_stages.jitter_planar import JitterPlanarParams, jitter_planar
from shapes import ball, box, planar_field, squares

SHEET = squares((4, 4), 2.0, 5.0)
"""8 x 8 mm in the plane z = 5 mm."""


def dots(x, y):
    """Sixteen hills over the sheet, one in each tile, from -1 to 1."""
    return (np.cos(np.pi * (x - 1.0)) + np.cos(np.pi * (y - 1.0))) / 2.0


def field_of(values, spacing: float = 0.08, half: float = 4.0, z: float = 5.0) -> ScalarField:
    return planar_field(values, half, spacing, z)


def contour_of(values, mesh: PlanarMesh = SHEET, outer: OuterShape | None = None, **given: object) -> Contour:
    field = values if isinstance(values, ScalarField) else field_of(values)
    return contour(field, mesh, outer, params=ContourParams.model_validate(given))


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("contour", contour)
    assert declared.writes == "contour"
    assert {name for name, read in declared.reads.items() if not read.optional} == {"field", "mesh"}


def test_the_area_of_a_disc_is_met_ever_better():
    errors = []
    for spacing in (0.4, 0.2, 0.1):
        found = contour_of(field_of(lambda x, y: 3.0 - np.hypot(x, y), spacing), iso=0.5)
        assert (found.pieces, found.holes, found.z, found.iso) == (1, 0, 5.0, 0.5)
        errors.append(abs(found.solid.area - 6.25 * np.pi))
    assert errors[2] < errors[1] / 2.0 < errors[0] / 4.0
    assert errors[2] < 1e-3 * 6.25 * np.pi


def test_a_field_that_ends_beyond_the_outline_is_cut_exactly_to_it():
    found = contour_of(lambda x, y: x + y - 0.3, iso=0.0)
    assert found.solid.area == pytest.approx((8.0 - 0.3) ** 2 / 2.0, abs=1e-5)
    assert found.outline.area == 64.0
    assert found.solid.points.max() == 4.0
    assert np.isclose(found.solid.points, [4.0, 4.0]).all(axis=1).any()  # the corner is sharp


def test_holes_run_clockwise_and_pieces_counter_clockwise():
    holed = contour_of(lambda x, y: -dots(x, y), iso=-0.5)
    assert (holed.pieces, holed.holes) == (1, 16)
    assert (holed.solid.areas < 0.0).sum() == 16
    dotted = contour_of(dots, iso=0.5)
    assert (dotted.pieces, dotted.holes) == (16, 0)


def test_porosity_grows_with_iso():
    porosities = [contour_of(dots, iso=float(iso)).porosity for iso in np.linspace(-0.95, 0.95, 20)]
    assert all(a < b for a, b in pairwise(porosities))


@pytest.mark.parametrize("porosity", [0.02, 0.3, 0.5, 0.77, 0.99])
def test_a_porosity_is_met(porosity: float):
    found = contour_of(dots, porosity=porosity)
    assert found.porosity == pytest.approx(porosity, abs=1e-3)
    assert found.porosity_requested == porosity
    assert contour_of(dots, iso=found.iso).porosity == found.porosity


def test_a_mirrored_mesh_gives_the_mirrored_contour():
    sheet = squares((3, 2), 2.0)
    mesh = jitter_planar(sheet, params=JitterPlanarParams(amount=0.3), rng=np.random.default_rng(4))
    mirrored = PlanarMesh(mesh.vertices * [-1.0, 1.0, 1.0], quadrangles=mesh.quadrangles[:, ::-1])
    params = ArbfFieldParams(voxel_size=0.1)
    one, other = (contour_of(arbf_field(each, params=params), each, porosity=0.4) for each in (mesh, mirrored))
    images = [ring[::-1] * [-1.0, 1.0] for ring in other.solid.rings]
    a, b = regions.to_region(one.solid.rings), regions.to_region(images)
    assert ((a - b) + (b - a)).area() < 1e-4 * a.area()
    assert (one.pieces, one.holes) == (other.pieces, other.holes)


def test_a_plate_of_whole_struts_is_one_piece_with_a_hole_in_each_tile():
    mesh = squares((3, 2), 2.0)
    field = arbf_field(mesh, params=ArbfFieldParams(voxel_size=0.05))
    assert field.certificate is not None
    found = contour_of(field, mesh, iso=field.certificate.strut_min - 0.2)
    assert (found.pieces, found.holes) == (1, 6)
    assert found.porosity > 0.2


def test_an_outer_shape_cuts_to_its_section_in_the_plane():
    outer = OuterShape(*ball(3.0, (0.0, 0.0, 5.0), 6))
    whole = contour_of(lambda x, y: np.where(np.hypot(x, y) < 0.5, -1.0, 1.0), outer=outer, iso=0.0)
    assert whole.outline.area == pytest.approx(9.0 * np.pi, rel=2e-3)
    assert whole.porosity == pytest.approx(0.25 / 9.0, abs=3e-3)
    half = contour_of(lambda x, _: x, outer=outer, porosity=0.5)
    assert half.solid.area == pytest.approx(4.5 * np.pi, rel=2e-3)
    assert half.iso == pytest.approx(0.0, abs=2e-3)


def test_small_pieces_go_where_that_is_asked_for_and_the_porosity_is_met_without_them():
    def one_and_specks(x, y):
        return np.maximum(2.5 - np.hypot(x, y), 0.3 - np.hypot(np.abs(x) - 3.3, np.abs(y) - 3.3))

    assert contour_of(one_and_specks, iso=0.0).pieces == 5
    found = contour_of(one_and_specks, iso=0.0, min_piece=0.01)
    assert (found.pieces, found.solid.area) == (1, pytest.approx(6.25 * np.pi, rel=1e-3))
    met = contour_of(one_and_specks, porosity=0.7, min_piece=0.01)
    assert (met.pieces, met.porosity) == (1, pytest.approx(0.7, abs=1e-3))
    with pytest.raises(StageError, match=r"^iso 0: no piece of .* lower min_piece or iso$"):
        contour_of(one_and_specks, iso=0.0, min_piece=0.5)


def test_an_outer_shape_beside_the_mesh_is_an_error():
    with pytest.raises(StageError, match=r"^mesh: no part of it lies inside the outer shape at z = 5 mm; "):
        contour_of(dots, outer=OuterShape(*box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))), iso=0.0)


@pytest.mark.parametrize("iso", [-1.5, 1.0, 2.0])
def test_an_iso_beyond_the_field_is_an_error_that_tells_its_range(iso: float):
    with pytest.raises(
        StageError,
        match=rf"^iso {iso:g}: must be within the range of the field inside the outline, -1 to 1; choose a va",
    ):
        contour_of(field_of(dots, 0.1), iso=iso)


def test_only_samples_within_the_outline_count():
    with pytest.raises(StageError, match=r"inside the outline, -1\.\d+ to 1; choose a value between"):
        contour_of(
            lambda x, y: np.where(np.hypot(x, y) < 3.99, 1.0 - np.hypot(x, y), 9.0), squares((4, 4), 1.0, 5.0), iso=5.0
        )


def test_a_porosity_out_of_reach_is_an_error_that_tells_the_reachable():
    ends_early = field_of(dots, half=2.0)
    said = r"^porosity 0\.5: must be within the range of this field, 0\.6\d* to (0\.99\d*|1\.0000); raise porosity$"
    with pytest.raises(StageError, match=said):
        contour_of(ends_early, porosity=0.5)
    assert contour_of(ends_early, porosity=0.9).porosity == pytest.approx(0.9, abs=1e-3)


def test_a_porosity_near_one_is_out_of_reach_of_pixels():
    with pytest.raises(
        StageError, match=r"^porosity 0\.999999: must be within the range of this field, .* lower porosity$"
    ):
        contour_of(dots, porosity=0.999999)


def test_a_porosity_that_the_field_jumps_over_is_a_warning():
    with pytest.warns(UserWarning, match=r"^porosity 0\.4: no iso-value gives it; the nearest is 0\.\d+ at iso"):
        contour_of(lambda x, _: np.where(x > 1.0, 1.0, np.where(x < -3.0, -1.0, 0.0)), porosity=0.4)


def test_a_field_without_change_has_no_contour():
    with pytest.raises(StageError, match=r"^field: is constant inside the outline and has no contour"):
        contour_of(lambda x, _: np.ones_like(x), porosity=0.4)


def test_a_field_of_many_layers_is_an_error_that_names_another_stage():
    solid = ScalarField(np.random.default_rng(1).normal(size=(9, 9, 7)), np.array([-4.0, -4.0, 5.0]), 1.0)
    with pytest.raises(StageError, match=r"^field: must have one layer of samples for a contour, got 7; .*isosurface"):
        contour_of(solid, iso=0.0)


def test_a_field_in_another_plane_is_an_error():
    with pytest.raises(
        StageError, match=r"^field: must lie in the mesh's plane, z = 5 mm, got 4; use this mesh's field"
    ):
        contour_of(field_of(dots, z=4.0), iso=0.0)


@pytest.mark.parametrize("given", [{}, {"iso": 0.0, "porosity": 0.5}])
def test_either_porosity_or_iso_is_given(given: dict[str, float]):
    with pytest.raises(ValidationError, match="give either porosity or iso"):
        ContourParams.model_validate(given)
