from __future__ import annotations

import re
from itertools import permutations, product
from pathlib import Path

import meshio
import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.arrays import Ints
from scaffold_geometry.files.solids.finite_elements import WRITERS, require_read_back
from scaffold_geometry.surfaces.booleans import from_manifold, to_manifold
from scaffold_geometry.volumes import tetrahedra as module
from scaffold_geometry.volumes.tetrahedra import default_edge, measure_quality
from scaffold_pipeline.artifacts import Solid, VolumeMesh
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_stages.mesh_solid import MeshSolidParams, mesh_solid

FILES = ("inp", "vtu")
RING = [place for place in product(range(3), range(3), range(1)) if place != (1, 1, 0)]
"""The cubes of a square plate with a square hole."""


def cubes_of_six(places: list[tuple[int, int, int]], edge: float = 2.0) -> VolumeMesh:
    """Return six tetrahedra to each cube, all about its diagonal, so that neighbours match."""
    cells = []
    for place in places:
        for order in permutations(range(3)):
            steps = np.eye(3, dtype=np.int64)[list(order)]
            path = np.array(place) + np.concatenate([[[0, 0, 0]], np.cumsum(steps, axis=0)])
            is_positive = np.linalg.det(steps.astype(float)) > 0.0
            cells.append(path if is_positive else path[[0, 2, 1, 3]])
    points, corners = np.unique(np.concatenate(cells), axis=0, return_inverse=True)
    return VolumeMesh(edge * points + 1.0 / 3.0, corners.reshape(-1, 4))


