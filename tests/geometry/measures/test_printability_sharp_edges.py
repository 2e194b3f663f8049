"""Sharp edges of solids whose angles are known, and against all pairs of faces."""

from itertools import combinations

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.sharp_edges import sharp_edges


def test_edges_of_a_box_are_right_angles_and_its_diagonals_flat():
    vertices, faces = shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    edges, angles = sharp_edges(vertices, faces, np.radians(91.0))
    assert len(edges) == 12
    assert np.degrees(angles) == pytest.approx(90.0)
    assert (np.abs(vertices[edges[:, 1]] - vertices[edges[:, 0]]) > 0.0).sum(axis=1).tolist() == [1] * 12
    assert len(sharp_edges(vertices, faces, np.radians(89.0)).edges) == 0


@pytest.mark.parametrize("degrees", [1.0, 20.0, 60.0])
def test_edge_of_a_wedge_has_its_angle(degrees):
    wedge = shapes.prism([(0.0, 0.0), (5.0, 0.0), (5.0, 5.0 * np.tan(np.radians(degrees)))], 2.0)
    found = sharp_edges(*wedge, np.radians(min(degrees + 1.0, 61.0)))
    angles = {tuple(edge): angle for edge, angle in zip(found.edges.tolist(), np.degrees(found.angles), strict=True)}
    assert angles[0, 3] == pytest.approx(degrees, rel=1e-3)


def test_hollow_edges_are_not_sharp():
    vertices, faces = shapes.inverted(shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)))
    assert len(sharp_edges(vertices, faces, np.radians(170.0)).edges) == 0


def test_sharp_edges_of_a_rugged_ball_are_those_found_pair_by_pair():
    vertices, faces = shapes.ball(1.0, divisions=2)
    vertices = vertices + np.random.default_rng(3).normal(0.0, 0.15, vertices.shape)
    found = sharp_edges(vertices, faces, 1.8)
    expected = _pair_by_pair(vertices, faces, 1.8)
    assert {tuple(edge) for edge in found.edges.tolist()} == set(expected)
    assert len(expected) > 10
    assert found.angles == pytest.approx([expected[tuple(edge)] for edge in found.edges.tolist()], abs=1e-5)


def _pair_by_pair(vertices, faces, greatest):
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sharp = {}
    for i, j in combinations(range(len(faces)), 2):
        common = set(faces[i].tolist()) & set(faces[j].tolist())
        if len(common) == 2:
            beyond = next(v for v in faces[j].tolist() if v not in common)
            angle = np.pi - np.arccos(np.clip(normals[i] @ normals[j], -1.0, 1.0))
            if angle < greatest and normals[i] @ (vertices[beyond] - vertices[faces[i, 0]]) < 0.0:
                sharp[tuple(sorted(common))] = angle
    return sharp
