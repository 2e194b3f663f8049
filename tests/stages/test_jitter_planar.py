"""Vertices of a planar mesh move at random in the plane, the outline stays, and no tile turns over."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.planar import regions
from scaffold_geometry.volumes.jitter import LEAST_SHARE, parts_of
from scaffold_pipeline.artifacts import PlanarMesh
from scaffold_pipeline.artifacts.cells import corner_turns
from scaffold_stages.jitter_planar import JitterPlanarParams, jitter_planar
from scaffold_stages.make_planar_mesh import MakePlanarMeshParams, make_planar_mesh
from shapes import squares

MESH = squares((6, 5), 2.0, 3.0)
DISC = make_planar_mesh(params=MakePlanarMeshParams(shape="disc", rings=5, edge=2.0))


def jittered(mesh: PlanarMesh = MESH, seed: int = 1, **given: object) -> PlanarMesh:
    return jitter_planar(mesh, params=JitterPlanarParams.model_validate(given), rng=np.random.default_rng(seed))


def outline(mesh: PlanarMesh):
    return regions.outline_of(mesh.vertices, mesh.cells)


def local_lengths(mesh: PlanarMesh):
    lengths = np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1)[:, 0], axis=1)
    return np.array([lengths[(mesh.edges == i).any(axis=1)].mean() for i in range(len(mesh.vertices))])


@pytest.mark.parametrize("boundary", ["outline", "free"])
@pytest.mark.parametrize("mesh", [MESH, DISC], ids=["squares", "disc"])
def test_no_vertex_leaves_the_plane_or_moves_further_than_its_share(mesh: PlanarMesh, boundary: str):
    moved = jittered(mesh, amount=0.4, boundary=boundary)
    steps = np.linalg.norm(moved.vertices - mesh.vertices, axis=1)
    assert moved.z == mesh.z
    assert (steps <= 0.4 * local_lengths(mesh) * (1.0 + 1e-12)).all()
    assert steps.max() > 0.5 * (0.4 * local_lengths(mesh)).min()


def test_a_seed_gives_the_same_mesh_again_and_another_seed_another():
    assert np.array_equal(jittered(seed=5).vertices, jittered(seed=5).vertices)
    assert not np.array_equal(jittered(seed=5).vertices, jittered(seed=6).vertices)


@pytest.mark.parametrize("turn", [0.0, 0.4])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_outline_stays_as_it_is_while_vertices_slide_on_its_straight_parts(turn: float, seed: int):
    turned = np.array([(np.cos(turn), np.sin(turn), 0.0), (-np.sin(turn), np.cos(turn), 0.0), (0.0, 0.0, 1.0)])
    mesh = PlanarMesh(MESH.vertices @ turned, quadrangles=MESH.quadrangles)
    moved = jittered(mesh, seed, amount=0.45)
    assert ((outline(moved) - outline(mesh)) + (outline(mesh) - outline(moved))).area() < 1e-6
    is_outer = (np.abs(MESH.vertices[:, 0]) == 6.0) | (np.abs(MESH.vertices[:, 1]) == 5.0)
    has_moved = (moved.vertices != mesh.vertices).any(axis=1)
    assert has_moved[~is_outer].all()
    assert (~has_moved).sum() == 4  # the corners
    free = jittered(mesh, seed, amount=0.45, boundary="free")
    assert (outline(mesh) - outline(free)).area() > 0.1


def test_the_rim_of_a_disc_stays():
    moved = jittered(DISC, amount=0.3)
    is_rim = np.isclose(np.linalg.norm(DISC.vertices, axis=1), 10.0)
    assert np.array_equal(moved.vertices[is_rim], DISC.vertices[is_rim])
    assert (moved.vertices != DISC.vertices)[~is_rim].any(axis=1).all()


def test_where_corners_of_the_outline_meet_the_vertex_stays():
    pair = squares((2, 2))
    touching = PlanarMesh(np.delete(pair.vertices, [2, 6], axis=0), quadrangles=np.array([(0, 2, 3, 1), (3, 5, 6, 4)]))
    moved = jittered(touching, amount=0.4)
    assert np.array_equal(moved.vertices, touching.vertices)


@pytest.mark.parametrize("seed", range(3))
def test_no_tile_turns_over_however_much_a_flat_mesh_is_moved(seed: int):
    flat = PlanarMesh(MESH.vertices * [1.0, 0.1, 1.0], quadrangles=MESH.quadrangles)
    moved = jittered(flat, seed, amount=0.49)
    before, after = (parts_of(mesh.vertices, flat.quadrangles, "quadrangle") for mesh in (flat, moved))
    assert (after >= 0.999 * LEAST_SHARE * before).all()
    assert moved.facts["vertices_held_back"] > 10
    assert ((corner_turns(moved.vertices, moved.quadrangles) < 0.0).sum(axis=1) <= 1).all()


def test_no_movement_is_none():
    moved = jittered(amount=0.0)
    assert np.array_equal(moved.vertices, MESH.vertices)
    assert (moved.facts["vertices_moved"], moved.facts["vertices_held_back"]) == (0, 0)
