"""Each defect, planted in a sound surface: refused as it is, mended or refused in a clear line, rebuilt."""

from __future__ import annotations

import os
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

import scaffold_geometry.surfaces.repair.modes as repair_module
from scaffold_geometry.surfaces import self_intersections, triangles
from scaffold_geometry.surfaces.repair import displacement, hole_triangulation, holes
from scaffold_geometry.surfaces.repair.log import TURNED, RepairLog
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError
from scaffold_stages.load_surface import LoadSurfaceParams, load_surface
from shapes import ball, box, inverted, require_closed, self_intersections_by_cgal, together, volume_of

RADIUS = 10.0
BALL = ball(RADIUS, divisions=4)
CUBE = box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0))
DATA = Path(__file__).parents[2].parent / "shared" / "data"


def loaded(folder: Path, surface: tuple[np.ndarray, np.ndarray], **given: object) -> OuterShape:
    """Load a surface by way of a file that holds its corners to the last digit."""
    vertices, faces = surface
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    path = folder / "planted.obj"
    path.write_text(text + "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist()))
    params = {"path": path, "units": "mm", "component": "all", **given}
    return load_surface(params=LoadSurfaceParams.model_validate(params))


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest):
    """Call here what runs in a child process: half a second each is most of what these tests would take."""
    if "in_children" in request.fixturenames:
        return

    def call(function, arrays, scalars, *, seconds, about):
        assert seconds > 0.0
        try:
            return function(**arrays, **scalars)
        except StageError as error:
            raise StageError(f"{error}; {about}") from error

    for module in (self_intersections, repair_module):
        monkeypatch.setattr(module, "call_in_child", call)


@pytest.fixture
def in_children():
    """Leave what runs in a child process there."""


def require_sound(outer: OuterShape):
    require_closed(outer.vertices, outer.faces)
    assert not self_intersections_by_cgal(outer.vertices, outer.faces)


def note_of(outer: OuterShape, start: str):
    return next(note for note in outer.notes if note.startswith(start))


def punctured(height: float):
    """The ball without its faces above a height."""
    vertices, faces = BALL
    return vertices, faces[vertices[faces].mean(axis=1)[:, 2] < height]


def with_flat_face():
    """The cube with a vertex amid an edge that one side has and the other has not, a flat triangle between them."""
    vertices, faces = CUBE
    edge = (faces[0, 0], faces[0, 1])
    new = len(vertices)
    cut = [(edge[0], new, faces[0, 2]), (new, edge[1], faces[0, 2]), (edge[0], edge[1], new)]
    return np.vstack([vertices, vertices[list(edge)].mean(axis=0)]), np.vstack([faces[1:], cut])


def with_crack():
    """The same without the flat triangle: a finer side meets a coarser one."""
    vertices, faces = with_flat_face()
    return vertices, faces[:-1]


def with_fin():
    vertices, faces = CUBE
    return np.vstack([vertices, [[2.0, -0.03, -0.03]]]), np.vstack([faces, [faces[0, 0], faces[0, 1], 8]])


def with_wall():
    """Two boxes glued at a face that is still there, once."""
    vertices, faces = together(CUBE, box((4.0, 0.0, 0.0), (8.0, 4.0, 4.0)))
    vertices, faces = triangles.merge_coincident(vertices, faces)
    return vertices, faces[~triangles.duplicate_faces(faces)]


def with_double_wall():
    return triangles.merge_coincident(*together(CUBE, box((4.0, 0.0, 0.0), (8.0, 4.0, 4.0))))


def with_stray_beside_a_hole():
    """The ball with a hole and one triangle between the hole's rim and an edge beside it, which then has three."""
    vertices, faces = BALL
    a, b = faces[0, :2]
    beside = faces[1:][np.isin(faces[1:], [a]).any(axis=1)]
    across = next(x for x in np.unique(beside) if x not in (a, b) and not np.isin(faces, [b, x]).sum(axis=1).max() > 1)
    return vertices, np.vstack([faces[1:], [a, b, across]])


