"""Rules `enclosed_void`, `island_piece`, `sliver` and `size`, and all rules together."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.file_size import file_size
from scaffold_geometry.measures.printability.loose_shells import loose_shells
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_geometry.measures.printability.slivers import slivers
from scaffold_geometry.measures.printability.verdict import lint
from scaffold_pipeline.artifacts import SurfaceMesh
from scaffold_pipeline.errors import StageError

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


def test_box_has_no_slivers():
    assert slivers(SurfaceMesh(*BOX), RULES) == ({"sliver_triangles": 0}, None)


def _with_vertex_on_an_edge(at):
    """Return the box, an edge of it cut in two and the vertex there moved by `at` mm out of the face beside it."""
    vertices, faces = BOX
    middle = len(vertices)
    cut = [
        part
        for face in faces.tolist()
        for part in (
            [[middle if v == 0 else v for v in face], [middle if v == 1 else v for v in face]]
            if {0, 1} <= set(face)
            else [face]
        )
    ]
    moved = vertices[[0, 1]].mean(axis=0) + np.array([at, 0.0, 0.0])
    return np.concatenate([vertices, [moved]]), np.array(cut)


def test_cut_edge_alone_makes_no_sliver():
    assert slivers(SurfaceMesh(*_with_vertex_on_an_edge(0.0)), RULES).finding is None


def test_needle_is_a_sliver_at_its_place():
    vertices, faces = shapes.prism([(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2e-4), (0.0, 1e-4)], 3.0)
    values, finding = slivers(SurfaceMesh(vertices, faces), RULES)
    assert values["sliver_triangles"] > 0
    assert finding.rule == "sliver"
    assert (finding.places[:, 2] < 0.1).all()
    assert slivers(SurfaceMesh(vertices, faces), PrintRules(min_aspect=1e-6)).finding is None


def test_triangle_that_single_precision_makes_flat_is_a_sliver():
    vertices, faces = shapes.box((1000.0, 0.0, 0.0), (1000.0 + 1e-5, 1.0, 1.0))
    values, finding = slivers(SurfaceMesh(vertices, faces), PrintRules(min_aspect=0.0))
    assert values == {"sliver_triangles": 8}
    assert "8 of 12 triangles" in finding.message
    assert (finding.places[:, 0] == 1000.0).all()


def test_file_within_the_limits_is_no_finding():
    assert file_size(SurfaceMesh(*BOX), PrintRules(max_triangles=12, max_file_bytes=684)) == ({"stl_bytes": 684}, None)
    assert file_size(SurfaceMesh(*BOX), PrintRules(max_triangles=None, max_file_bytes=None)).finding is None


def test_file_beyond_a_limit_names_it():
    too_many = file_size(SurfaceMesh(*BOX), PrintRules(max_triangles=11)).finding
    assert too_many.rule == "size"
    assert too_many.message.startswith("12 triangles, at most 11 are taken; simplify")
    too_large = file_size(SurfaceMesh(*BOX), PrintRules(max_file_bytes=683)).finding
    assert too_large.message.startswith("a binary STL of 684 bytes, at most 683 are taken; simplify")


def test_sound_box_breaks_no_rule():
    verdict = lint(SurfaceMesh(*BOX), PrintRules(min_wall=3.9))
    assert verdict.findings == ()
    assert verdict.values["thinnest_wall_mm"] == pytest.approx(4.0)


def test_solid_with_every_fault_breaks_every_rule():
    wedge = shapes.prism([(10.0, 1.0), (15.0, 1.0), (15.0, 1.5)], 2.0)
    needle = shapes.box((20.0, 0.0, 0.0), (20.0 + 1e-6, 1.0, 1.0))
    hollow = shapes.together(BOX, shapes.inverted(shapes.box((0.5, 0.5, 0.1), (1.0, 1.0, 1.0))))
    verdict = lint(SurfaceMesh(*shapes.together(hollow, wedge, needle)), PrintRules(min_wall=0.2, max_triangles=9))
    rules = [finding.rule for finding in verdict.findings]
    assert rules == [
        *("thin_wall", "knife_edge", "overhang", "unsupported_island"),
        *("enclosed_void", "island_piece", "sliver", "size"),
    ]
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
