"""Tiles from a formula: as many as asked for, of the edge asked for, whole and centred."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_pipeline.artifacts import PlanarMesh
from scaffold_stages.make_planar_mesh import MakePlanarMeshParams, make_planar_mesh


def made(**given: object) -> PlanarMesh:
    return make_planar_mesh(params=MakePlanarMeshParams.model_validate(given))


def lengths(mesh: PlanarMesh):
    return np.linalg.norm(np.diff(mesh.vertices[mesh.edges], axis=1)[:, 0], axis=1)


def outline_length(mesh: PlanarMesh) -> int:
    """Return the edges of only one tile: each tile has as many as corners, inner ones count twice."""
    return (
        3 * len(mesh.triangles)
        + 4 * len(mesh.quadrangles)
        - 2 * (3 * len(mesh.triangles) + 4 * len(mesh.quadrangles) - len(mesh.edges))
    )


@pytest.mark.parametrize(
    ("given", "tiles", "area", "outline"),
    [
        ({"shape": "triangle"}, 1, np.sqrt(3.0) / 4.0, 3),
        ({"shape": "quadrangle"}, 1, 1.0, 4),
        ({"shape": "quadrangles", "counts": (5, 3)}, 15, 15.0, 16),
        ({"shape": "triangles", "counts": (1, 1)}, 3, np.sqrt(0.75), 5),
        ({"shape": "triangles", "counts": (5, 3)}, 33, 15.0 * np.sqrt(0.75), 17),
        ({"shape": "disc", "rings": 1}, 6, 1.5 * np.sqrt(3.0), 6),
        ({"shape": "disc", "rings": 4}, 96, 16.0 * 12.0 * np.sin(np.pi / 12.0), 24),
    ],
)
def test_a_mesh_has_its_tiles_area_and_outline(given: dict[str, object], tiles: int, area: float, outline: int):
    mesh = made(edge=2.0, z=7.0, **given)
    assert len(mesh.triangles) + len(mesh.quadrangles) == tiles
    assert mesh.area == pytest.approx(4.0 * area)
    assert outline_length(mesh) == outline
    assert mesh.z == 7.0
    assert mesh.vertices[:, :2].min(axis=0) == pytest.approx(-mesh.vertices[:, :2].max(axis=0))
    assert len(mesh.vertices) - len(mesh.edges) + tiles == 1  # Euler: one piece without a hole


def test_edges_are_as_long_as_asked_for():
    assert lengths(made(shape="quadrangles", counts=(4, 2), edge=3.0)) == pytest.approx(3.0)
    of_triangles = lengths(made(shape="triangles", counts=(4, 4), edge=3.0))
    is_whole = np.isclose(of_triangles, 3.0)
    assert is_whole.sum() == len(of_triangles) - 4 - 4 * 2  # but for halves: four edges along x, and two a row
    spokes = lengths(made(shape="disc", rings=12, edge=3.0))
    assert spokes.min() == pytest.approx(3.0)
    assert spokes.max() < 1.5 * 3.0


def test_a_disc_has_the_symmetry_of_a_hexagon():
    mesh = made(shape="disc", rings=5)
    turn = np.exp(1j * np.pi / 3.0)
    places = mesh.vertices[:, 0] + 1j * mesh.vertices[:, 1]
    images = np.array([np.abs(places * turn - place).argmin() for place in places])
    assert np.abs((places * turn)[images] - places).max() < 1e-12
    moved = {frozenset(np.argsort(images)[tile].tolist()) for tile in mesh.triangles}
    assert moved == {frozenset(tile) for tile in mesh.triangles.tolist()}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"shape": "triangle", "counts": (2, 2)}, "counts: does not apply to shape: triangle; leave it out"),
        ({"shape": "disc"}, "rings: is required with shape: disc; give it"),
        ({"shape": "triangles"}, "counts: is required with shape: triangles; give it"),
        (
            {"shape": "quadrangles", "counts": (1, 1), "rings": 3},
            "rings: does not apply to shape: quadrangles; leave",
        ),
        ({"shape": "triangles", "counts": (0, 2)}, "greater than or equal to 1"),
        ({"edge": 0.0}, "greater than 0"),
    ],
)
def test_what_makes_no_mesh_is_no_parameter(given: dict[str, object], said: str):
    with pytest.raises(ValidationError, match=said):
        made(**given)


@pytest.mark.parametrize("given", [{}, {"shape": "disc", "rings": 2}, {"shape": "triangles", "counts": (2, 3)}])
def test_parameters_with_every_default_written_out_are_accepted_again(given: dict[str, object]):
    params = MakePlanarMeshParams.model_validate(given)
    assert MakePlanarMeshParams.model_validate(params.model_dump(mode="json")) == params
