from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.errors import ConfigError
from scaffold_pipeline.studies.file import Study, derived_seed, is_study, read_study
from scaffold_pipeline.studies.variations import _linspace, _range

BASE = """
    seed: 7
    stages:
      - use: make_points
      - use: scatter_points
      - use: grow_points
        limit: 9.0
      - use: count_points
    """


def study(project: Project, text: str, *settings: str, may_be_large: bool = False) -> Study:
    project.write(BASE, "base.yaml")
    return read_study(project.write(text, "study.yaml"), settings, may_be_large=may_be_large)


def faults_of(project: Project, text: str, *settings: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        study(project, text, *settings)
    return str(caught.value).splitlines()


def values(study: Study) -> list[tuple[object, ...]]:
    return [tuple(point.varied.values()) for point in study.points]


# What varies


def test_a_grid_is_every_value_with_every_other(project: Project):
    grid = study(project, "base: base.yaml\nvary: {make_points.count: [2, 3], scatter_points.amount: [0.1, 0.2]}\n")
    assert values(grid) == [(2, 0.1), (2, 0.2), (3, 0.1), (3, 0.2)]
    assert grid.columns == ("make_points.count", "scatter_points.amount")
    assert [point.name for point in grid.points] == [
        "count-2_amount-0.1",
        "count-2_amount-0.2",
        "count-3_amount-0.1",
        "count-3_amount-0.2",
    ]
    assert grid.name == "study"


def test_a_zip_goes_through_all_lists_at_once(project: Project):
    text = "base: base.yaml\nmode: zip\nvary: {make_points.count: [2, 3], scatter_points.amount: [0.1, 0.2]}\n"
    assert values(study(project, text)) == [(2, 0.1), (3, 0.2)]


def test_a_list_names_the_points_themselves(project: Project):
    text = """
        base: base.yaml
        mode: list
        vary:
          - {make_points.count: 2}
          - {make_points.count: 3, grow_points.factor: 5.0}
        """
    found = study(project, text)
    assert values(found) == [(2,), (3, 5.0)]
    assert found.columns == ("make_points.count", "grow_points.factor")
    assert [point.name for point in found.points] == ["count-2", "count-3_factor-5.0"]


def test_each_point_is_the_base_with_its_own_values(project: Project):
    found = study(project, "base: base.yaml\nvary: {make_points.count: [2, 3]}\n", "grow_points.factor=4")
    for point, count in zip(found.points, (2, 3), strict=True):
        plan = point.plan()
        made, _, grown, _ = plan.resolved()["stages"]
        assert (plan.name, plan.seed, made["count"], grown["factor"], grown["limit"]) == (point.name, 7, count, 4, 9.0)


def test_a_parameter_is_named_as_for_set(project: Project):
    text = "base: base.yaml\nvary: {stages.0.count: [2, 3], seed: [1, 2]}\n"
    found = study(project, text)
    assert [(point.plan().seed, point.plan().resolved()["stages"][0]["count"]) for point in found.points] == [
        (1, 2),
        (2, 2),
        (1, 3),
        (2, 3),
    ]
    assert found.points[0].name == "count-2_seed-1"


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ((1, 7, 2), [1, 3, 5, 7]),
        ((1, 8, 2), [1, 3, 5, 7]),
        ((0.1, 0.5, 0.1), [0.1, 0.2, 0.3, 0.4, 0.5]),
        ((0.5, 0.1, -0.2), [0.5, 0.3, 0.1]),
        ((1, 2, 0.5), [1.0, 1.5, 2.0]),
        ((3, 3, 1), [3]),
    ],
)
def test_a_range_ends_with_the_stop_that_whole_steps_meet(numbers: tuple[float, ...], expected: list[float]):
    count, value = _range(*numbers)
    got = [value(index) for index in range(count)]
    assert got == expected
    assert [type(number) for number in got] == [type(number) for number in expected]


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [((0.5, 0.8, 4), [0.5, 0.6, 0.7, 0.8]), ((1, 2, 3), [1.0, 1.5, 2.0]), ((100, 400, 4), [100, 200, 300, 400])],
)
def test_a_linspace_has_both_ends(numbers: tuple[float, ...], expected: list[float]):
    count, value = _linspace(*numbers)
    got = [value(index) for index in range(count)]
    assert got == expected
    assert [type(number) for number in got] == [type(number) for number in expected]


