"""Where parts of a surface start and meet, against growing them vertex by vertex."""

import numpy as np
import pytest

import shapes
from scaffold_geometry.measures.printability.merge_tree import part_heights


def test_part_of_a_ball_starts_at_its_lowest_vertex_and_meets_none():
    vertices, faces = shapes.ball(1.0, divisions=2)
    rises = part_heights(faces, vertices[:, 2])
    assert np.flatnonzero(rises != -1.0).tolist() == [int(vertices[:, 2].argmin())]
    assert rises.max() == np.inf


def test_of_two_parts_that_meet_the_higher_ends():
    heights = np.array([0.0, 3.0, 1.0, 4.0, 2.5])
    rises = part_heights(np.array([(0, 1, 3), (1, 2, 3), (2, 4, 3)]), heights)
    assert rises.tolist() == [np.inf, -1.0, 2.0, -1.0, -1.0]


def test_level_ground_is_one_part():
    vertices, faces = shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    assert sorted(part_heights(faces, vertices[:, 2])) == [-1.0] * 7 + [np.inf]


@pytest.mark.parametrize("seed", range(5))
def test_parts_of_random_heights_are_those_grown_vertex_by_vertex(seed):
    vertices, faces = shapes.together(shapes.ball(1.0, divisions=2), shapes.ball(1.0, divisions=1))
    heights = np.random.default_rng(seed).integers(0, 40, len(vertices)).astype(float)
    rises = part_heights(faces, heights)
    assert rises.tolist() == _grown(faces, heights)
    assert (rises > 0.0).sum() > 5


def _grown(faces, heights):
    neighbours = [set() for _ in heights]
    for a, b, c in faces.tolist():
        neighbours[a] |= {b, c}
        neighbours[b] |= {a, c}
        neighbours[c] |= {a, b}
    rises, parts = [-1.0] * len(heights), {}
    for vertex in sorted(range(len(heights)), key=lambda v: (heights[v], v)):
        met = {parts[v] for v in neighbours[vertex] if v in parts}
        eldest = min(met, key=lambda v: (heights[v], v), default=vertex)
        if eldest == vertex:
            rises[vertex] = np.inf
        for younger in met - {eldest}:
            rises[younger] = heights[vertex] - heights[younger]
        parts[vertex] = eldest
        parts = {v: eldest if part in met else part for v, part in parts.items()}
    return rises
