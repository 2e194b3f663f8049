"""From a mesh to a solid by the command, by `run` and by calls of the stages: the same bytes."""

from __future__ import annotations

import json

import numpy as np
import pytest

import scaffold_pipeline as sp
from scaffold_pipeline.cli import app
from scaffold_pipeline.runs.store import hash_array, hash_file

CONFIG = {
    "name": "block",
    "seed": 7,
    "stages": [
        {"use": "make_mesh", "shape": "block", "cell": "tetrahedron", "counts": [2, 1, 1], "edge": 4.0},
        {"use": "extract_outer"},
        {"use": "jitter", "amount": 0.2},
        {"use": "arbf_field", "voxel_size": 0.2},
        {"use": "isosurface", "porosity": 0.6},
        {"use": "clean_surface"},
        {"use": "intersect_outer"},
        {"use": "measure", "morphometry": False, "diffusion": False},
        {"use": "write_solid", "formats": ["stl", "3mf"], "preview": False},
    ],
}


@pytest.fixture(scope="module")
def by_command(tmp_path_factory):
    folder = tmp_path_factory.mktemp("command")
    (folder / "block.yaml").write_text(json.dumps(CONFIG))  # JSON is YAML
    assert app.main(["run", str(folder / "block.yaml"), "--out", str(folder / "out"), "--quiet"]) == 0
    return sp.open_run(folder / "out")


@pytest.fixture(scope="module")
def by_call(by_command):
    return sp.run(by_command.folder.parent / "block.yaml")


def test_run_gives_the_hashes_of_the_command_for_artifacts_and_files(by_command, by_call):
    def hashes(made):
        return [(stage["label"], stage["key"], stage["output"], stage["files"]) for stage in made.record["stages"]]

    assert hashes(by_call) == hashes(by_command)
    assert not any(stage["reused"] for stage in by_call.record["stages"])
    same = ("config.yaml", "measures.json", "solid.stl", "solid.3mf")
    assert [by_call.record["files"][name] for name in same] == [by_command.record["files"][name] for name in same]
    untimed = [
        {key: value for key, value in made.metrics.items() if key not in {"seconds", "peak_memory_bytes"}}
        for made in (by_call, by_command)
    ]
    assert untimed[0] == untimed[1]
    assert hashes(sp.run(CONFIG)) == hashes(by_command)


def test_calls_of_the_stages_give_the_arrays_and_files_of_the_run(by_call, tmp_path):
    mesh = sp.stages.make_mesh(shape="block", cell="tetrahedron", counts=(2, 1, 1), edge=4.0)
    outer = sp.stages.extract_outer(mesh)
    mesh = sp.stages.jitter(mesh, amount=0.2, seed=7)
    field = sp.stages.arbf_field(mesh, outer, voxel_size=np.float64(0.2))
    porous = sp.stages.clean_surface(sp.stages.isosurface(field, outer, porosity=0.6))
    solid = sp.stages.intersect_outer(porous, outer)
    metrics = sp.stages.measure(solid, outer, porous, field, mesh, morphometry=False, diffusion=False)
    sp.stages.write_solid(solid, outer, formats=["stl"], preview=False, out=tmp_path)
    for name, value in {"mesh": mesh, "outer": outer, "porous": porous, "solid": solid}.items():
        assert hash_array(value.vertices) == hash_array(by_call[name].vertices), name
    assert hash_array(field.values) == hash_array(by_call["field"].values)
    assert field.certificate.strut_min == by_call["field"].certificate.strut_min
    assert metrics.values == by_call["metrics"].values
    assert hash_file(tmp_path / "solid.stl") == hash_file(by_call.files["solid.stl"])


def test_the_run_hands_its_results_to_trimesh_and_pyvista(by_call):
    assert by_call["solid"].to_trimesh().is_watertight
    assert by_call["solid"].to_trimesh().volume == pytest.approx(by_call.metrics["volume_mm3"], rel=1e-6)
    assert by_call["field"].to_pyvista().n_points == by_call["field"].values.size
    assert by_call["mesh"].to_pyvista().volume == pytest.approx(by_call["mesh"].volume)
    assert by_call.metrics["porosity"] == pytest.approx(0.6, abs=0.01)