def test_values_of_all_points_stand_in_the_study_or_its_command(project: Project):
    fixed = "set: {grow_points.factor: 4.0, scatter_points.amount: 0.3}"
    text = f"base: base.yaml\n{fixed}\nvary: {{make_points.count: [2, 3]}}\n"
    found = study(project, text, "grow_points.factor=5")
    for point in found.points:
        _, scattered, grown, _ = point.plan().resolved()["stages"]
        assert (scattered["amount"], grown["factor"]) == (0.3, 5)
    assert found.columns == ("make_points.count",)


def test_ranges_stand_for_lists(project: Project):
    text = """
        base: base.yaml
        vary:
          make_points.count: {range: [2, 6, 2]}
          scatter_points.amount: {linspace: [0.1, 0.3, 3]}
        """
    assert values(study(project, text))[::4] == [(2, 0.1), (4, 0.2), (6, 0.3)]


# Seeds


def test_repeats_have_seeds_that_follow_from_the_base_s(project: Project):
    found = study(project, "base: base.yaml\nrepeats: 3\nvary: {make_points.count: [2, 3]}\n")
    seeds = [point.plan().seed for point in found.points]
    assert seeds == [7, derived_seed(7, 2), derived_seed(7, 3)] * 2
    assert len(set(seeds)) == 3
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert found.columns == ("make_points.count", "repeat", "seed")
    assert [point.name for point in found.points][:3] == [f"count-2_repeat-{number}" for number in (1, 2, 3)]
    assert [point.varied["seed"] for point in found.points] == seeds


def test_more_repeats_keep_the_seeds_of_fewer(project: Project):
    few, many = (study(project, f"base: base.yaml\nrepeats: {count}\n") for count in (2, 4))
    assert [point.plan().seed for point in few.points] == [point.plan().seed for point in many.points][:2]
    assert [point.name for point in few.points] == ["repeat-1", "repeat-2"]


def test_a_seed_that_is_set_or_varied_is_the_root_of_repeats(project: Project):
    text = "base: base.yaml\nrepeats: 2\n"
    assert study(project, text, "seed=3").points[1].plan().seed == derived_seed(3, 2)
    varied = study(project, text + "vary: {seed: [4]}\n")
    assert [point.plan().seed for point in varied.points] == [4, derived_seed(4, 2)]


# Whole configs


def test_runs_are_configs_as_they_are(project: Project):
    project.write(BASE, "sub/one.yaml")
    project.write("name: second\nstages: [{use: make_points}]", "sub/two.yaml")
    found = study(project, "runs: [sub/one.yaml, sub/two.yaml]\n", "make_points.count=9")
    assert [point.name for point in found.points] == ["one", "second"]
    assert values(found) == [("one",), ("second",)]
    assert found.columns == ("run",)
    assert [point.plan().resolved()["stages"][0]["count"] for point in found.points] == [9, 9]
    repeated = study(project, "runs: [sub/one.yaml]\nrepeats: 2\n")
    assert [point.name for point in repeated.points] == ["one_repeat-1", "one_repeat-2"]


def test_files_are_seen_from_where_they_are_named(project: Project):
    project.write("1.0", "sub/a.txt")
    project.write("2.0", "b.txt")
    project.write("stages: [{use: read_points}]", "sub/base.yaml")
    path = project.write("base: base.yaml\nvary: {read_points.path: [a.txt, ../b.txt]}\n", "sub/study.yaml")
    found = read_study(path)
    paths = [point.plan().resolved()["stages"][0]["path"] for point in found.points]
    assert [Path(path) for path in paths] == [project.folder / "sub/a.txt", project.folder / "b.txt"]
    assert len({point.name for point in found.points}) == 2
    project.write("stages: [{use: read_points}]", "base.yaml")
    repeated = study(
        project,
        "base: base.yaml\nrepeats: 1\nvary: {seed: [1]}\n".replace("base.yaml", "sub/base.yaml"),
        "read_points.path=b.txt",
    )
    assert Path(repeated.points[0].plan().resolved()["stages"][0]["path"]) == project.folder / "b.txt"


# Names


def test_names_stay_short_and_apart(project: Project):
    project.write("stages: [{use: make_points}, {use: write_points}]", "base.yaml")
    lists = [["a.txt", f"{letter * 120}.txt"] for letter in "bc"]
    path = project.write(f"base: base.yaml\nvary: {{write_points.names: {lists}}}\n", "study.yaml")
    names = [point.name for point in read_study(path).points]
    assert len(set(names)) == 2
    assert max(map(len, names)) <= 80