def with_loose_corners():
    """The ball as separate triangles, whose corners differ by a rounding."""
    vertices, faces = BALL
    corners = vertices[faces].reshape(-1, 3)
    return corners * (1.0 + 1e-7 * np.random.default_rng(1).uniform(-1.0, 1.0, corners.shape)), np.arange(
        len(corners)
    ).reshape(-1, 3)


def touching_at_an_edge():
    return together(CUBE, box((4.0, 4.0, 0.0), (8.0, 8.0, 4.0)))


def touching_at_a_corner():
    return together(CUBE, box((4.0, 4.0, 4.0), (8.0, 8.0, 8.0)))


def folded_through():
    """The cube with a corner pulled out through the side opposite."""
    vertices = CUBE[0].copy()
    vertices[7] = (-2.0, 1.0, 2.0)
    return vertices, CUBE[1]


def shreds():
    """The ball as separate triangles, each shrunk by a twentieth."""
    vertices, faces = BALL
    corners = vertices[faces]
    corners += 0.05 * (corners.mean(axis=1, keepdims=True) - corners)
    return corners.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def with_turned_faces():
    vertices, faces = BALL
    faces = faces.copy()
    faces[::5] = faces[::5, ::-1]
    return vertices, faces


def sheet():
    return np.array([(x, y, 0.1 * x * y) for x, y in product((0.0, 4.0), repeat=2)]), np.array([(0, 2, 1), (1, 2, 3)])


MENDED = {
    "a small hole": ((BALL[0], BALL[1][1:]), "is open", "filled 1 holes with 1 triangles", volume_of(BALL)),
    "a flat triangle between three places": (with_flat_face(), "is open", "collapsed 1 triangles without area", 64.0),
    "a crack beside a vertex on an edge": (with_crack(), "is open", "split 1 triangles at vertices on", 64.0),
    "corners apart by a rounding": (with_loose_corners(), "is open", "merged", volume_of(BALL)),
    "a fin at an edge": (with_fin(), "1 edges have more than two", "dropped 1 triangles of fins", 64.0),
    "a stray triangle beside a hole": (
        with_stray_beside_a_hole(),
        "is open",
        "dropped 1 triangles of fins",
        volume_of(BALL),
    ),
    "a wall inside": (with_wall(), "4 edges have more than two", "dropped 2 triangles of internal walls", 128.0),
    "a wall there both ways": (with_double_wall(), "4 edges have more", "dropped 4 triangles of walls present", 128.0),
    "two bodies at one edge": (touching_at_an_edge(), "1 edges have more than two", "split 1 edges", 128.0),
    "two bodies at one corner": (touching_at_a_corner(), "touches itself at 1 vertices", "split 1 vertices", 128.0),
}


@pytest.mark.parametrize("defect", MENDED)
def test_a_local_defect_is_refused_and_mended_and_rebuilt(defect: str, tmp_path: Path):
    surface, refused, said, volume = MENDED[defect]
    with pytest.raises(StageError, match=rf"{refused}.*; set `repair: safe` or `repair: rebuild`"):
        loaded(tmp_path, surface, repair="none")
    mended = loaded(tmp_path, surface)
    require_sound(mended)
    assert any(said in note for note in mended.notes), mended.notes
    assert mended.volume == pytest.approx(volume, rel=2e-2)
    rebuilt = loaded(tmp_path, surface, repair="rebuild")
    require_sound(rebuilt)
    assert rebuilt.volume == pytest.approx(volume, rel=2e-2)


HARMLESS = {
    "faces there twice": ((BALL[0], np.vstack([BALL[1], BALL[1][:3]])), "dropped 3 duplicate triangles"),
    "faces there both ways": ((BALL[0], np.vstack([BALL[1], BALL[1][:, ::-1]])), "dropped 2048 duplicate triangles"),
    "turned faces": (with_turned_faces(), "reoriented 410 triangles to agree with their neighbours"),
    "a surface inside out": (inverted(BALL), "reoriented 1 pieces that faced"),
}


@pytest.mark.parametrize("repair", ["safe", "rebuild"])
@pytest.mark.parametrize("defect", HARMLESS)
def test_what_needs_no_place_to_move_is_put_right(defect: str, repair: str, tmp_path: Path):
    surface, said = HARMLESS[defect]
    outer = loaded(tmp_path, surface, repair=repair)
    require_sound(outer)
    assert any(said in note for note in outer.notes), outer.notes
    assert outer.volume == pytest.approx(volume_of(BALL), rel=1e-9)
    assert f"repair {repair}: no part of the surface moved" in outer.notes


