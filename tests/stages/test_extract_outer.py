"""The boundary of a volume mesh is an outer shape: closed, outward, parted where it touches itself."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import manifold3d
import numpy as np
import pytest

from end_to_end.solid_judge import faults_of
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.repair import vertex_splitting
from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.cli.app import main
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.extract_outer import ExtractOuterParams, extract_outer
from scaffold_stages.jitter import JitterParams, jitter
from scaffold_stages.load_volume_mesh import LoadVolumeMeshParams, load_volume_mesh
from shapes import box, hexahedra, inverted, require_closed, self_intersections_by_cgal, tetrahedra, together

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data" / "volume"


def extracted(mesh: VolumeMesh, how: str = "part") -> OuterShape:
    return extract_outer(mesh, params=ExtractOuterParams.model_validate({"touching": how}))


def blocks_without(counts: tuple[int, int, int], holes: list[tuple[int, int, int]], edge: float = 2.0) -> VolumeMesh:
    """Return a box of cubes in the order of their places, without those of `holes`."""
    whole = hexahedra(counts, edge)
    places = list(product(*map(range, counts)))
    kept = whole.hexahedra[[place not in holes for place in places]]
    used, compact = np.unique(kept, return_inverse=True)
    return VolumeMesh(whole.vertices[used], hexahedra=compact.reshape(kept.shape).astype(np.int64))


def moved(mesh: VolumeMesh, by: tuple[float, float, float], scale: float = 1.0) -> VolumeMesh:
    return VolumeMesh(scale * mesh.vertices + np.array(by), hexahedra=mesh.hexahedra)


def both(one: VolumeMesh, other: VolumeMesh) -> VolumeMesh:
    cells = np.concatenate([one.hexahedra, other.hexahedra + len(one.vertices)])
    return VolumeMesh(np.concatenate([one.vertices, other.vertices]), hexahedra=cells)


def require_sound(outer: OuterShape):
    """Assert that a surface is closed and manifold, also as a file has it, to an independent library as well."""
    require_closed(outer.vertices, outer.faces)
    body = manifold3d.Manifold(manifold3d.Mesh64(np.array(outer.vertices), np.array(outer.faces, np.uint64)))
    assert body.status() == manifold3d.Error.NoError
    assert body.volume() == pytest.approx(outer.volume)
    assert not self_intersections_by_cgal(outer.vertices, outer.faces)


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("extract_outer", extract_outer)
    assert (declared.writes, list(declared.reads)) == ("outer", ["mesh"])


@pytest.mark.parametrize(
    "mesh", [tetrahedra((2, 3, 2), 2.0), hexahedra((2, 3, 2), 2.0)], ids=["tetrahedra", "hexahedra"]
)
def test_the_boundary_of_a_box_is_the_box(mesh: VolumeMesh):
    outer = extracted(mesh)
    require_sound(outer)
    assert outer.volume == pytest.approx(mesh.volume)
    assert outer.area == pytest.approx(2 * (24.0 + 16.0 + 24.0))
    assert len(outer.faces) == 2 * 2 * (6 + 4 + 6)
    assert len(outer.vertices) == len(mesh.vertices) - 2


def test_a_jittered_mesh_of_bent_quadrangles_stays_closed_and_says_so():
    mesh = jitter(
        hexahedra((3, 3, 3), 2.0),
        params=JitterParams(amount=0.3, boundary="free"),
        rng=np.random.default_rng(3),
    )
    outer = extracted(mesh)
    require_sound(outer)
    assert outer.volume == pytest.approx(mesh.volume, rel=0.02)
    assert any("cutting bent quadrangles changed the volume by" in note for note in outer.notes)


def test_quadrangles_are_cut_alike_whatever_corner_and_cell_they_begin_with():
    mesh = jitter(
        hexahedra((2, 2, 2), 2.0),
        params=JitterParams(amount=0.3, boundary="free"),
        rng=np.random.default_rng(3),
    )
    turned = VolumeMesh(mesh.vertices, hexahedra=mesh.hexahedra[::-1][:, [5, 6, 2, 1, 4, 7, 3, 0]])
    one, other = (
        {frozenset(map(tuple, outer.vertices[face])) for face in outer.faces}
        for outer in (extracted(mesh), extracted(turned))
    )
    assert one == other


def test_a_cavity_stays_a_cavity():
    outer = extracted(blocks_without((3, 3, 3), [(1, 1, 1)]))
    require_sound(outer)
    assert outer.volume == pytest.approx(26 * 8.0)


TOUCHING = {
    "two_cubes_at_an_edge": ((2, 2, 1), [(0, 1, 0), (1, 0, 0)], "parted at 2 vertices and 1 edges"),
    "two_cubes_at_a_corner": (
        (2, 2, 2),
        [place for place in product((0, 1), repeat=3) if place not in {(0, 0, 0), (1, 1, 1)}],
        "parted at 1 vertices and 0 edges",
    ),
    "a_cavity_at_a_notch's_edge": ((3, 3, 3), [(1, 1, 1), (0, 0, 1)], "and 1 edges"),
    "a_cavity_at_a_notch's_corner": ((3, 3, 3), [(1, 1, 1), (0, 0, 0)], "parted at 1 vertices and 0 edges"),
    "two_cavities_at_an_edge": ((4, 4, 3), [(1, 1, 1), (2, 2, 1)], "and 1 edges"),
    "cubes_like_a_chessboard": (
        (3, 3, 2),
        [place for place in product(range(3), range(3), range(2)) if sum(place) % 2],
        "parted at",
    ),
}


@pytest.mark.parametrize("name", TOUCHING)
def test_a_boundary_that_touches_itself_is_parted(name: str):
    counts, holes, said = TOUCHING[name]
    mesh = blocks_without(counts, holes)
    with pytest.warns(PipelineWarning, match=said):
        outer = extracted(mesh)
    require_sound(outer)
    assert outer.volume == pytest.approx(mesh.volume, rel=0.03)
    assert any(said in note and re.search(r"by at most 0.0[12] mm", note) for note in outer.notes)
    assert 0.0 < outer.facts["boundary_parting_mm"] < 0.025
    assert outer.facts["boundary_vertices_parted"] + outer.facts["boundary_edges_parted"] > 0
    assert outer.facts["boundary_volume_difference"] == pytest.approx(outer.volume / mesh.volume - 1.0)


def test_a_boundary_that_touches_itself_is_refused_where_that_is_asked_for():
    mesh = blocks_without((2, 2, 1), [(0, 1, 0), (1, 0, 0)])
    with pytest.raises(StageError, match=r"touches itself at 0 vertices and 1 edges; set `touching: part`"):
        extracted(mesh, "refuse")


def test_a_surface_folded_onto_itself_cannot_be_parted():
    vertices, faces = triangles.merge_coincident(
        *together(box((0, 0, 0), (1, 1, 1)), inverted(box((1, 1, 0), (2, 2, 1))))
    )
    with pytest.raises(StageError, match=r"its boundary folds onto itself at 1, 1, 0\.5 mm: 4 faces meet at an edge"):
        vertex_splitting.split_non_manifold(vertices, faces)


def test_bodies_upon_each_other_are_refused():
    cube = hexahedra((3, 3, 3), 4.0)
    with pytest.raises(StageError, match=r"mesh: 2 bodies overlap at .* set load_volume_mesh.component to"):
        extracted(both(cube, moved(cube, (5.0, 5.0, 5.0), 0.1)))


def test_a_boundary_that_passes_through_itself_is_refused():
    cube = hexahedra((1, 1, 1), 4.0)
    with pytest.raises(StageError, match=r"intersects itself: \d+ triangles intersect others .*; repair"):
        extracted(both(cube, moved(cube, (3.0, 2.5, 2.0))))


def test_cells_that_take_a_face_crosswise_are_refused():
    mesh = hexahedra((2, 1, 1), 2.0)
    cells = mesh.hexahedra.copy()
    shared = np.intersect1d(cells[0], cells[1])
    a, b = (int(np.flatnonzero(cells[1] == corner)[0]) for corner in shared[[0, 2]])
    cells[1, [a, b]] = cells[1, [b, a]]
    with pytest.raises(StageError, match="cells do not match at 1 of their shared faces"):
        extracted(VolumeMesh(mesh.vertices, hexahedra=cells))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sofa_Ossicles.vtu", "parted at 21 vertices and 18 edges"),
        ("sofa_Armadillo_Tetra_4406.vtu", "parted at 1 vertices and 0 edges"),
    ],
)
def test_real_meshes_that_touch_themselves_are_parted(name: str, said: str):
    if not (DATA / name).is_file():
        pytest.skip("the real meshes are not beside this checkout")
    mesh = load_volume_mesh(params=LoadVolumeMeshParams(path=DATA / name, units="mm"))
    with pytest.warns(PipelineWarning, match=said):
        outer = extracted(mesh)
    require_sound(outer)
    assert outer.volume == pytest.approx(mesh.volume, rel=1e-4)


@pytest.mark.filterwarnings("ignore::scaffold_pipeline.errors.PipelineWarning")
def test_a_real_mesh_that_passes_through_itself_is_refused():
    if not (DATA / "vtkdata_can.vtu").is_file():
        pytest.skip("the real meshes are not beside this checkout")
    mesh = load_volume_mesh(params=LoadVolumeMeshParams(path=DATA / "vtkdata_can.vtu", units="mm"))
    with pytest.raises(StageError, match="intersects itself: 259 triangles intersect others"):
        extracted(mesh)


def test_the_example_makes_a_printable_solid_from_its_mesh(tmp_path: Path):
    out = tmp_path / "run"
    coarse = ["--set", "arbf_field.voxel_size=0.5"]
    assert main(["run", str(ROOT / "configs" / "volume_mesh.yaml"), "--out", str(out), "--quiet", *coarse]) == 0
    octagon = 2.0 * np.sqrt(2.0) * 8.0**2
    assert faults_of(out / "solid.stl", 16.0 * octagon, 0.6) == []


def test_the_bounding_box_is_taken_where_that_is_asked_for():
    mesh = moved(blocks_without((3, 2, 2), [(0, 0, 0), (2, 1, 1)]), (5.0, -3.0, 1.0))
    outer = extract_outer(mesh, params=ExtractOuterParams(shape="box"))
    require_closed(outer.vertices, outer.faces)
    np.testing.assert_array_equal(outer.bounds, [[5.0, -3.0, 1.0], [11.0, 1.0, 5.0]])
    assert (len(outer.faces), outer.volume) == (12, pytest.approx(96.0))
    assert outer.notes == ("bounding box of 10 cells",)
