from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.config.starter import examples
from scaffold_pipeline.config.yaml_source import parse
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.stages.catalogue import config_schema, describe, markdown_table
from scaffold_pipeline.stages.contract import Stage
from scaffold_pipeline.stages.registry import installed_stages, load_stage

CONFIGS = sorted(Path(__file__).parents[2].glob("configs/*.yaml"))


def stage_schema(name: str) -> dict[str, Any]:
    items: list[dict[str, Any]] = config_schema()["properties"]["stages"]["items"]["oneOf"]
    (found,) = (schema for schema in items if schema["properties"]["use"] == {"const": name})
    return found


@pytest.mark.usefixtures("project")
def test_a_stage_that_cannot_be_loaded_is_listed_as_its_error():
    listed = list(installed_stages())
    assert {stage.name for stage in listed if isinstance(stage, Stage)} >= {"make_points", "load_surface"}
    (broken,) = (stage for stage in listed if isinstance(stage, StageDefinitionError))
    assert "broken_stage" in str(broken)


@pytest.mark.usefixtures("project")
def test_a_description_tells_slots_types_units_defaults_and_meaning():
    assert describe(load_stage("grow_points")).splitlines() == [
        "grow_points",
        "  Multiply the coordinates of points, with a warning where they reach far.",
        "  reads: points",
        "  writes: points",
        "  parameters:",
        "    factor: number in times, default 2.0",
        "        What coordinates are multiplied by.",
        "    limit: number in mm, default 100.0, or as count_points.limit",
        "        Reach from which on a warning is given.",
    ]
    assert "  reads: points, picture (optional)" in describe(load_stage("count_points"))
    assert "    path: path, required" in describe(load_stage("read_points"))
    assert "    how: stage_error | error | memory" in describe(load_stage("fail"))


def test_a_default_that_is_made_is_told_as_what_it_is(install: Callable[..., None]):
    install(
        "factory_package",
        """
        from pydantic import Field
        from scaffold_pipeline.stages.contract import Millimetres, Params, stage
        from scaffold_pipeline.artifacts import Metrics

        class Factory(Params):
            names: list[str] = Field(default_factory=lambda: ["a"])
            "Names."
            length: Millimetres | None = None
            "A length."

        @stage(writes="metrics", version=1)
        def factory(*, params: Factory) -> Metrics:
            "Do."
            return Metrics({})
        """,
        "factory",
    )
    text = describe(load_stage("factory"))
    assert "names: list of string, default ['a']" in text
    assert "length: number in mm, default None" in text


@pytest.mark.usefixtures("project")
def test_the_table_has_a_row_for_each_sound_stage():
    rows = markdown_table().splitlines()[2:]
    names = [row.split("`")[1] for row in rows]
    assert names == sorted(names)
    assert {"make_points", "load_surface", "write_solid"} <= set(names)
    assert "broken_stage" not in names
    row = "| `draw_points` | Draw points. | points | picture | - |"
    assert row in rows


@pytest.mark.usefixtures("project")
def test_the_schema_has_each_stage_with_its_parameters_and_their_units():
    schema = stage_schema("grow_points")
    assert set(schema["properties"]) == {"use", "as", "from", "factor", "limit"}
    assert schema["required"] == ["use"]
    assert schema["additionalProperties"] is False
    assert schema["properties"]["factor"]["exclusiveMinimum"] == 0.0
    assert schema["properties"]["limit"]["description"] == "Reach from which on a warning is given. [mm]"
    assert stage_schema("read_points")["required"] == ["use", "path"]
    assert json.loads(json.dumps(config_schema())) == config_schema()


@pytest.mark.usefixtures("project")
def test_every_installed_stage_is_in_the_schema_with_all_its_parameters():
    items = config_schema()["properties"]["stages"]["items"]["oneOf"]
    told = {schema["properties"]["use"]["const"]: set(schema["properties"]) for schema in items}
    sound = {stage.name: stage for stage in installed_stages() if isinstance(stage, Stage)}
    assert set(told) == set(sound)
    assert all(set(stage.params.model_fields) <= told[name] for name, stage in sound.items())


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_shipped_config_keeps_the_schema(path: Path):
    schema = config_schema()
    values = parse(path.read_text(encoding="utf-8"), path.name).values
    assert set(values) <= set(schema["properties"])
    for entry in values["stages"]:
        of_stage = stage_schema(entry["use"])
        assert set(of_stage["required"]) <= set(entry) <= set(of_stage["properties"])


def test_shipped_configs_keep_the_schema_by_an_independent_reader():
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    validator = jsonschema.Draft202012Validator(config_schema())
    validator.check_schema(config_schema())
    for path in examples().values():
        validator.validate(parse(path.read_text(encoding="utf-8"), path.name).values)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate({"stages": [{"use": "make_shape", "hieght": 3.0}]})


def test_there_are_configs_to_check(project: Project):
    assert {"femoral_head", "minimal", "heel"} <= {path.stem for path in CONFIGS}
    assert set(examples()) == {path.stem for path in CONFIGS}
    assert project.command("stages").code == 0
