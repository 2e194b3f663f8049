"""Every stage keeps the contract, and shows it by being run on something small."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.stages.registry import load_stage, stage_names
from scaffold_pipeline.testing import check_stage

MSH = Path(__file__).parents[2] / "configs" / "volume_mesh.msh"

MADE_BY: dict[str, tuple[str, dict[str, Any]]] = {
    "ball": ("make_shape", {"shape": "ball", "height": 8.0, "facet": 2.0}),
    "mesh": ("make_mesh", {"shape": "cube", "edge": 2.0}),
    "outer": ("extract_outer", {}),
    "field": ("arbf_field", {"voxel_size": 0.2}),
    "porous": ("isosurface", {"porosity": 0.6}),
    "solid": ("intersect_outer", {}),
    "metrics": ("measure", {"voxel_size": 0.2}),
    "tiles": ("make_planar_mesh", {"shape": "quadrangles", "counts": [2, 2], "edge": 2.0}),
    "planar_field": ("arbf_field", {"voxel_size": 0.1}),
    "contour": ("contour", {"porosity": 0.4}),
    "plate": ("extrude", {"height": 1.0}),
}
"""What stages read, and how it is made: a cube of eight hexahedra with all that follows, and a square of four tiles."""

READ_BY: dict[str, dict[str, str]] = {
    "planar_field": {"mesh": "tiles"},
    "contour": {"mesh": "tiles", "field": "planar_field"},
    "hexahedralise": {"outer": "ball"},
    "jitter_planar": {"mesh": "tiles"},
    "measure_plate": {"solid": "plate", "field": "planar_field", "mesh": "tiles"},
    "tetrahedralise": {"outer": "ball"},
}
"""What a stage, or a product, reads where it is not called as the argument is."""

OTHERS: dict[str, dict[str, Any]] = {
    "clean_surface": {"smoothing": 2},
    "draw_mesh": {},
    "draw_solid": {},
    "hexahedralise": {"cell_size": 3.0},
    "jitter": {},
    "jitter_planar": {},
    "load_volume_mesh": {"path": MSH, "units": "mm"},
    "measure_field": {"porosity": 0.6},
    "measure_plate": {},
    "mesh_solid": {"edge_length": 1.0},
    "rbf_field": {"voxel_size": 0.2},
    "tetrahedralise": {"edge_length": 3.0},
    "tpms_field": {"surface": "gyroid", "cell_size": 2.0, "voxel_size": 0.2},
    "write_contour": {"pixels": 100},
    "write_field": {},
    "write_solid": {"formats": ["stl", "3mf", "obj", "ply", "glb"], "void": True},
}

OPTIONAL = {"mesh", "outer", "metrics"}
"""Slots that are given where they may be."""

CASES = [
    *((product, name, params) for product, (name, params) in MADE_BY.items()),
    *((name, name, params) for name, params in OTHERS.items()),
]


def inputs_of(place: str, name: str) -> dict[str, Artifact]:
    renamed = READ_BY.get(place, {})
    planar = {"planar_field", "contour", "measure_plate"}
    reads = load_stage(name).reads.items()
    names = [
        argument for argument, read in reads if not read.optional or (argument in OPTIONAL and place not in planar)
    ]
    return {argument: made(renamed.get(argument, argument)) for argument in {*names, *renamed}}


@cache
def made(product: str) -> Artifact:
    name, params = MADE_BY[product]
    stage = load_stage(name)
    return stage.function(**inputs_of(product, name), params=stage.params.model_validate(params))


@pytest.mark.parametrize(("place", "name", "params"), CASES, ids=[place for place, _, _ in CASES])
def test_the_stage_keeps_the_contract_when_it_is_run(place: str, name: str, params: dict[str, Any]):
    check_stage(name, inputs_of(place, name), params, seed=7)


@pytest.mark.parametrize("name", ["inspect_surface", "load_surface"])
def test_the_stage_keeps_the_contract_when_it_reads_a_file(name: str, tmp_path: Path):
    write = load_stage("write_solid")
    write.function(made("solid"), params=write.params.model_validate({"preview": False}), out=tmp_path)
    check_stage(name, params={"path": tmp_path / "solid.stl", "units": "mm"})


def test_all_stages_are_run():
    run = {name for _, name, _ in CASES} | {"inspect_surface", "load_surface"}
    assert run == set(stage_names())


def test_what_ftetwild_gives_is_known_not_to_be_repeated():
    unrepeatable = {name for name in stage_names() if not load_stage(name).is_repeatable}
    assert unrepeatable == {name for name in stage_names() if "pytetwild" in load_stage(name).libraries} != set()