def boundary_of(mesh: VolumeMesh) -> Solid:
    """Return the faces that one cell has, outward."""
    faces = mesh.tetrahedra[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return Solid(mesh.vertices.astype(np.float32).astype(np.float64), faces[first[uses == 1]])


MESH = cubes_of_six(RING)
SOLID = boundary_of(MESH)


@pytest.fixture
def answer(monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """Stand in for fTetWild: what is in here is its answer, MESH at first, about the solid's centre."""
    given = {"vertices": MESH.vertices - SOLID.bounds.mean(axis=0), "cells": MESH.tetrahedra.copy()}
    monkeypatch.setattr(module, "call_in_child", lambda *_, **__: given)
    return given


def written(out: Path, solid: Solid = SOLID, **given: object):
    return mesh_solid(solid, params=MeshSolidParams.model_validate(given), out=out).summary()


def write_bad(out: Path, message: str, **given: object) -> None:
    with pytest.raises(StageError, match=message) as failure:
        written(out, **given)
    assert "\n" not in str(failure.value)
    assert "without mesh_solid in the config, the same command writes its files" in str(failure.value)


@pytest.mark.filterwarnings("ignore:mesh of the solid. .* cells have a dihedral angle below")
def test_ftetwild_fills_a_box_with_a_hole(tmp_path: Path):
    plate = to_manifold(SOLID.vertices, SOLID.faces, "plate").rotate((20.0, 30.0, 40.0))
    solid = Solid(*from_manifold(plate))

    facts = written(tmp_path, solid, edge_length=1.0, time_limit=120.0)

    assert facts["volume_difference"] == pytest.approx(0.0, abs=0.01)
    assert facts["cells"] > 100
    assert 0.0 < facts["least_scaled_jacobian"] <= 1.0
    assert 0.0 < facts["least_dihedral_angle"] < 70.6
    found = meshio.read(tmp_path / "solid_mesh.vtu")
    assert found.points.min(axis=0) == pytest.approx(solid.bounds[0], abs=0.11)
    assert found.points.max(axis=0) == pytest.approx(solid.bounds[1], abs=0.11)


@pytest.mark.parametrize("kind", FILES)
def test_others_read_the_mesh_to_the_bit(tmp_path: Path, answer: dict, kind: str):
    facts = written(tmp_path)

    found = meshio.read(tmp_path / f"solid_mesh.{kind}")
    assert [block.type for block in found.cells] == ["tetra"]
    assert np.array_equal(found.cells[0].data, MESH.tetrahedra)
    assert np.array_equal(found.points, answer["vertices"] + SOLID.bounds.mean(axis=0))
    assert facts["volume_mm3"] == pytest.approx(64.0)


@pytest.mark.usefixtures("answer")
def test_the_input_file_names_its_unit_and_counts_from_one(tmp_path: Path):
    written(tmp_path)

    lines = (tmp_path / "solid_mesh.inp").read_text(encoding="ascii").splitlines()
    keywords = [line for line in lines if line.startswith("*")]
    assert keywords == ["*HEADING", "*NODE, NSET=ALL", "*ELEMENT, TYPE=C3D4, ELSET=SOLID"]
    assert lines[1].endswith("unit: mm")
    nodes, elements = (lines[lines.index(keyword) + 1] for keyword in keywords[1:])
    assert nodes.startswith("1, ")
    assert re.fullmatch(r"1(, [1-9]\d*){4}", elements)


@pytest.mark.usefixtures("answer")
def test_files_of_one_mesh_are_the_same_each_time(tmp_path: Path):
    contents = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        written(folder)
        contents.append([(folder / f"solid_mesh.{kind}").read_bytes() for kind in FILES])

    assert contents[0] == contents[1]


@pytest.mark.usefixtures("answer")
def test_only_the_formats_asked_for_are_written(tmp_path: Path):
    written(tmp_path, formats=("inp",))

    assert [path.name for path in tmp_path.iterdir()] == ["solid_mesh.inp"]


def test_the_edge_is_half_the_thickness_of_a_rod_by_default():
    rod = boundary_of(cubes_of_six([(0, 0, height) for height in range(100)], edge=3.0))

    assert default_edge(rod) == pytest.approx(1.5, rel=0.01)


def test_a_mesher_that_takes_too_long_is_refused(tmp_path: Path):
    message = r"^gave no result within 0 s; mesh of the solid, \d+ triangles, edge_length 0.2 mm; raise edge_length or"

    write_bad(tmp_path, message, edge_length=0.2, time_limit=0.01)


def test_a_mesh_of_another_volume_is_refused(tmp_path: Path, answer: dict):
    answer["vertices"] *= 1.004

    write_bad(tmp_path, r"must keep its volume to 0\.01, but the cells fill 64\.77.* of 64 mm\^3; lower edge_length")


def test_a_mesh_that_falls_apart_is_refused(tmp_path: Path, answer: dict):
    halves = np.concatenate([answer["cells"][:24], answer["cells"][24:] + len(answer["vertices"])])
    used, answer["cells"] = drop_unused(halves)
    answer["vertices"] = np.tile(answer["vertices"], (2, 1))[used]

    write_bad(tmp_path, "number of pieces: must be 1 as in the solid, got 2; thin struts are lost: lower edge_length")


def test_cells_that_share_only_an_edge_are_pieces(tmp_path: Path, answer: dict):
    mesh = cubes_of_six([(0, 0, 0), (1, 1, 0)])
    answer["vertices"], answer["cells"] = mesh.vertices, mesh.tetrahedra

    write_bad(tmp_path, "number of pieces: must be 1 as in the solid, got 2")


def test_a_mesh_with_an_inverted_cell_is_refused(tmp_path: Path, answer: dict):
    answer["cells"][3] = answer["cells"][3, [1, 0, 2, 3]]

    write_bad(tmp_path, r"every cell must have a positive volume, but 1 of 48 do not")


def test_a_mesh_with_a_doubled_cell_is_refused(tmp_path: Path, answer: dict):
    answer["cells"] = np.concatenate([answer["cells"], answer["cells"][:1]])

    write_bad(tmp_path, "a face must have one cell on each side at most")


def test_a_mesh_with_a_handle_less_is_told(tmp_path: Path, answer: dict):
    filled = cubes_of_six([*RING, (1, 1, 0)])
    answer["cells"] = filled.tetrahedra
    thin = filled.vertices - SOLID.bounds.mean(axis=0)
    answer["vertices"] = thin * [1.0, 1.0, 8.0 / 9.0]

    with pytest.warns(
        PipelineWarning, match=r"Euler characteristic differs by \+1 from that of the solid: thin struts"
    ):
        facts = written(tmp_path)

    assert facts["euler_difference"] == 1


def test_a_mesh_with_a_handle_more_is_told(tmp_path: Path, answer: dict):
    solid = boundary_of(cubes_of_six([*RING, (1, 1, 0)]))
    answer["vertices"] *= [1.0, 1.0, 9.0 / 8.0]

    with pytest.warns(PipelineWarning, match=r"Euler characteristic differs by -1 from that of the solid: narrow gaps"):
        facts = written(tmp_path, solid)

    assert facts["distance_mm"] == pytest.approx(1.0 / 8.0, abs=1e-6)


@pytest.mark.usefixtures("answer")
def test_a_mesh_on_the_solid_itself_is_no_distance_off(tmp_path: Path):
    facts = written(tmp_path)

    assert facts["distance_mm"] < 1e-6
    assert facts["euler_difference"] == 0


def test_a_fine_surface_is_thinned_out_before_it_is_filled(monkeypatch: pytest.MonkeyPatch):
    cubes = boundary_of(cubes_of_six(list(product(range(12), repeat=3)), edge=0.5))
    monkeypatch.setattr(
        module, "run_ftetwild", lambda vertices, faces, *_: {"vertices": vertices, "cells": np.asarray(faces)}
    )

    made = module.simplify_and_fill(np.array(cubes.vertices), np.array(cubes.faces), 200.0, 3.0, 0.1)

    thinned = Solid(made["vertices"], made["cells"])
    assert len(thinned.faces) <= 200 < len(cubes.faces)
    assert thinned.volume == pytest.approx(cubes.volume, rel=1e-6)


def test_many_triangles_get_few_rounds(monkeypatch: pytest.MonkeyPatch):
    rounds = []
    monkeypatch.setattr(module, "run_ftetwild", lambda *given: rounds.append(given[4]))
    monkeypatch.setattr(module, "LARGE_SURFACE", len(SOLID.faces))

    for faces in (SOLID.faces, np.concatenate([SOLID.faces, SOLID.faces])):
        module.simplify_and_fill(SOLID.vertices, faces, np.inf, 1.0, 0.1)

    assert rounds == [module.ROUNDS, module.LARGE_SURFACE_ROUNDS]


def test_flat_cells_are_told_of(tmp_path: Path, answer: dict):
    answer["vertices"] = answer["vertices"] * [0.05, 1.0, 1.0]
    flat = Solid((SOLID.vertices - SOLID.bounds.mean(axis=0)) * [0.05, 1.0, 1.0], SOLID.faces)

    with pytest.warns(PipelineWarning, match=r"\d+ of 48 cells have a dihedral angle below 5 degrees, the least"):
        facts = written(tmp_path, flat)

    assert 0 < facts["flat_cells"] <= 48


def drop_unused(cells: Ints) -> tuple[Ints, Ints]:
    used, places = np.unique(cells, return_inverse=True)
    return used, places.reshape(cells.shape)


def dropped_cell(mesh: VolumeMesh) -> VolumeMesh:
    used, cells = drop_unused(mesh.tetrahedra[1:])
    return VolumeMesh(mesh.vertices[used], cells)


def turned_cell(mesh: VolumeMesh) -> VolumeMesh:
    return VolumeMesh(mesh.vertices, mesh.tetrahedra[:, [1, 2, 0, 3]])


def moved_point(mesh: VolumeMesh) -> VolumeMesh:
    vertices = mesh.vertices.copy()
    vertices[5, 1] = np.nextafter(vertices[5, 1], 9.0)
    return VolumeMesh(vertices, mesh.tetrahedra)


FAULTS = {
    dropped_cell: "must have the mesh's tetrahedra in their order",
    turned_cell: "must have the mesh's tetrahedra in their order",
    moved_point: "must have the mesh's coordinates to the bit, but 1 of 32 points differ",
}


@pytest.mark.usefixtures("answer")
@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_mesh_file_with_a_fault_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, fault):
    write = WRITERS[kind]
    monkeypatch.setitem(WRITERS, kind, lambda path, mesh: write(path, fault(mesh)))

    write_bad(tmp_path, rf"^solid_mesh\.{kind}: {FAULTS[fault]}")


@pytest.mark.parametrize("kind", FILES)
def test_a_mesh_file_that_is_cut_off_is_refused(tmp_path: Path, kind: str):
    path = tmp_path / f"cut.{kind}"
    WRITERS[kind](path, MESH)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])

    with pytest.raises(StageError):
        require_read_back(path, MESH)


