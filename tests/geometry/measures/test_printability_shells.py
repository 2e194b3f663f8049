"""Rules `enclosed_void` and `island_piece`, and all rules together."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.loose_shells import loose_shells
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_geometry.measures.printability.verdict import lint
from scaffold_pipeline.artifacts import SurfaceMesh
from scaffold_pipeline.errors import PipelineWarning, StageError

BOX = shapes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0))
RULES = PrintRules()


def test_one_shell_is_no_finding():
    voids, pieces = loose_shells(SurfaceMesh(*BOX), RULES)
    assert voids == ({"enclosed_voids": 0, "enclosed_void_mm3": 0.0}, None)
    assert pieces == ({"island_pieces": 0, "island_piece_mm3": 0.0}, None)


def test_closed_pores_are_found_largest_first_with_volume_and_place():
    small, large = shapes.box((0.5, 0.5, 0.5), (1.0, 1.0, 1.0)), shapes.box((2.0, 2.0, 2.0), (3.0, 3.0, 3.0))
    surface = shapes.together(BOX, shapes.inverted(small), shapes.inverted(large))
    (values, finding), pieces = loose_shells(SurfaceMesh(*surface), RULES)
    assert values == {"enclosed_voids": 2, "enclosed_void_mm3": pytest.approx(1.125)}
    assert finding.rule == "enclosed_void"
    assert finding.places == pytest.approx(np.array([(2.5, 2.5, 2.5), (0.75, 0.75, 0.75)]))
    assert "2 closed pores" in finding.message
    assert "the greatest of 1 mm^3 at (2.5, 2.5, 2.5)" in finding.message
    assert pieces.finding is None


def test_pieces_beside_the_greatest_are_found_wherever_they_come_in_the_file():
    surface = shapes.together(shapes.box((6.0, 0.0, 0.0), (7.0, 1.0, 2.0)), BOX, shapes.ball(0.1, (9.0, 9.0, 9.0)))
    voids, (values, finding) = loose_shells(SurfaceMesh(*surface), PrintRules(most_places=1))
    assert values["island_pieces"] == 2
    assert values["island_piece_mm3"] == pytest.approx(2.0 + 4.0 / 3.0 * np.pi * 1e-3, rel=1e-3)
    assert finding.rule == "island_piece"
    assert finding.places == pytest.approx(np.array([(6.5, 0.5, 1.0)]))
    assert voids.finding is None


def test_sound_box_breaks_no_rule():
    verdict = lint(SurfaceMesh(*BOX), PrintRules(min_wall=3.9))
    assert verdict.findings == ()
    assert verdict.values["thinnest_wall_mm"] == pytest.approx(4.0)


def test_solid_with_every_fault_breaks_every_rule():
    shelf = shapes.prism([(10.0, 1.0), (15.0, 1.0), (15.0, 1.1), (10.0, 1.1)], 2.0)
    hollow = shapes.together(BOX, shapes.inverted(shapes.box((0.5, 0.5, 0.1), (1.0, 1.0, 1.0))))
    verdict = lint(SurfaceMesh(*shapes.together(hollow, shelf)), PrintRules(min_wall=0.2))
    rules = [finding.rule for finding in verdict.findings]
    assert rules == ["thin_wall", "overhang", "unsupported_island", "enclosed_void", "island_piece"]
    assert all("; " in finding.message for finding in verdict.findings)


def test_verdict_is_the_same_each_time():
    surface = SurfaceMesh(*shapes.together(BOX, shapes.ball(1.0, (9.0, 9.0, 9.0))))
    one, other = lint(surface, RULES), lint(surface, RULES)
    assert one.values == other.values
    assert [finding.message for finding in one.findings] == [finding.message for finding in other.findings]


@pytest.mark.parametrize(
    ("surface", "volume"),
    [
        ((np.empty((0, 3)), np.empty((0, 3), np.int64)), "0 triangles of 0 mm"),
        ((np.zeros((3, 3)), np.array([(0, 1, 2)])), "1 triangles of 0 mm"),
        (shapes.inverted(BOX), "12 triangles of -64 mm"),
    ],
)
def test_what_encloses_nothing_is_refused(surface, volume):
    with pytest.raises(StageError, match=f"need a closed surface about a volume, got {volume}"):
        lint(SurfaceMesh(*surface), RULES)


def test_a_rule_that_is_gone_is_left_out_of_a_config_with_a_warning():
    gone = {"max_knife_edge": 1.0, "min_aspect": 1e-3, "max_triangles": None, "max_file_bytes": 10}
    for name, value in gone.items():
        with pytest.warns(PipelineWarning, match=f"{name} has no rule any more"):
            assert PrintRules.model_validate({name: value, "min_wall": 0.3}) == PrintRules(min_wall=0.3)


def test_the_angle_of_walls_is_taken_by_its_former_name_with_a_warning():
    with pytest.warns(PipelineWarning, match="knife_angle is called wall_angle now"):
        assert PrintRules.model_validate({"knife_angle": 15.0}) == PrintRules(wall_angle=15.0)
