"""The iso is the one asked for, or the one at which the solid that is cut out has the porosity asked for."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.surfaces import booleans
from scaffold_pipeline.artifacts import IsoSurface, OuterShape, ScalarField
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import Follows, stage_from_function
from scaffold_stages.isosurface import TOLERANCE, IsosurfaceParams, isosurface
from shapes import ball, box, gyroid, outer_of, require_closed, samples_over

BALL = outer_of(ball(6.0, (30.0, -10.0, 5.0)))
FIELD = gyroid(BALL, 0.4, 6.0)


def found(field: ScalarField = FIELD, outer: OuterShape = BALL, **given: float):
    return isosurface(field, outer, params=IsosurfaceParams.model_validate(given))


def porosity_of(surface: IsoSurface, outer: OuterShape, skin: float = 0.0):
    """Return the porosity of the clipped solid's main piece with all closed pores, measured apart from the stage."""
    core = booleans.offset_core(outer.vertices, outer.faces, skin)
    shape = booleans.to_manifold(outer.vertices, outer.faces, "outer")
    solid, _ = booleans.clip_to_outer(booleans.to_manifold(surface.vertices, surface.faces, "porous"), shape, core)
    volumes = [part.volume() for part in solid.decompose()]
    return 1.0 - (max(volumes) + sum(volume for volume in volumes if volume < 0.0)) / shape.volume()


def field_of(values: np.ndarray, origin: np.ndarray, spacing: float):
    return ScalarField(np.asarray(values, np.float32), origin, spacing)


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("isosurface", isosurface)
    assert (declared.writes, list(declared.reads)) == ("porous", ["field", "outer"])
    assert {name: mark.stage for name, mark in declared.params.marked(Follows).items()} == {
        "skin": "intersect_outer",
        "min_closed_pore": "intersect_outer",
        "fill": "intersect_outer",
    }


@pytest.mark.parametrize("given", [{}, {"porosity": 0.5, "iso": 0.0}], ids=["neither", "both"])
def test_an_iso_or_a_porosity_is_given(given: dict[str, float]):
    with pytest.raises(ValidationError, match="give either porosity or iso"):
        IsosurfaceParams.model_validate(given)


@pytest.mark.parametrize("porosity", [0.0, 1.0, -0.1, 1.2, float("nan")])
def test_a_porosity_outside_of_its_range_is_no_parameter(porosity: float):
    with pytest.raises(ValidationError):
        IsosurfaceParams(porosity=porosity)


@pytest.mark.parametrize("porosity", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_the_clipped_solid_has_the_porosity_asked_for(porosity: float):
    surface = found(porosity=porosity)
    require_closed(surface.vertices, surface.faces)
    assert porosity_of(surface, BALL) == pytest.approx(porosity, abs=TOLERANCE)
    assert surface.porosity_requested == porosity
    assert surface.facts["porosity_solved"] == pytest.approx(porosity_of(surface, BALL), abs=1e-6)
    assert surface.facts["rounds"] <= 5


def test_pores_grow_with_the_iso():
    surfaces = [found(iso=iso) for iso in np.linspace(-1.0, 1.0, 6)]
    porosities = [porosity_of(surface, BALL) for surface in surfaces]
    assert (np.diff(porosities) > 0.05).all()
    assert [surface.iso for surface in surfaces] == pytest.approx(np.linspace(-1.0, 1.0, 6))
    assert all(surface.porosity_requested is None for surface in surfaces)


def test_the_iso_grows_with_the_porosity():
    assert (np.diff([found(porosity=porosity).iso for porosity in (0.2, 0.45, 0.7)]) > 0.1).all()


@pytest.mark.parametrize("skin", [0.3, 1.0])
def test_with_a_skin_the_porosity_is_that_of_the_whole(skin: float):
    surface = found(porosity=0.3, skin=skin)
    assert surface.skin == skin
    assert porosity_of(surface, BALL, skin) == pytest.approx(0.3, abs=TOLERANCE)
    assert porosity_of(surface, BALL) > 0.3 + 10 * TOLERANCE  # without the skin it is another


def test_a_porosity_that_a_skin_leaves_no_room_for_is_refused_with_the_greatest_possible():
    with pytest.raises(StageError, match=r"^porosity 0.6: a skin of 1 mm leaves at most 0.57\d; lower one of them$"):
        found(porosity=0.6, skin=1.0)
    with pytest.raises(StageError, match=r"^skin 7 mm: fills the whole outer shape"):
        found(porosity=0.3, skin=7.0)


def test_a_field_that_is_the_same_everywhere_has_no_surface():
    same = field_of(np.full(FIELD.values.shape, 0.3), FIELD.origin, FIELD.spacing)
    for given in ({"porosity": 0.5}, {"iso": 0.1}):
        with pytest.raises(StageError, match="the same everywhere inside the outer shape"):
            found(same, **given)


@pytest.mark.parametrize("iso", [-3.0, 1.6])
def test_an_iso_outside_of_what_the_field_takes_inside_the_shape_is_refused_with_its_range(iso: float):
    with pytest.raises(StageError, match=r"^iso -?\d.*: no surface inside .* from -1\.\d+ to 1\.\d+; choose"):
        found(iso=iso)


def test_values_outside_of_the_outer_shape_do_not_count():
    wild = FIELD.values.copy()
    wild[0], wild[-1] = 50.0, -50.0
    with pytest.raises(StageError, match=r"from -1\.\d+ to 1\.\d+"):
        found(field_of(wild, FIELD.origin, FIELD.spacing), iso=40.0)


def test_pieces_that_float_do_not_count_as_solid():
    outer = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)))
    origin, places = samples_over((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 0.5)
    pillar = 3.0 - np.linalg.norm(places[..., :2] - [4.0, 4.0], axis=-1)
    crumb = 1.8 - np.linalg.norm(places - 8.0, axis=-1)
    surface = found(field_of(np.maximum(pillar, crumb), origin, 0.5), outer, porosity=0.8)
    assert porosity_of(surface, outer) == pytest.approx(0.8, abs=TOLERANCE)
    shape = booleans.to_manifold(outer.vertices, outer.faces, "outer")
    everything = booleans.to_manifold(surface.vertices, surface.faces, "porous") ^ shape
    assert 1.0 - everything.volume() / 1000.0 < 0.8 - 5 * TOLERANCE


def closed_pores(radii: float):
    """A box of solid with four round pores that touch nothing."""
    outer = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)))
    origin, places = samples_over((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 0.4)
    centres = np.array([(2.6, 2.6, 2.6), (7.4, 7.4, 2.6), (7.4, 2.6, 7.4), (2.6, 7.4, 7.4)])
    distances = np.linalg.norm(places[..., None, :] - centres, axis=-1).min(axis=-1)
    return field_of(np.minimum(distances - radii, 2.0), origin, 0.4), outer


def test_closed_pores_that_the_clip_keeps_count_as_pores():
    field, outer = closed_pores(2.0)
    surface = found(field, outer, porosity=0.1)
    assert surface.facts["porosity_solved"] == pytest.approx(0.1, abs=TOLERANCE)


def test_a_porosity_that_no_iso_gives_is_answered_by_the_nearest_and_a_warning():
    field, outer = closed_pores(2.0)
    with pytest.warns(PipelineWarning, match=r"^porosity 0.1: no iso-value gives it; the nearest is 0.\d+ at iso"):
        surface = found(field, outer, porosity=0.1, fill=True)
    require_closed(surface.vertices, surface.faces)
    assert surface.facts["rounds"] == 12
