"""A third party adds a stage, a field, a measure and a file format by one module each, with public names alone."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pipeline.conftest import PLUGIN
from pipeline.workplace import Project
from scaffold_pipeline.artifacts import OuterShape, Solid
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.runs.runner import execute
from scaffold_pipeline.stages.registry import load_stage
from scaffold_pipeline.testing import check_stage
from shapes import ball, box, outer_of, tetrahedra

PAGE = Path(__file__).parents[2] / "docs" / "plugins.md"
MODULES = sorted((PLUGIN / "bone_plugin").glob("[!_]*.py"))

OUTER = outer_of(box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)))


def private_names(source: str) -> Iterator[str]:
    """Yield the private names that a module imports or reaches for."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            names = [*str(node.module).split("."), *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [part for alias in node.names for part in alias.name.split(".")]
        else:
            names = [node.attr] if isinstance(node, ast.Attribute) else []
        yield from (name for name in names if name.startswith("_") and not name.endswith("__"))


@pytest.mark.parametrize(
    "source", ["from a._b import c", "from a import _c", "import a._b", "a._c", "def f(x):\n    return x.y._z()"]
)
def test_private_names_are_seen(source: str):
    assert len(list(private_names(source))) == 1


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.stem)
def test_a_plug_in_needs_no_private_name(module: Path):
    assert list(private_names(module.read_text(encoding="utf-8"))) == []


def test_the_page_on_plug_ins_shows_the_modules_as_they_are():
    shown = re.findall(
        r"<!-- bone_plugin/(\w+\.py) -->\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    assert dict(shown) == {path.name: path.read_text(encoding="utf-8") for path in MODULES}
    assert len(shown) == 4


@pytest.mark.usefixtures("project")
def test_the_page_s_example_of_a_test_passes():
    (example,) = re.findall(r"```python\n(from [^`]*def test_mirror[^`]*)```", PAGE.read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    exec(example, names)  # noqa: S102 - as a reader would run it
    names["test_mirror_outer_keeps_the_contract"]()


CHAIN = """
    stages:
      - use: make_mesh
        shape: block
        counts: [2, 2, 1]
        edge: 2.0
      - use: extract_outer
      - use: mirror_outer
      - use: distance_field
        voxel_size: 0.2
      - use: isosurface
        porosity: 0.5
      - use: intersect_outer
      - use: measure_layers
        voxel_size: 0.1
      - use: write_off
    """


def test_a_chain_runs_through_all_four(project: Project):
    result = execute(project.plan(CHAIN), Path("out"))
    assert result.metrics is not None
    (curve,) = result.metrics.curves
    assert result.metrics.summary()["quality"] == "not measured"
    assert float(np.mean(curve.y)) == pytest.approx(0.5, abs=0.01)
    assert list(result.files) == ["solid.off"]
    summaries = {step.label: step.summary for step in result.steps}
    assert summaries["distance_field"]["channel_max"] < 0.0 < summaries["distance_field"]["strut_min"]  # type: ignore[operator]
    assert summaries["write_off"]["off_volume_mm3"] == pytest.approx(16.0, rel=1e-3)
    assert result.steps[-1].libraries.keys() >= {"numpy", "scaffold-pipeline", "trimesh", "vtk"}


def test_what_the_third_party_wrote_is_told_by_the_page_too(project: Project):
    assert project.command("run", project.write(CHAIN), "--quiet").code == 0
    out = project.folder / "runs" / "config"
    assert json.loads((out / "metrics.json").read_text())["porosity_along_z_least"] > 0.0
    assert "<td>Least porosity along z</td>" in (out / "report.html").read_text(encoding="utf-8")
    assert trimesh.load_mesh(out / "solid.off").is_watertight


@pytest.mark.usefixtures("project")
def test_the_stages_keep_the_contract_when_they_are_run():
    mesh = tetrahedra((2, 2, 2), edge=2.0)
    solid = Solid(*ball(1.5, centre=(2.0, 2.0, 2.0)))
    check_stage("mirror_outer", {"outer": OUTER}, {"axis": "y"})
    check_stage("distance_field", {"mesh": mesh, "outer": OUTER}, {"voxel_size": 0.5, "samples": 9})
    check_stage("measure_layers", {"solid": solid, "outer": OUTER}, {"voxel_size": 0.2})
    rounded = Solid(solid.vertices.astype(np.float32), solid.faces)
    check_stage("write_off", {"solid": rounded})


@pytest.mark.usefixtures("project")
def test_a_mirrored_shape_is_its_own_after_two_turns():
    stage = load_stage("mirror_outer")
    bone = OuterShape(*ball(2.0, centre=(5.0, 1.0, 0.0)))
    once = stage.function(bone, params=stage.params())
    twice = stage.function(once, params=stage.params())
    assert once.volume == pytest.approx(bone.volume)  # type: ignore[attr-defined]
    assert np.allclose(twice.vertices, bone.vertices)  # type: ignore[attr-defined]


@pytest.mark.usefixtures("project")
def test_a_file_of_the_third_party_is_refused_where_it_is_not_the_solid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    stage = load_stage("write_off")
    vertices, faces = ball(1.5)
    rounded = Solid(vertices.astype(np.float32), faces)
    module = stage.function.__globals__
    monkeypatch.setitem(module, "rows", lambda row, table: (row % tuple(entry) for entry in table[::-1].tolist()))
    with pytest.raises(StageError, match=r"solid.off: read by trimesh: .*; no file was kept"):
        stage.function(rounded, params=stage.params(), out=tmp_path)
