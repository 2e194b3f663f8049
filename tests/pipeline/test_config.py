from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import Plan, make_plan
from scaffold_pipeline.errors import ConfigError

SOUND = """
    name: sound
    seed: 7
    stages:
      - use: make_points
        count: 3
      - use: scatter_points
        amount: 0.2
    """


def plan_of(path: Path, *settings: str) -> Plan:
    return make_plan(read_draft(path, settings))


def faults_of(path: Path, *settings: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        plan_of(path, *settings)
    return str(caught.value).splitlines()


def test_a_sound_config_becomes_a_plan(project: Project):
    plan = plan_of(project.write(SOUND))
    assert (plan.name, plan.seed, plan.labels) == ("sound", 7, ["make_points", "scatter_points"])
    assert plan.steps[1].params.model_dump() == {"amount": 0.2}


def test_all_faults_of_config_and_plan_are_found_at_once_in_the_order_of_the_file(project: Project):
    config = project.write(
        """
        nmae: x
        seed: -1
        stages:
          - use: make_points
            count: 0
            count: 2
            stepp: 1.0
          - use: make_points
            step: wide
          - use: make_point
          - use: grow_points
            from: {point: points}
          - count: 3
          - use: draw_points
            as: Big Picture
        """
    )
    assert faults_of(config) == [
        "config.yaml:1:1: unknown key 'nmae'; did you mean 'name'?",
        "config.yaml:2:1: seed: must be a whole number from 0 to 2^63 - 1, got -1",
        "config.yaml:5:5: stages.0 (make_points): count: must be greater than or equal to 1, got 0",
        "config.yaml:6:5: 'count' is given twice, first on line 5; keep one",
        "config.yaml:7:5: stages.0 (make_points): unknown parameter 'stepp'; did you mean 'step'?",
        (
            "config.yaml:8:5: stages.1 (make_points): writes slot 'points', which stages.0 (make_points) writes too; "
            "rename it with `as: NAME`"
        ),
        (
            "config.yaml:9:5: stages.1 (make_points): step: must be a valid number, unable to parse string as a "
            "number, got 'wide'"
        ),
        "config.yaml:10:5: stages.2 (make_point): no stage is called 'make_point'; did you mean 'make_points'?",
        "config.yaml:12:5: stages.3 (grow_points): from: the stage has no input 'point'; did you mean 'points'?",
        "config.yaml:13:5: stages.4: must be a mapping with `use: STAGE`, got {'count': 3}",
        (
            "config.yaml:15:5: stages.5 (draw_points): as: must be lower-case letters, digits and underscores, "
            "got 'Big Picture'"
        ),
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "c.yaml:1:1: a config is a mapping with the keys name, seed and stages"),
        ("# nothing\n", "c.yaml:1:1: a config is a mapping with the keys name, seed and stages"),
        ("- use: make_points\n", "c.yaml:1:1: a config is a mapping with the keys name, seed and stages"),
        ("just text\n", "c.yaml:1:1: a config is a mapping with the keys name, seed and stages"),
        ("name: x\n", "c.yaml:1:1: stages: must be a list of at least one stage, each with `use: NAME`"),
        ("stages: []\n", "c.yaml:1:1: stages: must be a list of at least one stage, each with `use: NAME`"),
        ("stages: 5\n", "c.yaml:1:1: stages: must be a list of at least one stage, each with `use: NAME`"),
        ("stages:\n  - make_points\n", "c.yaml:2:5: stages.0: must be a mapping with `use: STAGE`, got 'make_points'"),
        ("stages:\n  - use: 3\n", "c.yaml:2:5: stages.0: must be a mapping with `use: STAGE`, got {'use': 3}"),
        (
            "stages:\n  - {use: make_points, from: 3}\n",
            "c.yaml:2:24: stages.0 (make_points): from: must map the stage's inputs to slots, got 3",
        ),
        (
            "stages:\n  - {use: make_points, count: 2.5}\n",
            (
                "c.yaml:2:24: stages.0 (make_points): count: must be a valid integer, got a number with a fractional "
                "part, got 2.5"
            ),
        ),
        (
            "stages:\n  - {use: make_points, step: .inf}\n",
            "c.yaml:2:24: stages.0 (make_points): step: must be a finite number, got inf",
        ),
        ("stages:\n  - use: read_points\n", "c.yaml:2:5: stages.0 (read_points): path: is required"),
        ("1: x\nstages: [{use: make_points}]\n", "c.yaml:1:1: unknown key 1; known: name, seed, stages"),
        (
            "name: a/b\nstages: [{use: make_points}]\n",
            "c.yaml:1:1: name: must be letters, digits, dots, dashes and underscores, as it names a folder, got 'a/b'",
        ),
        (
            "name: ..\nstages: [{use: make_points}]\n",
            "c.yaml:1:1: name: must be letters, digits, dots, dashes and underscores, as it names a folder, got '..'",
        ),
        (
            "seed: true\nstages: [{use: make_points}]\n",
            "c.yaml:1:1: seed: must be a whole number from 0 to 2^63 - 1, got True",
        ),
        (
            "seed: 9223372036854775808\nstages: [{use: make_points}]\n",
            "c.yaml:1:1: seed: must be a whole number from 0 to 2^63 - 1, got 9223372036854775808",
        ),
    ],
)
def test_a_fault_names_place_rule_value_and_remedy(project: Project, text: str, fault: str):
    assert faults_of(project.write(text, "c.yaml")) == [fault]


