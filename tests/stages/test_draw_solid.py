from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from scaffold_geometry.drawing.sections import nearest_values, sections, simplify_surface
from scaffold_pipeline.artifacts import Metrics, OuterShape, Solid
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.report.view import read_view
from scaffold_stages import draw_solid as stage
from scaffold_stages.draw_solid import DrawSolidParams, draw_solid
from shapes import Surface, ball, box, inverted, require_closed, together, volume_of

HOLLOW = together(box((0, 0, 0), (4, 6, 10)), inverted(box((1, 1, 1), (3, 5, 9))))
SOLID = Solid(*HOLLOW)
OUTER = OuterShape(*box((-1, -1, -1), (5, 7, 11)))


def rings(found: dict[str, np.ndarray], axis: str) -> list[np.ndarray]:
    return np.split(found[f"points_{axis}"], np.cumsum(found[f"sizes_{axis}"])[:-1])


def area(ring: np.ndarray) -> float:
    x, y = ring.T
    return float(np.abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0)


def drawn(folder: Path, axis: str, kind: str) -> np.ndarray:
    """Return all points of a path of a section as mm in the drawing, its corner the origin, y downward."""
    text = (folder / f"section_{axis}.svg").read_text(encoding="utf-8")
    step = float(re.search(r'width="([\d.]+)mm"', text)[1]) / float(re.search(r'viewBox="0 0 (\d+)', text)[1])
    path = re.search(rf'class="{kind}" d="([^"]*)"', text)[1]
    numbers = [np.fromstring(part.replace("l", " "), sep=" ") for part in re.findall(r"M([^z]*)z", path)]
    return np.concatenate([np.cumsum(ring.reshape(-1, 2), axis=0) for ring in numbers]) * step


# The kernels


def test_a_section_is_that_of_a_plane_in_the_axes_that_it_names():
    vertices, faces = HOLLOW
    found = sections(vertices, faces, x=2.0, y=3.0, z=0.5)
    assert [[area(ring) for ring in rings(found, axis)] for axis in "xyz"] == [
        *(pytest.approx([60.0, 32.0]), pytest.approx([40.0, 16.0])),
        pytest.approx([24.0]),
    ]
    assert found["points_x"].max(axis=0) == pytest.approx([6.0, 10.0])
    assert found["points_y"].max(axis=0) == pytest.approx([4.0, 10.0])
    assert found["points_z"].max(axis=0) == pytest.approx([4.0, 6.0])


@pytest.mark.parametrize("axis", "xyz")
def test_a_section_is_taken_at_its_place(axis: str):
    vertices, faces = ball(5.0, (1.0, 2.0, 3.0))
    places = {"x": 1.0, "y": 2.0, "z": 3.0}
    places[axis] += 4.0
    areas = {each: sum(map(area, rings(sections(vertices, faces, **places), each))) for each in "xyz"}
    assert {each: value for each, value in areas.items() if each != axis} == pytest.approx(
        {each: np.pi * 25.0 for each in "xyz" if each != axis}, rel=0.02
    )
    assert areas[axis] == pytest.approx(np.pi * 9.0, rel=0.03)


def test_a_plane_beside_the_surface_cuts_nothing():
    vertices, faces = box((0, 0, 0), (1, 1, 1))
    assert len(sections(vertices, faces, x=5.0, y=0.5, z=0.5)["points_x"]) == 0


def test_a_simplified_surface_is_closed_and_near_the_first():
    surface = ball(5.0, divisions=5)
    found = simplify_surface(*surface, triangles=1000)
    vertices, faces = found["vertices"].astype(float), found["faces"].astype(np.int64)
    require_closed(vertices, faces)
    assert 900 <= len(faces) <= 1000
    assert np.abs(np.linalg.norm(vertices, axis=1) - 5.0).max() < 0.1
    assert volume_of((vertices, faces)) == pytest.approx(volume_of(surface), rel=0.02)


def test_a_surface_of_few_triangles_is_left_alone():
    vertices, faces = box((0, 0, 0), (1, 2, 3))
    found = simplify_surface(vertices, faces, triangles=1000)
    assert (found["vertices"] == vertices).all()
    assert (found["faces"] == faces).all()


def test_a_value_is_that_of_the_nearest_vertex():
    points = np.array([[0.1, 0, 0], [0.9, 0, 0], [5.0, 0, 0]])
    values = nearest_values(points, np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([2.0, 3.0]))
    assert values.tolist() == [2.0, 3.0, 3.0]


# The stage


def view_of(surface: Surface, folder: Path, metrics: Metrics | None = None, triangles: int = 1000):
    facts = draw_solid(Solid(*surface), None, metrics, params=DrawSolidParams(triangles=triangles), out=folder).facts
    return facts, read_view((folder / "view.npz").read_bytes())


