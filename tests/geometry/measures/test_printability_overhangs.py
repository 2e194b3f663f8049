"""Rule `overhang` on solids whose overhangs are known."""

import numpy as np
import pytest
from pydantic import ValidationError

import shapes
from scaffold_geometry.measures.printability.overhangs import overhangs
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_pipeline.artifacts import SurfaceMesh

BOX = shapes.box((0.0, 0.0, 0.0), (2.0, 3.0, 1.0))
TEE = shapes.fused(
    shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),
    shapes.box((-1.5, 0.0, 3.0), (3.0, 2.0, 4.0)),
)
"""A stem with an arm of 1.5 mm on one side and one of 2 mm on the other, 2 mm wide."""
ARCH = shapes.without(shapes.box((0.0, 0.0, 0.0), (4.0, 5.0, 2.0)), shapes.box((1.0, -1.0, -1.0), (3.0, 6.0, 1.5)))
"""A ceiling of 2 by 5 mm between two walls."""
DOWN = (0.0, 0.0, -1.0)


def overhangs_of(surface, **rules: object):
    return overhangs(SurfaceMesh(*surface), PrintRules(**rules))


def test_box_on_its_face_has_no_overhang():
    values, finding = overhangs_of(BOX)
    assert values == {
        "overhang_area_mm2": 0.0,
        "overhang_fraction": 0.0,
        "overhang_regions": 0,
        "overhang_largest_mm2": 0.0,
    }
    assert finding is None


def test_arms_of_a_tee_hang_over():
    values, finding = overhangs_of(TEE)
    assert values["overhang_area_mm2"] == pytest.approx(7.0)
    assert values["overhang_fraction"] == pytest.approx(7.0 / SurfaceMesh(*TEE).area)
    assert values["overhang_regions"] == 2
    assert values["overhang_largest_mm2"] == pytest.approx(4.0)
    assert finding.rule == "overhang"
    assert "the largest of 4 mm^2" in finding.message
    assert np.array(finding.places[:, [0, 2]]) == pytest.approx(np.array([(2.0, 3.0), (-0.75, 3.0)]))


def test_tee_on_its_head_has_no_overhang():
    assert overhangs_of(TEE, build_direction=DOWN).finding is None


def test_length_of_the_build_direction_does_not_matter():
    assert overhangs_of(TEE, build_direction=(0.0, 0.0, 9.0)).values == overhangs_of(TEE).values


@pytest.mark.parametrize("degrees", [17.0, 30.0, 61.0])
def test_solid_turned_with_the_build_direction_is_judged_the_same(degrees):
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    turned = overhangs_of(shapes.turned_about_x(TEE, degrees), build_direction=(0.0, -s, c))
    assert turned.values == pytest.approx(overhangs_of(TEE).values)
    assert overhangs_of(shapes.turned_about_x(BOX, degrees), build_direction=(0.0, -s, c)).finding is None


def test_box_on_its_edge_hangs_over_where_it_is_flatter_than_the_angle():
    tilted = shapes.turned_about_x(BOX, 30.0)
    values, _ = overhangs_of(tilted)
    assert values["overhang_area_mm2"] == pytest.approx(2.0 * 3.0)
    assert overhangs_of(tilted, overhang_angle=29.0).finding is None


def test_sides_as_steep_as_the_angle_need_no_support():
    tilted = shapes.turned_about_x(BOX, 45.0)
    for shift in np.random.default_rng(0).uniform(-90.0, 90.0, (5, 3)):
        assert overhangs_of(((tilted[0] + shift).astype(np.float32), tilted[1])).finding is None
    assert overhangs_of(tilted, overhang_angle=45.5).finding is not None


@pytest.mark.parametrize(("height", "hangs"), [(1.0, True), (3.0, False)])
def test_cone_on_its_tip_hangs_over_if_it_is_flat(height, hangs):
    values, _ = overhangs_of(shapes.cone(2.0, height, 256))
    area = np.pi * 2.0 * np.hypot(2.0, height) if hangs else 0.0
    assert values["overhang_area_mm2"] == pytest.approx(area, rel=1e-3)


@pytest.mark.parametrize("angle", [30.0, 45.0, 60.0])
def test_overhang_of_a_ball_is_its_cap_less_what_lies_on_the_plate(angle):
    radius, layer = 3.0, 0.2
    values, _ = overhangs_of(shapes.ball(radius, divisions=6), overhang_angle=angle, layer=layer)
    cap = 2.0 * np.pi * radius**2 * (1.0 - np.cos(np.radians(angle)))
    assert values["overhang_area_mm2"] == pytest.approx(cap - 2.0 * np.pi * radius * layer, abs=0.4)
    assert values["overhang_regions"] == 1


def test_overhangs_no_larger_than_allowed_are_measured_only():
    assert overhangs_of(TEE, max_overhang_area=7.01).finding is None
    assert overhangs_of(TEE, max_overhang_area=None).finding is None
    assert overhangs_of(TEE, max_overhang_area=6.9).finding is not None


def test_largest_overhangs_are_named_up_to_the_limit():
    _, finding = overhangs_of(TEE, most_places=1)
    assert finding.places.shape == (1, 3)
    assert finding.places[0, 0] == pytest.approx(2.0)


def test_ceiling_of_an_arch_is_a_bridge_of_twice_its_span():
    assert overhangs_of(ARCH).values["overhang_area_mm2"] == pytest.approx(10.0)
    assert overhangs_of(ARCH, bridge=3.9).values["overhang_regions"] == 1
    assert overhangs_of(ARCH, bridge=4.1).finding is None


def test_ceiling_held_all_around_is_a_bridge_of_its_width():
    room = shapes.without(shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), shapes.box((1.0, 1.0, -1.0), (3.0, 3.0, 3.0)))
    assert overhangs_of(room, bridge=1.9).values["overhang_area_mm2"] == pytest.approx(4.0)
    assert overhangs_of(room, bridge=2.1).finding is None


def test_arm_held_at_one_end_is_a_bridge_of_four_times_its_reach():
    assert overhangs_of(TEE, bridge=5.9).values["overhang_regions"] == 2
    assert overhangs_of(TEE, bridge=7.9).values["overhang_regions"] == 1
    assert overhangs_of(TEE, bridge=8.1).finding is None


def test_what_nothing_holds_is_no_bridge():
    floating = shapes.together(BOX, shapes.box((0.0, 0.0, 2.0), (0.1, 0.1, 3.0)))
    assert overhangs_of(floating, bridge=100.0).values["overhang_area_mm2"] == pytest.approx(0.01)


def test_a_build_direction_of_no_length_is_refused():
    with pytest.raises(ValidationError, match=r"build_direction\n.*must not be zero, got"):
        PrintRules(build_direction=(0.0, 0.0, 0.0))
