"""The meshes are those of the paper's figures, sound, about the origin, and fill what they say."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.volumes import cells
from scaffold_geometry.volumes.boundary import boundary_triangles
from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes, faces_of_cells
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.make_mesh import MakeMeshParams, make_mesh

PAPER = ["tetrahedron", "icosahedron", "hexahedron", "cube", "rod"]
BLOCKS = [
    {"shape": "block", "counts": (2, 3, 4), "edge": 0.5},
    {"shape": "block", "counts": 3, "cell": "tetrahedron"},
    {"shape": "block", "counts": (1, 2, 3), "cell": "tetrahedron", "edge": 2.0},
]
ALL = [*({"shape": shape} for shape in PAPER), *BLOCKS]


def made(**given: object):
    return make_mesh(params=MakeMeshParams.model_validate(given))


def boundary_of(mesh: VolumeMesh):
    surface, _ = boundary_triangles(mesh.vertices, cells.faces(mesh.cells))
    return OuterShape(*triangles.drop_unreferenced(mesh.vertices, surface))


def edge_lengths(mesh: VolumeMesh):
    return np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1)[:, 0], axis=1)


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("make_mesh", make_mesh)
    assert (declared.writes, declared.reads) == ("mesh", {})


@pytest.mark.parametrize(("shape", "unknowns"), [("hexahedron", 21), ("cube", 119), ("rod", 69), ("icosahedron", 163)])
def test_the_papers_meshes_have_its_unknowns(shape: str, unknowns: int):
    mesh = made(shape=shape)
    found = skeleton_of(mesh.vertices, mesh.cells)
    elements = (found.vertices, found.face_centres, found.cell_centres, found.channel_starts)
    assert sum(map(len, elements)) == unknowns


@pytest.mark.parametrize(
    ("shape", "size"),
    [("hexahedron", (2, 2, 2)), ("cube", (1, 1, 1)), ("rod", (4, 1, 1)), ("tetrahedron", (2, 2, 2))],
)
def test_left_out_the_edge_is_the_papers(shape: str, size: tuple[int, int, int]):
    mesh = made(shape=shape)
    half = np.array(size) / 2.0
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [-half, half])


def test_an_icosahedron_has_its_corners_on_the_sphere_and_even_cells():
    mesh = made(shape="icosahedron")
    radii = np.sort(np.linalg.norm(mesh.vertices, axis=1))
    assert radii[0] == 0.0
    np.testing.assert_allclose(radii[1:], 1.0)
    volumes = cell_volumes(mesh.vertices, mesh.tetrahedra, "tetrahedron")
    golden = (1.0 + 5.0**0.5) / 2.0
    side = 1.0 / np.sin(2.0 * np.pi / 5.0)
    np.testing.assert_allclose(volumes.sum(), 5.0 / 6.0 * golden**2 * side**3)
    np.testing.assert_allclose(volumes, volumes[0])


def test_the_tetrahedron_is_regular():
    lengths = edge_lengths(made(shape="tetrahedron", edge=3.0))
    assert len(lengths) == 6
    np.testing.assert_allclose(lengths, 3.0)


@pytest.mark.parametrize("given", ALL, ids=str)
def test_every_mesh_is_a_ball_about_the_origin(given: dict[str, object]):
    mesh = made(**given)
    faces = {tuple(sorted(face)) for face in faces_of_cells(mesh.cells).tolist()}
    assert len(mesh.vertices) - len(mesh.edges) + len(faces) - cells.count(mesh.cells) == 1
    surface = boundary_of(mesh)
    assert triangles.euler_characteristic(surface.faces) == 2
    assert surface.volume == pytest.approx(mesh.volume)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
    np.testing.assert_allclose(middle, 0.0, atol=1e-12)


@pytest.mark.parametrize("given", BLOCKS, ids=str)
def test_the_cells_of_a_block_fill_its_box(given: dict[str, object]):
    mesh = made(**given)
    counts = np.broadcast_to(given["counts"], 3)
    edge = given.get("edge", 1.0)
    per_cube = 6 if given.get("cell") == "tetrahedron" else 1
    assert cells.count(mesh.cells) == per_cube * counts.prod()
    assert len(mesh.vertices) == (counts + 1).prod()
    assert mesh.volume == pytest.approx(edge**3 * counts.prod())
    assert boundary_of(mesh).area == pytest.approx(2.0 * edge**2 * counts.prod() * (1.0 / counts).sum())


def test_the_edge_scales_all_of_a_mesh():
    for shape in PAPER:
        one, ten = made(shape=shape, edge=1.0), made(shape=shape, edge=10.0)
        np.testing.assert_allclose(ten.vertices, 10.0 * one.vertices)
        assert edge_lengths(one).min() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"shape": "block"}, "counts: is required for a block; give 4 or"),
        ({"shape": "rod", "counts": 3}, "counts: is for a block only, not for a rod; leave it out"),
        ({"shape": "cube", "cell": "tetrahedron"}, "cell: is for a block only, not for a cube; leave it out"),
        ({"shape": "block", "counts": (1000, 1000, 1000)}, "counts: must make at most 1000000 cells, got 1000000000"),
        ({"shape": "block", "counts": 60, "cell": "tetrahedron"}, "got 1296000"),
        ({"shape": "block", "counts": (3, 0, 3)}, "greater than or equal to 1"),
        ({"shape": "block", "counts": (3, 3)}, "counts"),
        ({"shape": "dodecahedron"}, "'tetrahedron', 'icosahedron', 'hexahedron', 'cube', 'rod' or 'block'"),
        ({"shape": "cube", "edge": 0.0}, "greater than 0"),
    ],
)
def test_what_makes_no_mesh_is_refused(given: dict[str, object], told: str):
    with pytest.raises(ValidationError, match=told):
        MakeMeshParams.model_validate(given)