def test_the_view_is_one_that_the_page_reads_with_the_thickness_at_each_vertex(tmp_path: Path):
    surface = ball(5.0, divisions=5)
    thickness = surface[0][:, 2] + 6.0
    facts, view = view_of(surface, tmp_path, Metrics({}, strut_thickness=thickness))
    assert (view.triangles, len(view.faces)) == (len(surface[1]), facts["view_triangles"])
    assert len(view.faces) <= 1000
    assert facts["view_has_thickness"] is True
    assert np.abs(view.thickness - view.vertices[:, 2] - 6.0).max() < 0.5
    assert len(view.outer_faces) == 0


def test_a_thickness_of_other_vertices_is_left_out(tmp_path: Path):
    facts, view = view_of(HOLLOW, tmp_path, Metrics({}, strut_thickness=np.ones(3)))
    assert facts["view_has_thickness"] is False
    assert len(view.thickness) == 0


def test_all_is_written_again_to_the_byte(tmp_path: Path):
    written = []
    for name in "ab":
        (tmp_path / name).mkdir()
        draw_solid(SOLID, OUTER, params=DrawSolidParams(), out=tmp_path / name)
        written.append({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()})
    assert sorted(written[0]) == ["section_x.svg", "section_y.svg", "section_z.svg", "view.npz"]
    assert written[0] == written[1]


def test_a_drawing_has_the_solid_in_its_outer_shape_upright_and_in_mm(tmp_path: Path):
    facts = draw_solid(SOLID, OUTER, params=DrawSolidParams(sections=(0.5, 0.25, 0.5)), out=tmp_path).facts
    assert [facts[f"section_{axis}_at"] for axis in "xyz"] == [2.0, 1.5, 5.0]
    for axis, sizes in {"x": (6.0, 10.0), "y": (4.0, 10.0), "z": (4.0, 6.0)}.items():
        solid, outer = (drawn(tmp_path, axis, kind) for kind in ("solid", "outer"))
        assert np.ptp(solid, axis=0) == pytest.approx(sizes, abs=0.01)
        assert np.ptp(outer, axis=0) == pytest.approx(np.array(sizes) + 2.0, abs=0.01)
        assert (solid.min(axis=0) - outer.min(axis=0)) == pytest.approx([1.0, 1.0], abs=0.01)


def test_upward_in_a_drawing_is_up_in_the_solid(tmp_path: Path):
    pin_on_top = together(box((0, 0, 0), (8, 8, 2)), box((3, 3, 3), (5, 5, 9)))
    draw_solid(Solid(*pin_on_top), params=DrawSolidParams(), out=tmp_path)
    for axis in "xy":
        points = drawn(tmp_path, axis, "solid")
        upper, lower = (
            points[mask] for mask in (points[:, 1] < points[:, 1].mean(), points[:, 1] > points[:, 1].mean())
        )
        assert np.ptp(upper[:, 0]) < np.ptp(lower[:, 0])


@pytest.mark.parametrize("axis", "xyz")
def test_a_drawing_is_sound_xml_with_axes_place_and_scale(tmp_path: Path, axis: str):
    draw_solid(SOLID, OUTER, params=DrawSolidParams(), out=tmp_path)
    root = etree.fromstring((tmp_path / f"section_{axis}.svg").read_bytes())
    told = " ".join(element.text or "" for element in root.iter("{http://www.w3.org/2000/svg}text"))
    assert "2 mm" in told
    across, upward = {"x": "yz", "y": "xz", "z": "xy"}[axis]
    assert f"{across} \u2192\u2002{upward} \u2191\u2002{axis} = " in told


@pytest.mark.parametrize(
    ("failing", "left", "lost"),
    [(simplify_surface, "section_x.svg", "view.npz"), (sections, "view.npz", "section_x.svg")],
)
def test_what_cannot_be_drawn_is_a_warning_and_all_else_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: object, left: str, lost: str
):
    original = stage.call_in_child

    def die(function: object, *arguments: object, **others: object) -> object:
        if function is failing:
            raise StageError("was ended by SIGSEGV")
        return original(function, *arguments, **others)

    monkeypatch.setattr(stage, "call_in_child", die)
    with pytest.warns(PipelineWarning, match=r"no (view\.npz|section) was drawn: .*SIGSEGV"):
        facts = draw_solid(SOLID, OUTER, params=DrawSolidParams(), out=tmp_path).facts
    names = [path.name for path in tmp_path.iterdir()]
    assert left in names
    assert lost not in names
    assert any("SIGSEGV" in str(fact) for fact in facts.values())
