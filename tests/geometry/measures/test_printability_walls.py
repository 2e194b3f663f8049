"""Rule `thin_wall` on solids whose walls are known."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_geometry.measures.printability.thin_walls import thin_walls
from scaffold_geometry.measures.surface_tree import SurfaceTree
from scaffold_pipeline.artifacts import SurfaceMesh

PLATES = shapes.fused(
    shapes.box((0.0, 0.0, 0.0), (4.0, 3.0, 2.0)),
    shapes.box((4.0, 0.0, 1.0), (9.0, 3.0, 1.3)),
    shapes.box((-5.0, 0.0, 1.0), (0.0, 3.0, 1.5)),
)
"""A block that carries a plate of 0.3 mm on one side and one of 0.5 mm on the other."""


def walls_of(surface, **rules: object):
    mesh, asked = SurfaceMesh(*surface), PrintRules(**rules)
    return thin_walls(mesh, SurfaceTree(mesh.vertices, mesh.faces), asked)


def test_thinner_of_two_plates_is_found_at_its_place():
    values, finding = walls_of(PLATES, min_wall=0.4)
    assert values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)
    assert finding.rule == "thin_wall"
    x, y, z = finding.places.T
    assert ((x > 4.0) & (x < 9.0) & (y > 0.0) & (y < 3.0)).all()
    assert z == pytest.approx(1.15)
    assert finding.message.startswith("a wall is 0.3 mm thin at (")
    assert "0.4 mm asked for" in finding.message


def test_share_of_thin_walls_is_that_of_the_surface_over_them():
    values, _ = walls_of(PLATES, min_wall=0.4)
    mesh = SurfaceMesh(*PLATES)
    assert values["thin_wall_fraction"] == pytest.approx(2 * 5.0 * 3.0 / mesh.area, abs=3e-3)
    both, _ = walls_of(PLATES, min_wall=0.6)
    assert both["thin_wall_fraction"] == pytest.approx(4 * 5.0 * 3.0 / mesh.area, abs=3e-3)


def test_walls_as_thick_as_asked_for_are_no_finding():
    assert walls_of(PLATES, min_wall=0.3).finding is None
    assert walls_of(PLATES, min_wall=0.29).finding is None
    assert walls_of(PLATES).finding is None
    assert walls_of(PLATES).values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)


def test_one_place_stands_for_what_is_near_it():
    _, finding = walls_of(PLATES, min_wall=0.6, most_places=7)
    assert len(finding.places) == 7
    gaps = np.linalg.norm(finding.places[:, None] - finding.places, axis=2)[np.triu_indices(7, 1)]
    assert gaps.min() > np.linalg.norm([14.0, 3.0, 2.0]) / 50
    assert finding.places[0, 2] == pytest.approx(1.15)


def test_rims_of_a_box_are_no_thin_walls():
    values, finding = walls_of(shapes.box((0.0, 0.0, 0.0), (3.0, 2.0, 1.0)), min_wall=0.99)
    assert values["thinnest_wall_mm"] == pytest.approx(1.0, abs=1e-6)
    assert values["thin_wall_fraction"] == 0.0
    assert finding is None


def test_a_gap_between_walls_is_no_wall():
    slotted = shapes.without(
        shapes.box((0.0, 0.0, 0.0), (3.0, 2.0, 2.0)), shapes.box((1.4, -1.0, 0.6), (1.45, 3.0, 3.0))
    )
    assert walls_of(slotted).values["thinnest_wall_mm"] == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize("divisions", [3, 5])
def test_wall_of_a_hollow_ball_is_found_whatever_its_facets(divisions):
    outer, inner = shapes.ball(2.0, divisions=divisions), shapes.ball(1.7, divisions=divisions)
    values, finding = walls_of(shapes.together(outer, shapes.inverted(inner)), min_wall=0.4)
    assert values["thinnest_wall_mm"] == pytest.approx(0.3, rel=0.04)
    assert np.linalg.norm(finding.places, axis=1) == pytest.approx(1.85, rel=0.02)


def test_ball_of_facets_is_as_thick_as_it_is_wide():
    values, _ = walls_of(shapes.ball(1.0, divisions=3))
    assert values["thinnest_wall_mm"] == pytest.approx(2.0, rel=0.03)
    assert values["wall_percentile_5_mm"] == pytest.approx(2.0, rel=0.03)


def test_a_spot_too_small_for_the_first_samples_is_found_by_looking_closer():
    """A dimple leaves 0.2 mm of a plate of 1 mm, under its very tip."""
    dimple = shapes.ball(0.8, (13.0, 7.0, 1.0), divisions=4)
    values, _ = walls_of(shapes.without(shapes.box((0.0, 0.0, 0.0), (40.0, 40.0, 1.0)), dimple))
    assert values["thinnest_wall_mm"] == pytest.approx(0.2, abs=2e-3)
    x, y, _ = (float(part) for part in values["thinnest_wall_at"].split(","))
    assert np.hypot(x - 13.0, y - 7.0) < 0.1


@pytest.mark.parametrize("degrees", [6.0, 10.0, 19.0])
def test_a_wedge_is_no_thin_wall(degrees):
    wedge = shapes.prism([(0.0, 0.0), (5.0, 0.0), (5.0, 5.0 * np.tan(np.radians(degrees)))], 2.0)
    assert walls_of(wedge, min_wall=0.05).finding is None


@pytest.mark.parametrize("end", [0.02, 0.1])
def test_the_end_of_a_wedge_is_no_thin_wall_where_it_is_blunt(end: float):
    """A wedge of 10 degrees whose rim is cut off."""
    slope = np.tan(np.radians(10.0))
    wedge = shapes.prism([(end / slope, 0.0), (5.0, 0.0), (5.0, 5.0 * slope), (end / slope, end)], 2.0)
    assert walls_of(wedge).values["thinnest_wall_mm"] > 2.0 * end


def test_a_fin_is_a_wall_though_it_ends_and_stands_on_a_block():
    """0.3 mm thick and 1.2 mm high: close to its end on one side, and to the block on the other."""
    block = shapes.fused(shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 2.0)), shapes.box((2.0, 0.0, 1.9), (2.3, 4.0, 3.2)))
    assert walls_of(block).values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)


def test_a_bar_that_is_round_on_one_side_is_as_thick_as_at_its_middle():
    """What the cut through a round strut leaves: 0.1 mm thick in the middle, nothing at both rims."""
    profile = [(x, 0.1 * (1.0 - (x / 0.3) ** 2)) for x in np.linspace(0.3, -0.3, 61)]
    assert walls_of(shapes.prism(profile, 3.0)).values["thinnest_wall_mm"] == pytest.approx(0.1, rel=0.2)


def test_a_plate_with_a_sharp_bevel_keeps_its_wall():
    plate = shapes.prism([(0.0, 0.0), (6.0, 0.0), (5.0, 0.3), (0.0, 0.3)], 3.0)
    values, finding = walls_of(plate, min_wall=0.31)
    assert values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)
    assert finding.places[:, 2] == pytest.approx(0.15)


def test_walls_are_the_same_each_time():
    one, other = walls_of(PLATES, min_wall=0.6), walls_of(PLATES, min_wall=0.6)
    assert one.values == other.values
    assert np.array_equal(one.finding.places, other.finding.places)


def test_place_far_from_the_origin_costs_no_wall():
    far = PLATES[0] + np.array([5000.0, -3000.0, 2000.0]), PLATES[1]
    assert walls_of(far).values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)


def test_thin_ground_near_a_sharp_rim_is_a_wall_if_its_sides_do_not_open_towards_it():
    """A groove that leaves 0.2 mm of a plate, 1.5 mm from a rim of 27 degrees."""
    plate = shapes.prism([(0.0, 0.0), (6.0, 0.0), (5.0, 0.5), (0.0, 0.5)], 3.0)
    grooved = shapes.without(plate, shapes.box((4.3, -1.0, 0.2), (4.7, 4.0, 1.0)))
    assert walls_of(grooved).values["thinnest_wall_mm"] == pytest.approx(0.2, abs=1e-6)


def test_crumb_smaller_than_the_printer_can_show_is_no_wall():
    crumb = shapes.box((1.0, 1.0, 3.9), (1.1, 1.4, 4.4))
    solid = shapes.fused(shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), crumb)
    assert walls_of(solid, layer=0.05).values["thinnest_wall_mm"] == pytest.approx(0.1, abs=1e-6)
    assert walls_of(solid, layer=0.5).values["thinnest_wall_mm"] == pytest.approx(4.0, abs=1e-6)


def test_rod_is_a_wall_as_thick_as_it_is():
    rod = shapes.box((0.0, 0.0, 0.0), (0.3, 0.3, 5.0))
    values, finding = walls_of(shapes.fused(shapes.box((-1.0, -1.0, -1.0), (1.0, 1.0, 0.5)), rod), min_wall=0.4)
    assert values["thinnest_wall_mm"] == pytest.approx(0.3, abs=1e-6)
    assert (finding.places[:, 2] > 0.5).all()


def test_solid_without_walls_says_so():
    """A tetrahedron has no two faces that open at less than 70 degrees."""
    tetrahedron = np.array([(1.0, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
    faces = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    assert shapes.volume_of((tetrahedron, faces)) > 0.0
    values, finding = walls_of((tetrahedron, faces), min_wall=9.0)
    assert values["thinnest_wall_mm"] is None
    assert finding is None
