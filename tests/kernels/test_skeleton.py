"""The skeleton of a volume mesh: what is counted, what is shared, what is long."""

from __future__ import annotations

import numpy as np
import pytest

from kernels.oracle import (
    HEXAHEDRON,
    REFERENCE_MESHES,
    Floats,
    Mesh,
    eight_hexahedra,
    elements_of,
    icosahedron,
    one_tetrahedron,
)
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.cell_types import CELL_TYPES
from scaffold_stages._kernels.skeleton import Skeleton, _groups, skeleton_of

FOUR_KINDS = Mesh(
    np.vstack([HEXAHEDRON, [(0.5, 0.5, 2), (2, 0, 0.5), (2, 1, 0.5), (1.5, 0.5, 2)]]),
    {
        "hexahedron": np.arange(8)[None],
        "tetrahedron": np.array([[5, 6, 8, 11]]),
        "pyramid": np.array([[4, 5, 6, 7, 8]]),
        "wedge": np.array([[1, 5, 9, 2, 6, 10]]),
    },
)
"""A cube, a pyramid on top, a wedge beside it and a tetrahedron at the pyramid: each shares one face with another."""


def skeleton(mesh: Mesh) -> Skeleton:
    return skeleton_of(*mesh)


def sorted_rows(points: Floats) -> Floats:
    """The points in an order that depends on nothing but where they are."""
    rounded = np.round(points, 9) + 0.0
    return rounded[np.lexsort(rounded.T)]


@pytest.mark.parametrize(
    ("kind", "faces", "edges"),
    [
        ("tetrahedron", 4, 6),
        ("pyramid", 5, 8),
        ("wedge", 5, 9),
        ("hexahedron", 6, 12),
    ],
)
def test_one_cell_has_a_channel_to_each_of_its_faces(kind: str, faces: int, edges: int):
    corners = CELL_TYPES[kind].corners
    vertices = np.random.default_rng(3).random((corners, 3))
    lone = skeleton_of(vertices, {kind: np.arange(corners)[None]})
    assert len(lone.face_centres) == len(lone.channel_starts) == len(lone.channel_ends) == faces
    assert len(lone.edges) == len(lone.edge_lengths) == edges
    np.testing.assert_allclose(lone.cell_centres, vertices.mean(axis=0)[None], rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "unknowns"),
    list(zip(REFERENCE_MESHES, (21, 119, 69, 163), strict=True)),
)
def test_reference_meshes_have_the_known_number_of_elements(name: str, unknowns: int):
    found = skeleton(REFERENCE_MESHES[name]())
    groups = (found.vertices, found.face_centres, found.cell_centres, found.channel_starts)
    assert sum(map(len, groups)) == unknowns


@pytest.mark.parametrize("name", REFERENCE_MESHES)
def test_the_elements_lie_where_the_oracle_has_them(name: str):
    mesh = REFERENCE_MESHES[name]()
    found, oracle = skeleton(mesh), elements_of(mesh)
    points = np.vstack([found.vertices, found.face_centres, found.cell_centres])
    channels = np.hstack([found.channel_starts, found.channel_ends])
    expected = np.hstack([oracle.starts, oracle.ends])
    np.testing.assert_allclose(sorted_rows(points), sorted_rows(expected[: len(points), :3]), atol=1e-9)
    np.testing.assert_allclose(sorted_rows(channels), sorted_rows(expected[len(points) :]), atol=1e-9)


def test_a_face_shared_by_two_cells_is_one_face_centre_with_two_channels():
    inner = skeleton(icosahedron())
    counts = np.bincount(inner.channel_faces)
    assert len(inner.face_centres) == 50
    assert sorted(counts) == [1] * 20 + [2] * 30
    np.testing.assert_array_equal(inner.channel_ends, inner.face_centres[inner.channel_faces])


