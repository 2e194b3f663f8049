"""A mesh brought to single precision: nothing folds, pinches or opens, near the origin or far from it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scaffold_geometry.surfaces.booleans import to_manifold
from scaffold_geometry.surfaces.float32 import snap_to_float32
from scaffold_geometry.surfaces.self_intersections import degenerate_faces, self_intersecting_faces
from scaffold_pipeline.errors import StageError

BALL = trimesh.creation.icosphere(4, radius=5.0)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)
STEP = float(np.spacing(np.float32(5.0)))


def with_slivers(seed: int = 0) -> np.ndarray:
    """Return the ball's vertices, a tenth of them moved nearly onto a neighbour or nearly onto an opposite edge."""
    rng, vertices = np.random.default_rng(seed), VERTICES.copy()
    for number, face in enumerate(rng.choice(FACES, len(VERTICES) // 20, replace=False)):
        a, b, c = vertices[face]
        target = b if number % 2 else 0.37 * b + 0.63 * c
        vertices[face[0]] = target + 10.0 ** rng.uniform(-9, -4) * (a - target)
    return vertices


def is_clean(vertices: np.ndarray, faces: np.ndarray) -> bool:
    is_apart = len(np.unique(vertices, axis=0)) == len(vertices)
    return (
        is_apart and not self_intersecting_faces(vertices, faces).any() and not degenerate_faces(vertices, faces).any()
    )


@pytest.mark.parametrize("offset", [0.0, 100.0, 1000.0, 20_000.0])
@pytest.mark.parametrize("seed", range(3))
def test_slivers_that_rounding_would_fold_are_opened(offset: float, seed: int):
    slivers = with_slivers(seed)
    vertices = slivers + offset
    naive = vertices.astype(np.float32).astype(np.float64)
    assert not is_clean(naive, FACES)

    rounded = snap_to_float32(vertices, FACES, "ball")

    assert np.array_equal(rounded.vertices, rounded.vertices.astype(np.float32))
    assert is_clean(rounded.vertices, rounded.faces)
    assert rounded.moved <= 16.0 * np.spacing(np.float32(offset + 5.0))
    body = to_manifold(rounded.vertices, rounded.faces, "ball")
    assert body.volume() == pytest.approx(to_manifold(slivers, FACES, "ball").volume(), rel=1e-4)


def test_no_two_vertices_lie_so_close_that_a_reader_would_weld_them():
    vertices = VERTICES.copy()
    near = np.argsort(np.linalg.norm(vertices[:, :2], axis=1))[:12]
    vertices[near] *= [1e-9, 1e-9, 1.0]  # single precision tells such vertices apart beside the axis
    naive = vertices.astype(np.float32)
    assert len(np.unique(naive, axis=0)) == len(vertices)
    assert len(np.unique(np.round(naive.astype(np.float64), 8), axis=0)) < len(vertices)

    rounded = snap_to_float32(vertices, FACES, "ball")

    assert len(np.unique(np.round(rounded.vertices, 8), axis=0)) == len(rounded.vertices)
    assert is_clean(rounded.vertices, rounded.faces)


def test_what_is_in_steps_of_single_precision_is_left_as_it_is():
    vertices = np.round(VERTICES / STEP) * STEP

    rounded = snap_to_float32(vertices, FACES, "ball")

    assert rounded.moved == 0.0
    assert np.array_equal(rounded.vertices, vertices)
    assert np.array_equal(rounded.faces, FACES)


def test_what_only_rounds_keeps_its_triangles():
    rounded = snap_to_float32(VERTICES + 100.0, FACES, "ball")

    assert 0.0 < rounded.moved <= np.spacing(np.float32(64.0))
    assert np.array_equal(rounded.faces, FACES)


def test_details_below_the_step_of_single_precision_are_refused():
    with pytest.raises(StageError, match=r"^speck: has details finer than .* 0\.002 mm, .*move the shape nearer"):
        snap_to_float32(1e-5 * VERTICES + 20_000.0, FACES, "speck")
