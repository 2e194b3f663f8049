"""Vertices move at random, by no more than asked, along the boundary, and no cell turns over."""

from __future__ import annotations

from itertools import combinations

import igl
import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_geometry.volumes.hexahedra.quality import least_jacobians
from scaffold_geometry.volumes.jitter import LEAST_SHARE, move_without_inversion, parts_of, random_steps
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import jitter as module
from scaffold_stages.jitter import JitterParams, jitter
from scaffold_stages.make_mesh import MakeMeshParams, make_mesh
from shapes import hexahedra, tetrahedra

MESH = tetrahedra((4, 5, 6), 2.0, (10.0, -5.0, 3.0))


def jittered(mesh: VolumeMesh = MESH, seed: int = 1, **given: object):
    return jitter(mesh, params=JitterParams.model_validate(given), rng=np.random.default_rng(seed))


def steps_of(mesh: VolumeMesh, moved: VolumeMesh):
    return np.linalg.norm(moved.vertices - mesh.vertices, axis=1)


def local_lengths(mesh: VolumeMesh):
    """Return the mean length of each vertex's edges, the slow way."""
    edges = mesh.edges
    lengths = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
    return np.array([lengths[(edges == i).any(axis=1)].mean() for i in range(len(mesh.vertices))])


def on_hull(mesh: VolumeMesh):
    """Return which vertices of a mesh that fills a box lie on the box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return (np.isclose(mesh.vertices, low) | np.isclose(mesh.vertices, high)).any(axis=1)


def off_boundary(mesh: VolumeMesh, points: np.ndarray):
    squared, _, _ = igl.point_mesh_squared_distance(points, mesh.vertices, module._boundary_triangles(mesh))
    return np.sqrt(squared)


def bent(mesh: VolumeMesh):
    """A mesh bent about an axis, with notches: its boundary is curved, and hollow on one side."""
    x, y, z = (mesh.vertices - mesh.vertices.min(axis=0)).T
    angle, radius = x / 8.0 * np.pi, 6.0 + y * (1.0 + 0.3 * np.sin(z))
    vertices = np.column_stack([-radius * np.cos(angle), radius * np.sin(angle), z])
    return VolumeMesh(vertices, mesh.tetrahedra)


def ugly(seed: int = 3):
    """A mesh of flat and crooked cells."""
    rng = np.random.default_rng(seed)
    free = ~on_hull(MESH)
    vertices = MESH.vertices * [1.0, 0.3, 0.08]
    vertices[free] += rng.uniform(-0.02, 0.02, (free.sum(), 3))
    return VolumeMesh(vertices, MESH.tetrahedra)


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("jitter", jitter)
    assert (declared.writes, list(declared.reads)) == ("mesh", ["mesh"])
    assert "rng" in declared.engine_arguments


@pytest.mark.parametrize("amount", [-0.1, 0.5, 0.8, float("nan")])
def test_an_amount_outside_of_its_range_is_no_parameter(amount: float):
    with pytest.raises(ValidationError):
        JitterParams(amount=amount)


def test_a_seed_gives_the_same_mesh_again_and_another_seed_another():
    assert np.array_equal(jittered(seed=5).vertices, jittered(seed=5).vertices)
    assert not np.isclose(jittered(seed=5).vertices, jittered(seed=6).vertices).all(axis=1).any()


@pytest.mark.parametrize("boundary", ["surface", "free"])
@pytest.mark.parametrize("amount", [0.1, 0.3, 0.49])
def test_no_vertex_moves_further_than_its_share_of_its_own_mean_edge(boundary: str, amount: float):
    for mesh in (MESH, bent(MESH), ugly()):
        steps = steps_of(mesh, jittered(mesh, amount=amount, boundary=boundary))
        assert (steps <= amount * local_lengths(mesh) * (1.0 + 1e-12)).all()
        assert steps.max() > 0.5 * (amount * local_lengths(mesh)).min()


def test_only_the_hull_is_taken_for_the_boundary():
    for mesh in (MESH, hexahedra((3, 4, 5))):
        assert np.array_equal(module._boundary_vertices(mesh), on_hull(mesh))


def test_a_face_between_cells_of_different_kinds_is_within():
    corners = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 1, 0),
        (0, 1, 0),
        (0, 0, -1),
        (1, 0, -1),
        (1, 1, -1),
        (0, 1, -1),
        (0.5, 0.5, 1),
    ]
    mesh = VolumeMesh(
        np.array([*corners, (0.5, -1.0, 0.5)], float),
        pyramids=np.array([(0, 1, 2, 3, 8)]),
        hexahedra=np.array([(4, 5, 6, 7, 0, 1, 2, 3)]),
        tetrahedra=np.array([(0, 1, 8, 9)]),
    )
    triangles = {frozenset(face) for face in module._boundary_triangles(mesh).tolist()}
    assert len(triangles) == 5 * 2 + 3 + 3
    assert frozenset((0, 1, 8)) not in triangles


def test_vertices_within_move_in_all_directions_evenly():
    mesh = hexahedra((12, 12, 12))
    within = ~on_hull(mesh)
    moves = (jittered(mesh, amount=0.2).vertices - mesh.vertices)[within]
    distances = np.linalg.norm(moves, axis=1)
    directions = moves / distances[:, None]
    count = len(moves)
    assert (np.abs(directions.mean(axis=0)) < 4.0 / np.sqrt(3 * count)).all()
    assert np.abs(directions.T @ directions / count - np.eye(3) / 3.0).max() < 4.0 * 0.3 / np.sqrt(count)
    quantiles = np.quantile(distances / 0.2, [0.25, 0.5, 0.75, 1.0])
    assert quantiles == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=0.05)


@pytest.mark.parametrize("mesh", [MESH, bent(MESH), ugly(), hexahedra((3, 4, 5))], ids=["box", "bent", "ugly", "cubes"])
def test_the_boundary_slides_on_itself_unless_it_is_free(mesh: VolumeMesh):
    is_boundary = module._boundary_vertices(mesh)
    moved = jittered(mesh, amount=0.4)
    assert off_boundary(mesh, moved.vertices[is_boundary]).max() < 1e-12
    assert (steps_of(mesh, moved)[is_boundary] > 0.0).mean() > 0.5
    assert off_boundary(mesh, jittered(mesh, amount=0.4, boundary="free").vertices[is_boundary]).max() > 1e-3


def test_about_a_notch_a_vertex_slides_no_further_than_its_step():
    whole = hexahedra((8, 8, 2), 0.25)
    centres = whole.vertices[whole.hexahedra].mean(axis=1)
    cells = whole.hexahedra[(centres[:, :2] < 1.0).any(axis=1)]
    used, compact = np.unique(cells, return_inverse=True)
    notched = VolumeMesh(whole.vertices[used], hexahedra=compact.reshape(cells.shape))
    boundary = module._boundary_triangles(notched)
    which = np.linalg.norm(notched.vertices - [1.25, 1.0, 0.25], axis=1) == 0.0
    step = np.array([[-0.2, 0.25, 0.0]])  # across the notch, to where its other wall is nearest

    start = notched.vertices[which]
    _, _, nearest = igl.point_mesh_squared_distance(start + step, notched.vertices, boundary)
    assert np.linalg.norm(nearest - start) > 1.1 * np.linalg.norm(step)
    end = module._project(notched, boundary, which, start + step)
    assert 0.0 < np.linalg.norm(end - start) <= np.linalg.norm(step)
    assert off_boundary(notched, end).max() < 1e-12


def test_no_movement_is_none():
    moved = jittered(amount=0.0)
    assert np.array_equal(moved.vertices, MESH.vertices)
    assert np.array_equal(moved.tetrahedra, MESH.tetrahedra)
    assert (moved.facts["vertices_moved"], moved.facts["vertices_held_back"]) == (0, 0)


def test_a_little_movement_holds_nothing_back():
    moved = jittered(amount=0.02)
    is_still = steps_of(MESH, moved) == 0.0
    assert moved.facts["vertices_moved"] == len(MESH.vertices) - is_still.sum()
    assert is_still.sum() <= 8  # corners, where all of the boundary lies behind
    assert moved.facts["vertices_held_back"] == 0


@pytest.mark.parametrize("boundary", ["surface", "free"])
@pytest.mark.parametrize("seed", range(5))
def test_no_cell_turns_over_however_much_an_ugly_mesh_is_moved(boundary: str, seed: int):
    mesh = ugly(seed)
    steps = random_steps(mesh.vertices, mesh.cells, 0.49, np.random.default_rng(seed), 3)
    assert (cell_volumes(mesh.vertices + steps, mesh.tetrahedra, "tetrahedron") < 0.0).sum() > 10  # unguarded

    moved = jittered(mesh, seed, amount=0.49, boundary=boundary)
    before = cell_volumes(mesh.vertices, mesh.tetrahedra, "tetrahedron")
    after = cell_volumes(moved.vertices, moved.tetrahedra, "tetrahedron")
    assert (after >= 0.999 * LEAST_SHARE * before).all()
    assert moved.facts["vertices_held_back"] > 10


def test_hexahedra_stay_seen_from_their_centres():
    mesh = hexahedra((5, 5, 5))
    squashed = VolumeMesh(mesh.vertices * [1.0, 1.0, 0.15], hexahedra=mesh.hexahedra)
    steps = random_steps(squashed.vertices, squashed.cells, 0.49, np.random.default_rng(2), 3)
    unguarded = parts_of(squashed.vertices + steps, mesh.hexahedra, "hexahedron")
    assert (unguarded < 0.0).any()
    moved = jittered(squashed, 2, amount=0.49)
    assert (parts_of(moved.vertices, mesh.hexahedra, "hexahedron") > 0.0).all()
    assert moved.facts["vertices_held_back"] > 0


def test_the_parts_of_a_cell_add_up_to_it():
    for mesh in (MESH, hexahedra((2, 2, 2))):
        for kind, cells in mesh.cells.items():
            moved = mesh.vertices + 0.1 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
            parts = parts_of(moved, cells, kind).sum(axis=1)
            assert parts == pytest.approx(cell_volumes(moved, cells, kind), rel=1e-9)


def test_only_cells_in_danger_hold_their_vertices_back():
    mesh = tetrahedra((8, 2, 2))
    steps = np.zeros_like(mesh.vertices)
    near = np.linalg.norm(mesh.vertices - [1.0, 1.0, 1.0], axis=1)
    steps[near == 0.0] = [0.0, 0.0, 1.5]  # out of all its cells
    steps[mesh.vertices[:, 0] >= 5.0] = [0.0, 0.1, 0.0]
    moved, scales = move_without_inversion(mesh.vertices, mesh.cells, steps)
    assert scales[near == 0.0] == pytest.approx(0.5)
    assert (scales[near > 2.0] == 1.0).all()
    assert np.array_equal(moved[near > 4.5], (mesh.vertices + steps)[near > 4.5])


def test_the_order_of_cells_and_vertices_decides_nothing():
    mesh, rng = ugly(), np.random.default_rng(8)
    steps = random_steps(mesh.vertices, mesh.cells, 0.49, rng, 3)
    moved, scales = move_without_inversion(mesh.vertices, mesh.cells, steps)
    order, cells = rng.permutation(len(steps)), rng.permutation(len(mesh.tetrahedra))
    other = VolumeMesh(mesh.vertices[order], np.argsort(order)[mesh.tetrahedra][cells])
    other_moved, other_scales = move_without_inversion(other.vertices, other.cells, steps[order])
    assert (scales < 1.0).any()
    assert np.array_equal(other_scales, scales[order])
    assert np.array_equal(other_moved, moved[order])


def test_a_cell_folded_to_begin_with_folds_no_further():
    mesh = hexahedra((3, 3, 3))
    vertices = mesh.vertices.copy()
    vertices[np.linalg.norm(vertices - 1.0, axis=1) == 0.0] += 0.75
    folded = VolumeMesh(vertices, hexahedra=mesh.hexahedra)
    before = parts_of(vertices, mesh.hexahedra, "hexahedron")
    is_folded = (before <= 0.0).any(axis=1)
    assert is_folded.any()
    after = parts_of(jittered(folded, amount=0.4).vertices, mesh.hexahedra, "hexahedron")
    assert (after >= before)[is_folded].all()
    assert (after[~is_folded] > 0.0).all()


@pytest.mark.parametrize("boundary", ["surface", "free"])
def test_the_papers_eight_hexahedra_are_disturbed_by_seed_and_none_is_inverted(boundary: str):
    cube = make_mesh(params=MakeMeshParams(shape="cube"))
    meshes = [jittered(cube, seed, amount=0.3, boundary=boundary) for seed in range(3)]
    for seed, mesh in enumerate(meshes):
        again = jittered(cube, seed, amount=0.3, boundary=boundary)
        assert mesh.vertices.tobytes() == again.vertices.tobytes()
        assert least_jacobians(mesh.vertices, mesh.hexahedra).min() > 0.1
        assert (parts_of(mesh.vertices, mesh.hexahedra, "hexahedron") > 0.0).all()
    for one, other in combinations(meshes, 2):
        assert (steps_of(one, other) > 0.0).mean() > 0.5
    if boundary == "surface":
        assert max(off_boundary(cube, mesh.vertices[on_hull(cube)]).max() for mesh in meshes) < 1e-12
