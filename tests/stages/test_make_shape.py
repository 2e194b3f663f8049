"""The shapes are what they say: closed, outward, of the size asked for and of decent triangles."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import make_shape as module
from scaffold_stages.make_shape import MakeShapeParams, make_shape
from shapes import self_intersections_by_cgal

SHAPES = [
    {"shape": "box", "width": 10.0, "depth": 7.0, "height": 3.0, "facet": 1.5},
    {"shape": "ball", "height": 10.0, "facet": 1.5},
    {"shape": "cylinder", "width": 6.0, "height": 10.0, "facet": 1.5},
    {"shape": "femur", "height": 60.0, "facet": 2.5},
]


def made(**given: object):
    return make_shape(params=MakeShapeParams.model_validate(given))


def smallest_angle(outer: OuterShape):
    corners = outer.vertices[outer.faces]
    sides = np.roll(corners, -1, axis=1) - corners
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    return np.degrees(np.arccos(-np.einsum("fij,fij->fi", sides, np.roll(sides, 1, axis=1)))).min()


def mean_edge(outer: OuterShape):
    corners = outer.vertices[outer.faces]
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).mean()


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("make_shape", make_shape)
    assert (declared.writes, declared.reads) == ("outer", {})


@pytest.mark.parametrize("given", SHAPES, ids=lambda given: given["shape"])
def test_every_shape_is_a_sound_body(given: dict[str, float]):
    outer = made(**given)
    assert not any(triangles.edge_faults(outer.faces))
    assert triangles.euler_characteristic(outer.faces) == 2
    assert triangles.touching_vertices(outer.faces) == 0
    assert self_intersections_by_cgal(outer.vertices, outer.faces) == []
    assert smallest_angle(outer) > 15.0
    assert mean_edge(outer) == pytest.approx(given["facet"], rel=0.2)
    assert outer.bounds[0, 2] == pytest.approx(0.0, abs=0.1)
    assert outer.bounds[1, 2] == pytest.approx(given["height"], rel=0.01)


@pytest.mark.parametrize("given", SHAPES, ids=lambda given: given["shape"])
def test_every_shape_is_the_same_to_the_bit_each_time(given: dict[str, float]):
    one, other = made(**given), made(**given)
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()


def test_a_box_has_its_volume_and_stands_over_the_origin():
    outer = made(shape="box", width=10.0, depth=7.0, height=3.0, facet=1.5)
    assert outer.volume == pytest.approx(210.0)
    np.testing.assert_allclose(outer.bounds, [[-5.0, -3.5, 0.0], [5.0, 3.5, 3.0]])


def test_a_side_left_out_follows_the_others():
    np.testing.assert_allclose(np.ptp(made(shape="box", height=4.0).bounds, axis=0), 4.0)
    np.testing.assert_allclose(np.ptp(made(shape="box", height=4.0, width=6.0).bounds, axis=0), [6.0, 6.0, 4.0])


def test_finer_balls_and_cylinders_come_nearer_to_the_formula():
    for shape, exact in (("ball", np.pi * 1000 / 6), ("cylinder", np.pi * 2500 / 10)):
        coarse, fine = (exact - made(shape=shape, height=10.0, facet=facet).volume for facet in (2.0, 0.5))
        assert 0.0 < fine < coarse / 10


def test_the_vertices_of_a_femur_lie_on_its_surface():
    outer = made(height=151.0, facet=5.0)
    assert np.abs(module._femur_distance(*outer.vertices.T)).max() < 1e-5


def test_a_femur_has_a_head_to_the_side_of_its_shaft():
    outer = made(height=151.0, facet=5.0)
    head = outer.vertices[np.linalg.norm(outer.vertices - [44.0, 8.0, 128.0], axis=1) < 23.01]
    assert len(head) > len(outer.vertices) / 10
    assert np.abs(outer.vertices[outer.vertices[:, 2] < 40.0][:, :2]).max() < 20.0


def test_a_side_that_the_shape_has_not_is_refused():
    with pytest.raises(ValidationError, match="width: is not for a femur, whose size is its height"):
        MakeShapeParams(shape="femur", width=10.0)
    with pytest.raises(ValidationError, match="depth: is not for a cylinder"):
        MakeShapeParams(shape="cylinder", depth=10.0)


@pytest.mark.parametrize("facet", [0.01, 40.0])
def test_facets_too_fine_or_too_coarse_are_refused_with_the_range(facet: float):
    with pytest.raises(ValidationError, match=r"facet: must be from 0\.2 to 3 mm for a femur of this size"):
        MakeShapeParams(facet=facet)


def test_a_shape_that_does_not_close_is_an_error(monkeypatch: pytest.MonkeyPatch):
    def open_box(size: tuple[float, float, float], facet: float):
        vertices, faces = box(size, facet)
        return vertices, faces[1:]

    box = module._box
    monkeypatch.setattr(module, "_box", open_box)
    with pytest.raises(StageError, match="does not close; choose a smaller `facet`"):
        made(shape="box", height=4.0)