def test_parameters_of_one_name_are_told_apart(project: Project):
    found = study(project, "base: base.yaml\nvary: {grow_points.limit: [3.0], count_points.limit: [4.0]}\n")
    assert found.points[0].name == "grow_points.limit-3.0_count_points.limit-4.0"


def test_a_study_is_known_by_its_keys(project: Project):
    assert is_study(project.write("base: base.yaml\n", "study.yaml"))
    assert is_study(project.write("runs: []\n", "study.yaml"))
    assert not is_study(project.write(BASE, "base.yaml"))


# Faults


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("base: base.yaml\nvary: {}\n", "study.yaml:2:1: vary: must map parameters to values, such as"),
        ("base: base.yaml\n", "study.yaml:1:1: nothing varies; give vary or repeats"),
        ("vary: {seed: [1]}\n", "study.yaml:1:1: needs `base:`, the config to vary, or `runs:`"),
        ("base: no.yaml\nrepeats: 2\n", "study.yaml:1:1: base: no such file; paths in a study are relative to the"),
        ("base: 3\nrepeats: 2\n", "study.yaml:1:1: base: must be the path of a config, got 3"),
        ("base: base.yaml\nvaried: {seed: [1]}\n", "study.yaml:2:1: unknown key 'varied'; did you mean 'vary'?"),
        ("base: base.yaml\nmode: all\nrepeats: 2\n", "study.yaml:2:1: mode: must be one of grid, zip, list, got 'all'"),
        ("base: base.yaml\nrepeats: 0\n", "study.yaml:2:1: repeats: must be a whole number, at least 1, got 0"),
        ("base: base.yaml\nrepeats: true\n", "study.yaml:2:1: repeats: must be a whole number, at least 1, got True"),
        ("name: a/b\nbase: base.yaml\nrepeats: 2\n", "study.yaml:1:1: name: must be letters, digits, dots, dashes"),
        ("base: base.yaml\nset: [3]\nrepeats: 2\n", "study.yaml:2:1: set: must map parameters to values, got [3]"),
        (
            "base: base.yaml\nset: {make_points.count: 0}\nrepeats: 2\n",
            "study.yaml:2:7: stages.0 (make_points): count: ",
        ),
        ("base: base.yaml\nset: {seed: 3}\nvary: {seed: [1]}\n", "study.yaml:2:7: the study varies seed; change its"),
        (
            "base: base.yaml\nset: {name: a}\nrepeats: 2\n",
            "study.yaml:2:7: name: cannot be set, the study names its points",
        ),
        ("runs: []\n", "study.yaml:1:1: runs: must be a list of configs, got []"),
        ("runs: [no.yaml]\n", "study.yaml:1:8: runs.0: no such file; paths in a study are relative to the study"),
        (
            "runs: [base.yaml]\nmode: zip\n",
            "study.yaml:2:1: mode: cannot be combined with runs, which lists whole configs",
        ),
        ("runs: [base.yaml, base.yaml]\n", "study.yaml:1:1: gives the point base twice; keep one"),
        ("3\n", "study.yaml:1:1: a study is a mapping with the keys base and vary, or runs"),
    ],
)
def test_a_fault_of_the_file_has_its_place(project: Project, text: str, fault: str):
    (found,) = faults_of(project, text)
    assert found.startswith(fault)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("scater_points.amount: [1]", "3:3: the config has no stage 'scater_points'; did you mean 'scatter_points'?"),
        (
            "scatter_points.amuont: [1]",
            "3:3: scatter_points.amuont: unknown parameter 'amuont'; did you mean 'amount'?",
        ),
        ("scatter_points: [1]", "3:3: must have the form stage.parameter"),
        ("scatter_points.amount: []", "3:3: scatter_points.amount: is an empty list; give at least one value"),
        ("scatter_points.amount: 0.1", "3:3: scatter_points.amount: must be a list, {range: [start, stop, step]} or"),
        ("scatter_points.amount: {step: [1]}", "3:3: scatter_points.amount: must be a list, {range: "),
        ("scatter_points.amount: {range: [0, 1]}", "3:27: scatter_points.amount: range: must be three numbers, got"),
        ("scatter_points.amount: {range: [0, 1, a]}", "3:27: scatter_points.amount: range: must be three numbers"),
        ("scatter_points.amount: {range: [0, .inf, 1]}", "3:27: scatter_points.amount: range: must be three numbers"),
        (
            "scatter_points.amount: {range: [0, 1, 0]}",
            "3:27: scatter_points.amount: range: must be [start, stop, step]",
        ),
        (
            "scatter_points.amount: {range: [1, 0, 1]}",
            "3:27: scatter_points.amount: range: must be [start, stop, step]",
        ),
        ("scatter_points.amount: {linspace: [0, 1, 1]}", "3:27: scatter_points.amount: linspace: must be [start, stop"),
        (
            "scatter_points.amount: [0.1, 0.7]",
            "3:32: stages.1 (scatter_points): amount: must be less than 0.5, got 0.7",
        ),
        ("scatter_points.amount: [0.1, 0.1]", "2:1: gives the point amount-0.1 twice; keep one"),
        ("name: [a]", "3:3: name: cannot be set, the study names its points"),
        ("seed: [-1]", "3:10: seed: must be a whole number from 0 to 2^63 - 1, got -1"),
    ],
)
def test_a_fault_of_what_varies_has_its_place(project: Project, line: str, fault: str):
    (found,) = faults_of(project, f"base: base.yaml\nvary:\n  {line}\n")
    assert found.startswith(f"study.yaml:{fault}")


