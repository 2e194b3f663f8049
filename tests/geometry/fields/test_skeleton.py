"""The skeleton of a volume mesh: what is counted, what is shared, what is long."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.fields.oracle import (
    HEXAHEDRON,
    REFERENCE_MESHES,
    Floats,
    Mesh,
    eight_hexahedra,
    elements_of,
    icosahedron,
    one_tetrahedron,
)
from scaffold_geometry.fields.skeleton import Skeleton, skeleton_of, slab_around
from scaffold_geometry.surfaces.triangles import edge_faults
from scaffold_pipeline.artifacts import PlanarMesh, SurfaceMesh, VolumeMesh
from scaffold_pipeline.artifacts.cells import CELL_TYPES

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

SOLID = [name for name, kind in CELL_TYPES.items() if not kind.is_planar]

TILES = Mesh(
    np.array([(0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2), (3, 1, 2), (1, 3, 2)], dtype=float),
    {"triangle": np.array([(1, 4, 2), (3, 2, 5)]), "quadrangle": np.array([(0, 1, 2, 3)])},
)
"""A square with a triangle on two of its sides."""


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
    for kind, centre in zip(SOLID, mixed.cell_centres, strict=True):
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


def tile_oracle(mesh: Mesh) -> tuple[set[frozenset[int]], list[tuple[Floats, Floats]]]:
    """The edges of a planar mesh, and its channels as pairs of points: tile by tile, corner by corner."""
    edges, channels = set(), []
    for tile in (tile for kind in ("triangle", "quadrangle") for tile in mesh.cells.get(kind, ())):
        for i in range(len(tile)):
            a, b = int(tile[i - 1]), int(tile[i])
            edges.add(frozenset((a, b)))
            channels.append((sum(mesh.vertices[tile]) / len(tile), (mesh.vertices[a] + mesh.vertices[b]) / 2))
    return edges, channels


def squares(columns: int, rows: int) -> Mesh:
    lattice = np.array([(x, y, 0.0) for y in range(rows + 1) for x in range(columns + 1)])
    first = np.array([x + y * (columns + 1) for y in range(rows) for x in range(columns)])[:, None]
    return Mesh(lattice, {"quadrangle": first + np.array([0, 1, columns + 2, columns + 1])})


@pytest.mark.parametrize(
    ("mesh", "vertices", "edges", "tiles", "channels"),
    [
        (squares(1, 1), 4, 4, 1, 4),
        (squares(3, 2), 12, 17, 6, 24),
        (Mesh(TILES.vertices[:3], {"triangle": np.array([(0, 1, 2)])}), 3, 3, 1, 3),
        (TILES, 6, 8, 3, 10),
    ],
)
def test_a_planar_mesh_has_channels_from_the_centres_of_tiles_to_those_of_edges(
    mesh: Mesh, vertices: int, edges: int, tiles: int, channels: int
):
    found, (expected_edges, expected_channels) = skeleton(mesh), tile_oracle(mesh)
    counts = (len(found.vertices), len(found.face_centres), len(found.cell_centres), len(found.channel_starts))
    assert counts == (vertices, edges, tiles, channels)
    assert {frozenset(edge) for edge in found.edges.tolist()} == expected_edges
    ends = np.hstack([found.channel_starts, found.channel_ends])
    np.testing.assert_allclose(sorted_rows(ends), sorted_rows(np.array(expected_channels).reshape(-1, 6)), atol=1e-12)
    middles = found.vertices[found.edges].mean(axis=1)
    np.testing.assert_allclose(sorted_rows(found.face_centres), sorted_rows(middles), atol=1e-12)
    assert set(found.vertices[:, 2]) == set(found.face_centres[:, 2]) == set(found.channel_starts[:, 2])


def test_an_edge_between_two_tiles_has_a_channel_from_each():
    found = skeleton(TILES)
    assert sorted(np.bincount(found.channel_faces)) == [1] * 6 + [2] * 2
    np.testing.assert_array_equal(found.channel_cells, np.repeat(np.arange(3), (3, 3, 4)))
    np.testing.assert_array_equal(found.channel_ends, found.face_centres[found.channel_faces])


@pytest.mark.parametrize("height", [0.0, 1e6])
def test_around_a_planar_mesh_lies_a_slab_even_over_a_hollow_tile(height: float):
    arrow = [(0, 2), (-2, -2), (0, -1), (2, -2)]
    corners = np.array([(x, y, height) for x, y in (*arrow, (3, 2))], float)
    mesh = PlanarMesh(corners, triangles=np.array([(0, 3, 4)]), quadrangles=np.array([(0, 1, 2, 3)]))
    surface = SurfaceMesh(*slab_around(mesh.vertices, mesh.cells))
    thickness = float(np.ptp(surface.vertices[:, 2]))
    assert not any(edge_faults(surface.faces))
    assert surface.bounds.mean(axis=0)[2] == height
    assert mesh.area == pytest.approx(12.0)
    assert surface.volume == pytest.approx(12.0 * thickness)
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    tops = np.cross(b - a, c - a)[:, 2] / 2.0
    assert tops[tops > 0].sum() == pytest.approx(12.0)  # no triangle lies upon another
    assert tops[tops < 0].sum() == pytest.approx(-12.0)