def test_a_file_name_that_cannot_name_a_run_needs_a_name_beside_it(project: Project):
    (fault,) = faults_of(project.write("stages: [{use: make_points}]", "my config.yaml"))
    assert fault.startswith("my config.yaml:1:1: name: must be letters")
    assert plan_of(project.write("name: mine\nstages: [{use: make_points}]", "my config.yaml")).name == "mine"


def test_a_directory_is_no_config(project: Project):
    assert faults_of(project.folder) == [f"{project.folder}: a config is a YAML file, but this is a directory"]


@pytest.mark.usefixtures("project")
def test_a_missing_config_says_how_to_get_one():
    assert faults_of(Path("no.yaml")) == ["no.yaml: no such file; `scaffold-pipeline new DIR` writes one"]


@pytest.mark.usefixtures("project")
def test_a_binary_file_is_no_config():
    Path("bone.stl").write_bytes(b"solid \xff\xfe\x00\x80" * 20)
    assert faults_of(Path("bone.stl")) == ["bone.stl: not a text file in UTF-8, so not a config"]


@pytest.mark.usefixtures("project")
def test_a_byte_order_mark_is_no_part_of_the_first_key():
    Path("config.yaml").write_bytes(b"\xef\xbb\xbfname: x\r\nstages:\r\n  - use: make_points\r\n")
    assert plan_of(Path("config.yaml")).name == "x"


def test_a_missing_input_file_is_a_fault_on_its_line(project: Project):
    config = project.write("stages:\n  - use: read_points\n    path: no.txt\n", "sub/config.yaml")
    missing = (project.folder / "sub" / "no.txt").resolve()
    assert faults_of(config) == [
        (
            f"sub/config.yaml:3:5: stages.0 (read_points): path: no such file: {missing}; "
            "paths in a config are relative to the config"
        )
    ]


@pytest.mark.parametrize(
    ("path", "rule"),
    [
        (".", "must be a file, but"),
        ("x" * 5000, "cannot be a file's path"),
        ("~no-such-user-here/a", "cannot be a file's path"),
    ],
)
def test_a_path_that_can_be_no_file_is_a_fault(project: Project, path: str, rule: str):
    config = project.write(f"stages:\n  - use: read_points\n    path: {path}\n")
    (fault,) = faults_of(config)
    assert fault.startswith(f"config.yaml:3:5: stages.0 (read_points): path: {rule}")


def test_a_file_that_may_not_be_read_is_a_fault(project: Project, monkeypatch: pytest.MonkeyPatch):
    project.write("1.0", "points.txt")
    config = project.write("stages:\n  - use: read_points\n    path: points.txt\n")
    assert plan_of(config)
    monkeypatch.setattr("os.access", lambda *_: False)
    (fault,) = faults_of(config)
    assert "cannot be read" in fault


def test_a_path_in_a_config_is_relative_to_the_config(project: Project):
    points = project.write("1.0", "sub/points.txt")
    config = project.write("stages:\n  - use: read_points\n    path: points.txt\n", "sub/config.yaml")
    assert plan_of(config).steps[0].params.model_dump()["path"] == points.resolve()


def test_a_path_in_a_setting_is_relative_to_the_current_folder(project: Project):
    points = project.write("1.0", "points.txt")
    config = project.write("stages:\n  - use: read_points\n    path: no.txt\n", "sub/config.yaml")
    plan = plan_of(config, "read_points.path=points.txt")
    assert plan.steps[0].params.model_dump()["path"] == points.resolve()