def test_a_mesh_file_with_a_point_too_many_is_refused(tmp_path: Path):
    path = tmp_path / "more.inp"
    WRITERS["inp"](path, MESH)
    path.write_text(path.read_text().replace("*ELEMENT", "33, 0.0, 0.0, 0.0\n*ELEMENT"))

    with pytest.raises(StageError, match="must have 32 points, but 33 were read back"):
        require_read_back(path, MESH)


def test_the_quality_of_a_regular_tetrahedron_is_the_best():
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    mesh = VolumeMesh(
        corners, np.array([[0, 2, 1, 3]]) if np.linalg.det(corners[1:] - corners[0]) < 0 else [[0, 1, 2, 3]]
    )

    worst = measure_quality(mesh)

    assert worst.scaled_jacobian == pytest.approx(1.0)
    assert worst.flat_cells == 0
    assert worst.dihedral_angle == pytest.approx(np.degrees(np.arccos(1.0 / 3.0)))


def test_the_quality_of_a_corner_of_a_cube_is_known():
    corner = VolumeMesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), [[0, 1, 2, 3]])

    worst = measure_quality(corner)

    assert worst.scaled_jacobian == pytest.approx(np.sqrt(2.0) / 2.0)
    assert worst.dihedral_angle == pytest.approx(54.7356, abs=1e-3)


@pytest.mark.parametrize("parameters", [{"edge_length": 0.0}, {"time_limit": 0.0}, {"edge_length": -1.0}])
def test_sizes_that_are_not_positive_are_refused(parameters: dict[str, float]):
    with pytest.raises(ValidationError, match="greater than 0"):
        MeshSolidParams.model_validate(parameters)