CROSSING = {
    "a body folded through itself": (folded_through(), "intersects itself", None),
    "two bodies that overlap": (together(CUBE, box((2.0, 2.0, 2.0), (6.0, 6.0, 6.0))), "intersects itself", 120.0),
    "a body inside a body": (together(BALL, ball(2.0, divisions=2)), "with the same orientation", volume_of(BALL)),
}


@pytest.mark.parametrize("defect", CROSSING)
def test_what_crosses_itself_is_only_rebuilt(defect: str, tmp_path: Path):
    surface, refused, volume = CROSSING[defect]
    for repair in ("none", "safe"):
        with pytest.raises(StageError, match=rf"{refused}.*`repair: rebuild`"):
            loaded(tmp_path, surface, repair=repair)
    rebuilt = loaded(tmp_path, surface, repair="rebuild", tolerance=5.0)
    require_sound(rebuilt)
    if volume:
        assert rebuilt.volume == pytest.approx(volume, rel=1e-4)


def test_overlapping_bodies_keep_their_edges_and_corners(tmp_path: Path):
    outer = loaded(tmp_path, together(CUBE, box((2.0, 2.0, 2.0), (6.0, 6.0, 6.0))), repair="rebuild")
    corners = {tuple(np.round(vertex, 4)) for vertex in outer.vertices.tolist()}
    assert set(product((0.0, 4.0), repeat=3)) - corners == {(4.0, 4.0, 4.0)}
    assert (2.0, 2.0, 4.0) in corners
    assert "inside the solid removed" in note_of(outer, "repair rebuild: the original is at most")


def test_a_wide_hole_is_filled_only_within_the_tolerance(tmp_path: Path):
    for repair in ("safe", "rebuild"):
        with pytest.raises(StageError, match=r"moves the surface by [\d.]+ mm \(a filled hole.*tolerance of 0\.3") as e:
            loaded(tmp_path, punctured(8.5), repair=repair)
        allowed = float(str(e.value).partition("set `tolerance: ")[2].partition("`")[0])
        outer = loaded(tmp_path, punctured(8.5), repair=repair, tolerance=allowed)
        require_sound(outer)
        # the patch goes on from the ball with its slope, and so comes near to the cap that was there
        assert outer.volume == pytest.approx(volume_of(BALL), rel=2e-3)


def test_several_holes_that_share_a_vertex_are_filled_each_for_itself(tmp_path: Path):
    vertices, faces = BALL
    around = np.flatnonzero((faces == 0).any(axis=1))
    opposite = next(at for at in around if len(np.intersect1d(faces[at], faces[around[0]])) == 1)
    outer = loaded(tmp_path, (vertices, np.delete(faces, [around[0], opposite], axis=0)))
    require_sound(outer)
    assert any("filled 2 holes" in note for note in outer.notes), outer.notes


def test_shreds_are_rebuilt_on_a_grid(tmp_path: Path):
    for repair in ("none", "safe"):
        with pytest.raises(StageError, match="`repair: rebuild`"):
            loaded(tmp_path, shreds(), repair=repair)
    outer = loaded(tmp_path, shreds(), repair="rebuild", tolerance=0.8)
    require_sound(outer)
    assert "rebuilt from its winding number on a grid" in note_of(outer, "rebuilt")
    assert outer.volume == pytest.approx(volume_of(BALL), rel=1e-2)
    assert np.linalg.norm(outer.vertices, axis=1) == pytest.approx(RADIUS, rel=2e-2)


@pytest.mark.parametrize("repair", ["none", "safe", "rebuild"])
def test_an_open_sheet_is_refused(repair: str, tmp_path: Path):
    with pytest.raises(StageError, match=r"planted\.obj.*(is open|cannot be rebuilt)"):
        loaded(tmp_path, sheet(), repair=repair)


