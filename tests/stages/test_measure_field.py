from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_pipeline.artifacts import Certificate, Metrics, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError
from scaffold_stages.measure_field import MeasureFieldParams, measure_field
from shapes import box

CUBE = OuterShape(*box((-5.0, -5.0, -5.0), (5.0, 5.0, 5.0)))
AXIS = np.linspace(-6.0, 6.0, 61)
X, Y, Z = np.meshgrid(AXIS, AXIS, AXIS, indexing="ij")
CERTIFICATE = Certificate(channel_maxima=np.array([-0.9, -0.5, 0.3]), strut_minima=np.array([0.6, 0.1]))


def field_of(values: np.ndarray, certificate: Certificate | None = None) -> ScalarField:
    return ScalarField(values, np.full(3, AXIS[0]), AXIS[1] - AXIS[0], certificate, {"rank": 7})


def measured(values: np.ndarray, certificate: Certificate | None = None, **parameters: float) -> Metrics:
    return measure_field(field_of(values, certificate), CUBE, params=MeasureFieldParams(**parameters))


def test_a_ball_is_one_piece_of_its_volume_in_one_pore():
    values = measured(3.0 - np.sqrt(X**2 + Y**2 + Z**2), iso=0.0).values
    assert values["porosity"] == pytest.approx(1.0 - 4.0 / 3.0 * np.pi * 27.0 / 1000.0, abs=0.01)
    assert (values["solid_pieces"], values["pore_pieces"]) == (1, 1)
    assert values["rank"] == 7


def test_slabs_are_counted_apart_and_the_largest_has_its_share():
    values = measured(np.where(np.abs(X) > 4.0, 1.0, np.where(np.abs(X) < 2.0, 1.0, -1.0)), iso=0.0).values
    assert (values["solid_pieces"], values["pore_pieces"]) == (3, 2)
    assert values["solid_largest_fraction"] == pytest.approx(4.0 / 6.0, abs=0.05)
    assert values["pore_largest_fraction"] == pytest.approx(0.5, abs=0.01)


def test_a_porosity_is_met_and_grows_with_the_iso():
    values = np.sin(X) * np.cos(Y) + np.sin(Y) * np.cos(Z) + np.sin(Z) * np.cos(X)
    asked = measured(values, porosity=0.65).values
    assert asked["porosity"] == pytest.approx(0.65, abs=1e-3)
    porosities = [measured(values, iso=iso).values["porosity"] for iso in (-0.5, 0.0, 0.5)]
    assert np.all(np.diff(porosities) > 0.1)
    assert measured(values, iso=asked["iso"]).values["porosity"] == asked["porosity"]


def test_a_field_that_leaves_no_solid_is_a_result():
    metrics = measured(np.full(X.shape, -1.0), iso=0.0)
    values = metrics.values
    assert (values["porosity"], values["solid_pieces"], values["solid_largest_fraction"]) == (1.0, 0, None)
    assert values["pore_largest_fraction"] == 1.0
    assert metrics.summary()["quality"] == "not measured"


def test_channels_and_struts_are_counted_at_the_iso_used():
    values = measured(X, CERTIFICATE, iso=0.2).values
    assert (values["channels_closed"], values["struts_broken"]) == (1, 1)
    assert values["channels_open_fraction"] == pytest.approx(2.0 / 3.0)
    assert values["struts_whole_fraction"] == pytest.approx(0.5)
    assert "channels_closed" not in measured(X, iso=0.2).values


def test_a_shape_off_the_grid_is_refused():
    far = OuterShape(*box((50.0, 0.0, 0.0), (51.0, 1.0, 1.0)))
    with pytest.raises(StageError, match="no sample of the field lies inside"):
        measure_field(field_of(X), far, params=MeasureFieldParams(iso=0.0))


@pytest.mark.parametrize("parameters", [{}, {"iso": 0.0, "porosity": 0.5}])
def test_one_of_iso_and_porosity_is_asked_for(parameters: dict[str, float]):
    with pytest.raises(ValidationError, match="either iso or porosity"):
        MeasureFieldParams(**parameters)
