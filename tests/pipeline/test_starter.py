from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.config import starter
from scaffold_pipeline.stages.catalogue import config_schema


def test_new_writes_a_config_that_validates_and_its_schema(project: Project):
    answer = project.command("new", "mine")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == "wrote mine/config.yaml; next: scaffold-pipeline run mine/config.yaml\n"
    first, *rest = Path("mine/config.yaml").read_text(encoding="utf-8").splitlines()
    assert first == "# yaml-language-server: $schema=schema.json"
    assert not any("yaml-language-server" in line for line in rest)
    assert json.loads(Path("mine/schema.json").read_text(encoding="utf-8")) == config_schema()
    assert project.command("validate", "mine/config.yaml").code == 0


@pytest.mark.parametrize("name", sorted(starter.examples()))
def test_each_example_can_be_started_from(project: Project, name: str):
    assert project.command("new", "mine", "--example", name).code == 0
    answer = project.command("validate", "mine/config.yaml")
    lines = answer.err.splitlines()
    assert answer.code == 0 or all("no such file" in line for line in lines), lines


def test_an_example_brings_the_mesh_that_it_reads(project: Project):
    assert project.command("new", "mine", "--example", "volume_mesh").code == 0
    assert project.command("validate", "mine/config.yaml").code == 0
    mesh = starter.examples()["volume_mesh"].with_suffix(".msh")
    assert Path("mine/volume_mesh.msh").read_bytes() == mesh.read_bytes()


def test_an_unknown_example_suggests_the_nearest_and_writes_nothing(project: Project):
    answer = project.command("new", "mine", "--example", "minimum")
    assert answer.code == 2
    assert answer.err == "--example: no example is called 'minimum'; did you mean 'minimal'?\n"
    assert not Path("mine").exists()


@pytest.mark.parametrize("name", ["config.yaml", "schema.json"])
def test_new_overwrites_nothing(project: Project, name: str):
    Path("mine").mkdir()
    Path("mine", name).write_text("mine")
    answer = project.command("new", "mine")
    assert answer.code == 2
    assert answer.err == f"mine/{name}: exists already; choose another folder, or remove it first\n"
    assert [path.name for path in Path("mine").iterdir()] == [name]
    assert Path("mine", name).read_text() == "mine"


def test_new_where_a_file_is_in_the_way_is_a_line(project: Project):
    Path("mine").write_text("mine")
    answer = project.command("new", "mine")
    assert answer.code == 1
    assert len(answer.err.splitlines()) == 1