@pytest.mark.parametrize("repair", ["none", "safe", "rebuild"])
def test_a_surface_of_one_side_is_refused(repair: str, tmp_path: Path):
    angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    sides = np.stack([np.cos(angles / 2.0), np.sin(angles / 2.0)], axis=1)
    rings = [
        ((10.0 + s * c) * np.cos(a), (10.0 + s * c) * np.sin(a), s * d)
        for a, (c, d) in zip(angles, sides, strict=True)
        for s in (-2.0, 2.0)
    ]
    quads = [(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3) for k in range(39)] + [(78, 79, 1, 0)]
    faces = np.array([triangle for a, b, c, d in quads for triangle in ((a, c, b), (b, c, d))])
    with pytest.raises(StageError, match=r"planted\.obj"):
        loaded(tmp_path, (np.array(rings), faces), repair=repair)


def test_a_part_that_a_repair_leaves_out_counts_as_moved(tmp_path: Path):
    vertices, faces = with_fin()
    vertices[8] = (2.0, -3.0, -3.0)
    with pytest.raises(StageError, match=r"moves the surface by 4\.\d+ mm \(a part that was removed at 2, -3, -3 mm\)"):
        loaded(tmp_path, (vertices, faces))
    assert loaded(tmp_path, (vertices, faces), tolerance=4.5).volume == pytest.approx(64.0)


def test_numbers_of_a_repair_are_noted(tmp_path: Path):
    outer = loaded(tmp_path, (BALL[0], BALL[1][1:]))
    said = note_of(outer, "repair safe: the original is at most 0 mm")
    for part in ("the result at most 0.", "(tolerance 0.34", "volume 4", " to 4", "area 12", " to 12"):
        assert part in said


def test_numbers_of_a_repair_are_facts(tmp_path: Path):
    facts = loaded(tmp_path, (BALL[0], np.vstack([BALL[1][1:], BALL[1][5:8]]))).facts
    assert facts["repair_mode"] == "safe"
    assert (facts["repair_holes_filled"], facts["repair_duplicate_triangles_dropped"]) == (1, 3)
    assert 0.0 < facts["repair_distance_mm"] < facts["repair_tolerance_mm"]
    assert facts["repair_volume_after_mm3"] == pytest.approx(volume_of(BALL), rel=1e-3)
    areas = triangles.face_areas(*BALL)
    doubled = areas[5:8].sum()
    assert facts["repair_area_before_mm2"] == pytest.approx(areas[1:].sum() + doubled)
    assert facts["repair_area_after_mm2"] == pytest.approx(areas.sum(), rel=1e-3)


def test_what_is_done_in_two_steps_is_counted_together():
    one, other = RepairLog(), RepairLog()
    one.count(TURNED, 3)
    other.count(TURNED, 4)
    one.add(other)
    assert one.facts == {"triangles_turned": 7}
    assert [note.split()[1] for note in one.notes] == ["3", "4"]


@pytest.mark.parametrize("repair", ["none", "safe", "rebuild"])
def test_what_was_not_moved_has_facts_that_say_so(repair: str, tmp_path: Path):
    facts = loaded(tmp_path, BALL, repair=repair).facts
    assert facts["repair_mode"] == repair
    assert facts.get("repair_distance_mm") == (None if repair == "none" else 0.0)
    assert facts.get("repair_volume_before_mm3") == pytest.approx(facts.get("repair_volume_after_mm3"))


@pytest.mark.parametrize("repair", ["none", "safe"])
def test_a_sound_surface_stays_as_it_is(repair: str, tmp_path: Path):
    outer = loaded(tmp_path, BALL, repair=repair)
    np.testing.assert_array_equal(outer.vertices, BALL[0])
    np.testing.assert_array_equal(outer.faces, BALL[1])


@pytest.mark.parametrize(
    ("surface", "repair"),
    [(punctured(9.0), "safe"), (touching_at_an_edge(), "safe"), (folded_through(), "rebuild"), (shreds(), "rebuild")],
)
def test_a_repair_gives_the_same_bytes_each_time(surface: tuple[np.ndarray, np.ndarray], repair: str, tmp_path: Path):
    one, other = (loaded(tmp_path, surface, repair=repair, tolerance=5.0) for _ in range(2))
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()
    assert one.summary() == other.summary()