def test_unequal_lengths_in_a_zip_are_told(project: Project):
    text = "base: base.yaml\nmode: zip\nvary:\n  make_points.count: [2, 3]\n  scatter_points.amount: [0.1]\n"
    (fault,) = faults_of(project, text)
    assert fault == (
        "study.yaml:5:3: scatter_points.amount: has 1 values, but make_points.count has 2; "
        "`mode: zip` needs lists of equal length"
    )


@pytest.mark.parametrize("entry", ["{make_points.count: [2]}", "[]", "[3]", "[{}]"])
def test_a_list_of_points_is_a_list_of_mappings(project: Project, entry: str):
    (fault,) = faults_of(project, f"base: base.yaml\nmode: list\nvary: {entry}\n")
    assert "must be a list of mappings" in fault or "must map parameters to values" in fault


def test_all_faults_of_all_points_are_told_once(project: Project):
    text = "base: base.yaml\nvary:\n  make_points.count: [0, 2]\n  scatter_points.amount: [0.7, 0.9]\n"
    found = faults_of(project, text)
    assert [fault.partition(" ")[0] for fault in found] == ["study.yaml:3:23:", "study.yaml:4:27:", "study.yaml:4:32:"]


def test_faults_of_the_base_are_told_at_their_own_place(project: Project):
    project.write("stages: [{use: make_points, cuont: 3}]", "wrong.yaml")
    (fault,) = faults_of(project, "base: wrong.yaml\nvary: {make_points.count: [1, 2]}\n")
    assert fault == "wrong.yaml:1:29: stages.0 (make_points): unknown parameter 'cuont'; did you mean 'count'?"


def test_what_is_varied_cannot_be_set(project: Project):
    (fault,) = faults_of(project, "base: base.yaml\nvary: {make_points.count: [2]}\n", "make_points.count=3")
    assert fault == "--set make_points.count=3: the study varies make_points.count; change its values there"


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("vary: {seed: {range: [1, 1000000, 1]}}", "1,000,000"),
        ("vary: {seed: {range: [1, 1000, 1]}, make_points.count: {range: [1, 1000, 1]}}", "1,000,000"),
        ("vary: {seed: {linspace: [0, 1000000000000, 1000000001]}}", "1,000,000,001"),
        ("repeats: 5000", "5,000"),
    ],
)
def test_a_study_of_very_many_points_asks_first(project: Project, text: str, count: str):
    (fault,) = faults_of(project, f"base: base.yaml\n{text}\n")
    assert fault.endswith(f"makes {count} points, more than 2,000; confirm with --yes")


def test_a_large_study_that_is_meant_is_read(project: Project, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("scaffold_pipeline.studies.file.MOST_POINTS", 3)
    text = "base: base.yaml\nvary: {seed: [1, 2, 3, 4]}\n"
    assert len(faults_of(project, text)) == 1
    assert len(study(project, text, may_be_large=True).points) == 4