def test_faces_are_shared_between_cells_of_different_kinds():
    mixed = skeleton(FOUR_KINDS)
    assert len(mixed.channel_faces) == 20
    assert len(mixed.face_centres) == 17
    np.testing.assert_array_equal(mixed.channel_cells, np.repeat(np.arange(4), (4, 5, 5, 6)))
    shared = np.flatnonzero(np.bincount(mixed.channel_faces) == 2)
    expected = [(0.5, 0.5, 1), (1, 0.5, 0.5), (5 / 6, 0.5, 4 / 3)]
    np.testing.assert_allclose(sorted_rows(mixed.face_centres[shared]), sorted_rows(np.array(expected)), atol=1e-9)


def test_channels_run_from_the_centre_of_their_cell():
    mixed = skeleton(FOUR_KINDS)
    np.testing.assert_array_equal(mixed.channel_starts, mixed.cell_centres[mixed.channel_cells])
    for kind, centre in zip(CELL_TYPES, mixed.cell_centres, strict=True):
        np.testing.assert_allclose(centre, mixed.vertices[FOUR_KINDS.cells[kind][0]].mean(axis=0), rtol=1e-15)


def test_edges_are_those_of_the_mesh():
    for mesh in (eight_hexahedra(), icosahedron()):
        (kind,) = mesh.cells
        name = {"hexahedron": "hexahedra", "tetrahedron": "tetrahedra"}[kind]
        artifact = VolumeMesh(mesh.vertices, **{name: mesh.cells[kind]})
        np.testing.assert_array_equal(skeleton_of(artifact.vertices, artifact.cells).edges, artifact.edges)


def test_the_order_of_faces_and_edges_does_not_depend_on_the_order_of_cells():
    mesh = icosahedron()
    shuffled = np.random.default_rng(5).permutation(mesh.cells["tetrahedron"])
    one, other = skeleton(mesh), skeleton_of(mesh.vertices, {"tetrahedron": shuffled[:, [1, 2, 0, 3]]})
    np.testing.assert_array_equal(one.face_centres, other.face_centres)
    np.testing.assert_array_equal(one.edges, other.edges)


def test_local_lengths_are_means_over_the_edges_of_a_vertex():
    mixed = skeleton(FOUR_KINDS)
    meeting = [[] for _ in mixed.vertices]
    for a, b in mixed.edges:
        for end in (a, b):
            meeting[end].append(np.linalg.norm(mixed.vertices[a] - mixed.vertices[b]))
    np.testing.assert_allclose(mixed.local_lengths, [np.mean(lengths) for lengths in meeting], rtol=1e-14)
    for (a, b), length in zip(mixed.edges, mixed.edge_lengths, strict=True):
        assert length == pytest.approx((mixed.local_lengths[a] + mixed.local_lengths[b]) / 2)
    in_hexahedron = mixed.channel_lengths[mixed.channel_cells == 3]
    np.testing.assert_allclose(in_hexahedron, mixed.local_lengths[:8].mean(), rtol=1e-14)


def test_equal_edges_have_their_own_length_everywhere_and_scale_with_the_mesh():
    vertices, cells = one_tetrahedron()
    for scale in (1.0, 40.0):
        regular = skeleton_of(scale * vertices, cells)
        for lengths in (regular.local_lengths, regular.edge_lengths, regular.channel_lengths):
            np.testing.assert_allclose(lengths, scale * np.sqrt(8.0), rtol=1e-14)
        assert regular.mean_edge_length == pytest.approx(scale * np.sqrt(8.0))


def test_rows_too_wide_for_one_integer_are_still_grouped():
    few = np.random.default_rng(7).integers(-1, 2**40, size=(50, 4))
    rows = few[np.random.default_rng(8).integers(0, 50, 400)]
    unique, groups = _groups(rows)
    expected, inverse = np.unique(rows, axis=0, return_inverse=True)
    np.testing.assert_array_equal(unique, expected)
    np.testing.assert_array_equal(groups, inverse)