def test_holes_too_long_to_fill_are_refused_or_closed_by_the_winding_number(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setattr(holes, "LONGEST", 10)
    with pytest.raises(
        StageError, match=r"is open \(\d+ boundary edges\); set `repair: rebuild`.*left 1 holes of more"
    ):
        loaded(tmp_path, punctured(9.0))
    outer = loaded(tmp_path, punctured(9.0), repair="rebuild", tolerance=4.5)
    require_sound(outer)
    assert "edges stay open" in note_of(outer, "rebuilt from its winding number on a grid of")


def test_what_cannot_be_cut_in_time_is_rebuilt_on_a_grid(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    def give_up(**_arrays: np.ndarray):
        raise StageError("gave no result within 300 s")

    monkeypatch.setattr(repair_module.exact_union, "resolve_self_intersections", give_up)
    outer = loaded(tmp_path, BALL, repair="rebuild", tolerance=1.0)
    require_sound(outer)
    assert note_of(outer, "rebuilt from").endswith("as gave no result within 300 s")
    assert outer.volume == pytest.approx(volume_of(BALL), rel=5e-3)


@pytest.mark.usefixtures("in_children")
def test_a_failure_in_the_child_names_the_file_and_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(self_intersections, "find_self_intersections", os._exit)
    with pytest.raises(StageError, match=r"planted\.obj could not be searched.*set `repair: rebuild`"):
        loaded(tmp_path, CUBE)


def test_several_vertices_on_one_open_edge_are_all_met(tmp_path: Path):
    vertices, faces = CUBE
    start, end, opposite = (int(corner) for corner in faces[0])
    shares = np.array([0.2, 0.5, 0.7])[:, None]
    between = vertices[start] + shares * (vertices[end] - vertices[start])
    fan = [(one, other, opposite) for one, other in pairwise([start, 8, 9, 10, end])]
    outer = loaded(tmp_path, (np.vstack([vertices, between]), np.vstack([faces[1:], fan])))
    require_sound(outer)
    assert (len(outer.faces), outer.volume) == (18, pytest.approx(64.0))


def test_a_concave_hole_in_a_plane_is_spanned_without_folds():
    outline = np.array([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], float)
    rim = np.column_stack([outline, np.zeros(5)])
    upwards = np.tile([0.0, 0.0, 1.0], (5, 1))
    triangulation = hole_triangulation.triangulate_hole(rim, np.arange(5), upwards, np.empty((0, 3), np.int64))
    a, b, c = np.moveaxis(rim[triangulation], 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2.0
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(10.0)


def test_the_distance_found_is_that_by_which_a_surface_was_moved():
    vertices, faces = BALL
    moved = vertices.copy()
    top = int(np.argmax(vertices[:, 2]))
    moved[top, 2] += 0.7
    found = displacement.measure_displacement(BALL, (moved, faces), (moved, faces), 0.05)
    assert found.gained.distance == pytest.approx(0.7)
    assert found.gained.place == pytest.approx(moved[top])
    assert 0.0 < found.lost.distance < 0.7
    assert displacement.measure_displacement(BALL, BALL, BALL, 0.05).gained.distance == 0.0


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data is not beside this checkout")
@pytest.mark.parametrize(
    ("name", "units", "repair", "volume"),
    [
        ("pymskt_1_RIGHT_femur_Nov_02_2021.vtk", "mm", "safe", 185414),
        ("trimesh_featuretype.STL", "inch", "safe", 190544),
        ("trimesh_joined_tetrahedra.obj", "m", "safe", 0.866025e9),
        ("cgal_cow.off", "m", "rebuild", 0.0469552e9),
        ("vtkdata_greatWhite.stl", "cm", "rebuild", 141970),
    ],
)
@pytest.mark.usefixtures("in_children")
def test_real_dirty_files_come_out_sound(name: str, units: str, repair: str, volume: float):
    given = {"path": DATA / "dirty" / name, "units": units, "repair": repair}
    outer = load_surface(params=LoadSurfaceParams.model_validate(given))
    assert not any(triangles.edge_faults(outer.faces))
    assert outer.volume == pytest.approx(volume, rel=1e-4)
