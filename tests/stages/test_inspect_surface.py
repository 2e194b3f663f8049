"""Inspection measures what is there and refuses no defect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import inspect_surface as module
from scaffold_stages.inspect_surface import InspectSurfaceParams, inspect_surface

DATA = Path(__file__).parents[2].parent / "shared" / "data"
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


def written(folder: Path, vertices: list[tuple[float, ...]], faces: list[tuple[int, ...]]):
    path = folder / "surface.obj"
    rows = [f"v {x} {y} {z}" for x, y, z in vertices] + ["f {} {} {}".format(*(np.array(f) + 1)) for f in faces]
    path.write_text("\n".join(rows) + "\n")
    return path


def inspected(path: Path, **given: object):
    return inspect_surface(params=InspectSurfaceParams.model_validate({"path": path, **given})).values


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("inspect_surface", inspect_surface)
    assert (declared.writes, declared.reads) == ("metrics", {})


def test_a_sound_body_is_measured(tmp_path: Path):
    found = inspected(written(tmp_path, CORNERS, FACES))
    assert found["is_manifold"]
    assert found["is_oriented"]
    assert found["manifold3d"] == "NoError"
    assert (found["pieces"], found["euler"], found["genus"], found["self_intersecting_faces"]) == (1, 2, 0, 0)
    assert (found["triangles"], found["vertices"], found["size_x"]) == (4, 4, 1.0)
    assert found["volume_mm3"] == pytest.approx(1 / 6)
    assert found["area_mm2"] == pytest.approx(1.5 + np.sqrt(3) / 2)
    assert found["unit"] == "not in the file, taken as mm"


def test_the_unit_given_scales_every_measure(tmp_path: Path):
    found = inspected(written(tmp_path, CORNERS, FACES), units="cm")
    assert found["unit"] == "cm (given)"
    assert (found["size_z"], found["volume_mm3"]) == (10.0, pytest.approx(1000 / 6))


def test_an_open_surface_has_no_volume_and_no_genus(tmp_path: Path):
    found = inspected(written(tmp_path, CORNERS, FACES[1:]))
    assert (found["boundary_edges"], found["is_manifold"], found["is_oriented"]) == (3, False, True)
    assert (found["volume_mm3"], found["genus"], found["manifold3d"]) == (None, None, "NotManifold")


def test_inverted_normals_show_as_a_negative_volume(tmp_path: Path):
    found = inspected(written(tmp_path, CORNERS, [face[::-1] for face in FACES]))
    assert found["volume_mm3"] == pytest.approx(-1 / 6)


def test_defects_are_counted(tmp_path: Path):
    wing = [(0, 1, 4), (0, 1, 4), (2, 2, 3), (0, 1, 5)]
    found = inspected(written(tmp_path, [*CORNERS, (0.5, -1, 0), (0.5, 0, 0)], FACES + wing))
    assert found["non_manifold_edges"] == 1
    assert found["degenerate_triangles"] == 2
    assert found["duplicate_triangles"] == 1


def test_a_surface_of_collapsed_triangles_only_is_measured(tmp_path: Path):
    found = inspected(written(tmp_path, CORNERS, [(0, 0, 1)]))
    assert (found["pieces"], found["is_manifold"], found["degenerate_triangles"]) == (0, False, 1)


def test_a_search_that_does_not_end_leaves_none_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "_SEARCH_SECONDS", 0.01)
    found = inspected(written(tmp_path, CORNERS, FACES))
    assert found["self_intersecting_faces"] is None
    assert "gave no result within" in found["self_intersecting_faces_note"]


def test_a_file_without_triangles_is_an_error(tmp_path: Path):
    path = tmp_path / "points.obj"
    path.write_text("v 0 0 0\n")
    with pytest.raises(StageError, match=r"points\.obj: has no triangles"):
        inspected(path)


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data is not beside this checkout")
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("anatomy/cgal_femur.off", {"is_manifold": True, "genus": 2, "self_intersecting_faces": 0}),
        ("dirty/trimesh_bunny.ply", {"boundary_edges": 123, "non_manifold_edges": 150, "duplicate_triangles": 87}),
        ("dirty/cgal_cow.off", {"self_intersecting_faces": 89, "touching_vertices": 1, "genus": None}),
        ("dirty/cgal_blobby-shuffled.off", {"misoriented_edges": 3069, "is_oriented": False}),
        ("peers/cinolib_bamboo_pen.obj", {"genus": 8, "manifold3d": "NoError"}),
    ],
)
def test_real_files_are_measured_as_others_measured_them(name: str, expected: dict[str, object]):
    found = inspected(DATA / name)
    assert {key: found[key] for key in expected} == expected
