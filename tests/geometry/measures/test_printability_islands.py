"""Rule `unsupported_island` on solids of which parts start in mid-air, or seem to."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.islands import islands
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_pipeline.artifacts import SurfaceMesh

TEE = shapes.fused(shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), shapes.box((-1.5, 0.0, 3.0), (3.0, 2.0, 4.0)))
HOOK = shapes.fused(TEE, shapes.box((2.0, 0.0, 1.0), (3.0, 2.0, 3.5)), shapes.box((-1.5, 0.0, 2.5), (-1.0, 2.0, 3.5)))
"""The tee with something that hangs from each arm, by 2 mm and by 0.5 mm."""


def islands_of(surface, **rules: object):
    return islands(SurfaceMesh(*surface), PrintRules(**rules))


def test_overhang_that_grows_from_the_side_is_no_island():
    assert islands_of(TEE) == ({"unsupported_islands": 0}, None)


def test_what_hangs_down_starts_in_mid_air():
    values, finding = islands_of(HOOK)
    assert values == {"unsupported_islands": 2}
    assert finding.rule == "unsupported_island"
    assert finding.places[:, 2] == pytest.approx([1.0, 2.5])
    assert ((finding.places[:, 0] > 1.9) == [True, False]).all()
    assert "for 2 mm; support them" in finding.message


def test_what_is_joined_within_a_layer_is_no_island():
    values, finding = islands_of(HOOK, layer=0.6)
    assert values == {"unsupported_islands": 1}
    assert finding.places[:, 2] == pytest.approx([1.0])


@pytest.mark.parametrize("degrees", [0.0, 17.0, 30.0])
def test_level_ground_is_one_island_however_it_is_rounded(degrees):
    up = (0.0, -np.sin(np.radians(degrees)), np.cos(np.radians(degrees)))
    plate = shapes.fused(HOOK, shapes.box((-1.5, 0.0, -0.5), (3.0, 2.0, 0.0)))
    turned = shapes.turned_about_x(plate, degrees)
    values, finding = islands_of(turned, build_direction=up)
    assert values == {"unsupported_islands": 2}
    assert finding.places @ up == pytest.approx([1.0, 2.5])
    box = shapes.turned_about_x(shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), degrees)
    assert islands_of(box, build_direction=up).finding is None


def test_solid_on_its_head_has_other_islands():
    assert islands_of(HOOK, build_direction=(0.0, 0.0, -1.0)).finding is None


def test_feet_on_the_plate_are_no_islands():
    table = shapes.fused(
        shapes.box((0.0, 0.0, 1.0), (4.0, 1.0, 2.0)),
        shapes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.5)),
        shapes.box((3.0, 0.0, 0.04), (4.0, 1.0, 1.5)),
    )
    assert islands_of(table).finding is None
    assert islands_of(table, layer=0.03).values == {"unsupported_islands": 1}


def test_ground_of_a_cup_or_of_a_closed_pore_is_no_island():
    cup = shapes.without(shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), shapes.ball(1.5, (2.0, 2.0, 3.0)))
    assert islands_of(cup).finding is None
    assert islands_of(shapes.together(shapes.ball(2.0), shapes.inverted(shapes.ball(1.0)))).finding is None


def test_drop_from_the_ceiling_of_a_closed_pore_is_an_island():
    pore = shapes.without(shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), shapes.box((1.0, 1.0, 1.0), (3.0, 3.0, 3.0)))
    dropped = shapes.fused(pore, shapes.box((1.5, 1.5, 2.0), (2.5, 2.5, 3.5)))
    values, finding = islands_of(dropped)
    assert values == {"unsupported_islands": 1}
    assert finding.places[0, 2] == pytest.approx(2.0)


def test_piece_in_mid_air_is_an_island_for_ever():
    _, finding = islands_of(shapes.together(shapes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), shapes.ball(1.0, (5, 5, 5))))
    assert finding.places == pytest.approx(np.array([(5.0, 5.0, 4.0)]))
    assert "for ever: it is a piece of its own" in finding.message


def test_vertices_of_no_face_are_no_islands():
    vertices, faces = shapes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert islands_of((np.concatenate([vertices, [(0.5, 0.5, 0.7)]]), faces)).finding is None


def test_islands_that_stand_free_for_longest_are_named_up_to_the_limit():
    values, finding = islands_of(HOOK, most_places=1)
    assert values == {"unsupported_islands": 2}
    assert finding.places[:, 2] == pytest.approx([1.0])