@pytest.mark.parametrize(
    ("setting", "step", "name", "value"),
    [
        ("make_points.count=9", 0, "count", 9),
        ("make_points.count = 9", 0, "count", 9),
        ("stages.1.amount=0.4", 1, "amount", 0.4),
        ("wide.factor=3", 2, "factor", 3.0),
        ("write_points.names=[a.txt, b.txt]", 3, "names", ("a.txt", "b.txt")),
    ],
)
def test_a_setting_overrides_a_parameter(project: Project, setting: str, step: int, name: str, value: object):
    config = project.write(
        """
        stages:
          - use: make_points
          - use: scatter_points
          - use: grow_points
            as: wide
          - use: write_points
        """
    )
    assert getattr(plan_of(config, setting).steps[step].params, name) == value


def test_settings_override_name_and_seed(project: Project):
    plan = plan_of(project.write(SOUND), "name=2024", "seed=3")
    assert (plan.name, plan.seed) == ("2024", 3)


def test_a_later_setting_wins(project: Project):
    plan = plan_of(project.write(SOUND), "make_points.count=4", "make_points.count=5")
    assert plan.steps[0].params.model_dump()["count"] == 5


def test_a_setting_for_one_alias_leaves_the_other_alone(project: Project):
    config = project.write("stages:\n  - use: make_points\n  - &move {use: scatter_points, amount: 0.1}\n  - *move\n")
    plan = plan_of(config, "stages.2.amount=0.3")
    assert [step.params.model_dump()["amount"] for step in plan.steps[1:]] == [0.1, 0.3]


@pytest.mark.parametrize(
    ("setting", "fault"),
    [
        ("count", "must have the form stage.key=value"),
        ("seed", "must have the form stage.key=value"),
        ("make_points=3", "must have the form stage.key=value"),
        ("=3", "must have the form stage.key=value"),
        ("make_pionts.count=3", "the config has no stage 'make_pionts'; did you mean 'make_points'?"),
        ("stages.7.count=3", "the config has no stage 'stages.7'; known: make_points, scatter_points"),
        ("stages.x.count=3", "the config has no stage 'stages.x'; known: make_points, scatter_points"),
        ("make_points.cuont=3", "stages.0 (make_points): unknown parameter 'cuont'; did you mean 'count'?"),
        ("make_points.count=0", "stages.0 (make_points): count: must be greater than or equal to 1, got 0"),
        ("make_points.count.x=0", "stages.0.count is a single value, so 'x' cannot be set in it"),
        ("make_points.count.x.y=0", "stages.0.count is a single value, so 'x' cannot be set in it"),
        (
            "make_points.use=make_point",
            "stages.0 (make_point): no stage is called 'make_point'; did you mean 'make_points'?",
        ),
        ("seed=x", "seed: must be a whole number from 0 to 2^63 - 1, got 'x'"),
    ],
)
def test_a_fault_of_a_setting_names_the_setting(project: Project, setting: str, fault: str):
    assert faults_of(project.write(SOUND), setting) == [f"--set {setting}: {fault}"]


def test_a_missing_file_given_by_a_setting_names_the_setting(project: Project):
    config = project.write("stages:\n  - use: read_points\n    path: no.txt\n")
    (fault,) = faults_of(config, "read_points.path=nor_this.txt")
    assert fault.startswith("--set read_points.path=nor_this.txt: stages.0 (read_points): path: no such file:")


def test_a_setting_for_a_stage_that_stands_twice_says_how_to_choose(project: Project):
    config = project.write("stages:\n  - use: make_points\n  - use: scatter_points\n  - use: scatter_points\n")
    assert faults_of(config, "scatter_points.amount=0.3") == [
        ("--set scatter_points.amount=0.3: 'scatter_points' occurs 2 times; write stages.1.amount for the first")
    ]


@pytest.mark.parametrize("text", ["stages: 5", "stages: {a: 1}", "stages: [5, {use: [a]}, [1]]", "name: x"])
def test_a_setting_for_a_config_that_is_none_adds_a_fault_and_no_crash(project: Project, text: str):
    faults = faults_of(project.write(text), "make_points.count=3")
    assert any(fault.startswith("--set make_points.count=3: the config has no stage") for fault in faults)
    assert len(faults) > 1


def test_faults_of_settings_come_with_those_of_the_file(project: Project):
    faults = faults_of(project.write("nmae: x\nstages: [{use: make_points}]"), "bad", "make_points.count=0")
    assert [fault.partition(":")[0] for fault in faults] == ["--set bad", "--set make_points.count=0", "config.yaml"]
