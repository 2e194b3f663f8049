"""Real meshes of small shapes by fTetWild, and what is refused before it starts or when it dies."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import tetrahedralise as module
from scaffold_stages.tetrahedralise import TetrahedraliseParams, tetrahedralise
from shapes import ball, box, outer_of, tetrahedra

BOX = outer_of(box((100.0, 0.0, -20.0), (110.0, 8.0, -14.0)))
BALL = outer_of(ball(6.0, divisions=3))


def meshed(outer: OuterShape = BOX, **given: float):
    return tetrahedralise(outer, params=TetrahedraliseParams.model_validate(given))


def require_sound(mesh: VolumeMesh, outer: OuterShape):
    assert (cell_volumes(mesh.vertices, mesh.tetrahedra, "tetrahedron") > 0.0).all()
    assert np.array_equal(np.unique(mesh.tetrahedra), np.arange(len(mesh.vertices)))
    assert mesh.volume == pytest.approx(outer.volume, abs=0.3 * mesh.facts["envelope"] * outer.area)
    assert mesh.vertices.min(axis=0) == pytest.approx(outer.bounds[0], abs=1.1 * mesh.facts["envelope"])
    assert mesh.vertices.max(axis=0) == pytest.approx(outer.bounds[1], abs=1.1 * mesh.facts["envelope"])


def die(target: float, **_: object):
    """Stand in for a mesher that dies (in a child process) where the target is small, and hangs where it is not."""
    if target < 3.0:
        os.abort()
    time.sleep(60.0)


@pytest.fixture
def deadly(monkeypatch: pytest.MonkeyPatch):
    """Let the child process run `die` instead of the mesher."""
    tests = Path(__file__).parents[1]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tests.parent), str(tests)]))
    monkeypatch.setattr(module, "run_ftetwild", die)


def give_cubes(outer: OuterShape, counts: list[int]):
    """Stand in for `_mesh`: six tetrahedra to the cube, so many cubes along each side, one count a call."""
    asked = []

    def mesh(_: OuterShape, size: object, __: float):
        asked.append(size)
        count = counts[min(len(asked), len(counts)) - 1]
        edge = outer.volume ** (1.0 / 3.0) / count
        cubes = tetrahedra((count, count, count), edge)
        return cubes.vertices, cubes.tetrahedra

    return mesh, asked


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("tetrahedralise", tetrahedralise)
    assert (declared.writes, list(declared.reads)) == ("mesh", ["outer"])


@pytest.mark.parametrize("given", [{}, {"edge_length": 2.0, "cells": 100}], ids=["neither", "both"])
def test_an_edge_length_or_a_number_of_cells_is_given(given: dict[str, float]):
    with pytest.raises(ValidationError, match="give either edge_length or cells"):
        TetrahedraliseParams.model_validate(given)


@pytest.mark.parametrize("given", [{"edge_length": 0.0}, {"edge_length": float("nan")}, {"cells": 0}, {"cells": 2.5}])
def test_a_size_that_is_none_is_no_parameter(given: dict[str, float]):
    with pytest.raises(ValidationError):
        TetrahedraliseParams.model_validate(given)


@pytest.mark.parametrize(("outer", "edge"), [(BOX, 2.5), (BALL, 3.0)], ids=["box", "ball"])
def test_the_mean_edge_is_the_one_asked_for(outer: OuterShape, edge: float):
    mesh = meshed(outer, edge_length=edge)
    require_sound(mesh, outer)
    summary = mesh.summary()
    assert summary["edge_length_mean"] == pytest.approx(edge, rel=0.15)
    assert summary["edge_length_p5"] < edge < summary["edge_length_p95"]
    assert summary["envelope"] >= edge / 10.0


def test_the_number_of_cells_is_the_one_asked_for():
    mesh = meshed(cells=400)
    require_sound(mesh, BOX)
    assert len(mesh.tetrahedra) == pytest.approx(400, rel=0.15)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"edge_length": 0.05},
            r"^edge_length 0.05 mm .* must be from 0.212 to 7.07 mm for a shape with a diagonal of 14.14 mm",
        ),
        ({"edge_length": 7.5}, r"^edge_length 7.5 mm .* must be from"),
        ({"cells": 10_000_000}, r"^edge_length 0.0\d+ mm \(given, or computed from cells\): must be from"),
        ({"edge_length": 2.0, "envelope": 1.0}, r"^envelope 1 mm: must be from 0.00283 to 0.707 mm"),
        ({"edge_length": 2.0, "envelope": 1e-4}, r"^envelope 0.0001 mm: must be from"),
    ],
)
def test_what_the_mesher_would_not_survive_is_refused_before_it_starts(
    given: dict[str, float], said: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module, "call_in_child", None)
    with pytest.raises(StageError, match=said) as failure:
        meshed(**given)
    assert "\n" not in str(failure.value)


@pytest.mark.usefixtures("deadly")
def test_a_mesher_that_dies_is_one_line():
    with pytest.raises(
        StageError, match=r"ended by SIGABRT.*; outer shape of 12 triangles.*; after a crash or a time-out raise"
    ) as failure:
        meshed(edge_length=2.5)
    assert "\n" not in str(failure.value)


@pytest.mark.usefixtures("deadly")
def test_a_mesher_that_hangs_is_one_line():
    start = time.monotonic()
    with pytest.raises(StageError, match=r"^gave no result within 3 s; outer shape of 12 triangles"):
        meshed(edge_length=3.5, time_limit=3.0)
    assert time.monotonic() - start < 30.0


def test_a_shape_without_room_for_cells_is_one_line():
    plate = outer_of(box((0.0, 0.0, 0.0), (10.0, 10.0, 1e-4)))
    with pytest.raises(StageError) as failure:
        meshed(plate, edge_length=2.0)
    assert "\n" not in str(failure.value)


def test_an_attempt_that_misses_corrects_the_next(monkeypatch: pytest.MonkeyPatch):
    edge = BOX.volume ** (1.0 / 3.0) / 4
    mesh, asked = give_cubes(BOX, [8, 2, 3])
    monkeypatch.setattr(module, "_mesh", mesh)
    result = meshed(edge_length=edge * 1.75)  # the mean edge is about 1.3 sides of a cube
    assert result.facts["attempts"] == len(asked) == 3
    assert asked[1].target > 1.5 * asked[0].target  # cells came out too small
    assert asked[1].envelope == pytest.approx(module.GREATEST_GROWTH * asked[0].envelope)
    assert asked[0].target < asked[2].target < asked[1].target  # too large
    assert asked[0].envelope < asked[2].envelope < asked[1].envelope


def test_an_envelope_that_is_given_stays(monkeypatch: pytest.MonkeyPatch):
    mesh, asked = give_cubes(BOX, [8, 4])
    monkeypatch.setattr(module, "_mesh", mesh)
    meshed(cells=384, envelope=0.1)
    assert [size.envelope for size in asked] == [0.1, 0.1]


def test_a_number_of_cells_a_third_off_is_not_met(monkeypatch: pytest.MonkeyPatch):
    mesh, asked = give_cubes(BOX, [4])  # 384 cells: their mean edge is within 15 % of that of 280
    monkeypatch.setattr(module, "_mesh", mesh)
    with pytest.raises(
        StageError, match=r"^cells 280: 8 attempts gave 384 cells, .*, none within 15 %; the"
    ) as failure:
        meshed(cells=280)
    assert len(asked) == module.ATTEMPTS
    assert "\n" not in str(failure.value)


def test_a_shape_thinner_than_the_edge_is_named_as_the_reason(monkeypatch: pytest.MonkeyPatch):
    plate = outer_of(box((0.0, 0.0, 0.0), (30.0, 30.0, 1.0)))
    mesh, _ = give_cubes(plate, [4])
    monkeypatch.setattr(module, "_mesh", mesh)
    with pytest.raises(
        StageError, match=r"within 15 %; the shape is about 0\.938 mm thick, less than an edge of 7\.45"
    ):
        meshed(plate, cells=20)


def test_cells_that_leave_a_part_of_the_shape_empty_are_refused(monkeypatch: pytest.MonkeyPatch):
    half = outer_of(box((100.0, 0.0, -20.0), (104.0, 8.0, -14.0)))
    mesh, _ = give_cubes(half, [3])
    monkeypatch.setattr(module, "_mesh", mesh)
    with pytest.raises(
        StageError, match=r"^volume of the cells: must be that of the outer shape, 480 mm\^3, within .*, got 192; check"
    ):
        meshed(cells=162)
