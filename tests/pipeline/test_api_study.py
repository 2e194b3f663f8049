"""The front door: `study`, its table, and the runs of its points."""

from __future__ import annotations

import csv
import gc

import pandas as pd
import pytest

import scaffold_pipeline as sp

BASE = "stages: [{use: make_points}, {use: scatter_points}, {use: draw_points}, {use: count_points}]"
STUDY = "base: base.yaml\nvary: {make_points.count: [3, 5], scatter_points.amount: [0.1, 0.2]}"


@pytest.fixture
def varied(project):
    project.write(BASE, "base.yaml")
    return project.write(STUDY, "counts.yaml")


def test_the_table_is_the_commands_and_pandas_takes_it(project, varied):
    made = sp.study(varied)
    table = pd.DataFrame(made.table)
    assert table["make_points.count"].tolist() == [3, 3, 5, 5]
    assert table["points"].tolist() == [3, 3, 5, 5]
    assert project.command("study", varied, "--out", "by_command", "--quiet").code == 0
    with (project.folder / "by_command" / "table.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(made.table[0])
    assert [row["point"] for row in rows] == table["point"].tolist() == list(made)


def test_each_point_is_a_run_that_keeps_a_temporary_folder(project, varied, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(project.folder))
    point = sp.study(varied, settings={"seed": 5})["count-5_amount-0.2"]
    gc.collect()
    assert len(point["points"].places) == 5
    assert point.record["seed"] == 5
    del point
    gc.collect()
    assert sorted(path.name for path in project.folder.iterdir()) == ["base.yaml", "counts.yaml"]
    with pytest.raises(KeyError, match=r"no point 'count-5_amount-0.3'; did you mean"):
        sp.study(varied)["count-5_amount-0.3"]


def test_a_folder_is_gone_on_from_and_workers_make_the_same(varied):
    alone = sp.study(varied, out="alone")
    assert alone.page.is_file()
    assert sum(row["seconds"] for row in sp.study(varied, out="alone").table) == sum(
        row["seconds"] for row in alone.table
    )
    beside = sp.study(varied, workers=2)
    points = (alone["count-3_amount-0.1"], beside["count-3_amount-0.1"])
    assert points[0].record["stages"][1]["output"] == points[1].record["stages"][1]["output"]


def test_a_point_that_fails_is_an_error_unless_the_others_go_on(project, varied):
    project.write("stages: [{use: make_points}, {use: fail, how: stage_error}]", "base.yaml")
    failing = project.write("base: base.yaml\nvary: {fail.how: [stage_error, nothing]}", "fail.yaml")
    assert varied
    with pytest.raises(sp.StageError, match=r"^how-stage_error: fail: the points are too few, 4; give more$"):
        sp.study(failing)
    made = sp.study(failing, keep_going=True)
    assert made.errors == {"how-stage_error": "fail: the points are too few, 4; give more"}
    assert [row["error"] for row in made.table] == ["fail: the points are too few, 4; give more", None]
    assert repr(made).startswith("<StudyRun: 2 points, 1 failed; ")
    assert "too few" in made._repr_html_()


def test_a_study_that_cannot_run_is_one_line_a_fault(project, varied):
    with pytest.raises(sp.ConfigError, match=r"^settings\['jitter.amount'\]: the config has no stage 'jitter'"):
        sp.study(varied, settings={"jitter.amount": 0.1})
    with pytest.raises(sp.ConfigError, match=r"^workers: must be a whole number of 1 at least, got 0$"):
        sp.study(varied, workers=0)
    with pytest.raises(sp.ConfigError, match=r"^a study is the path of a YAML file, got {}$"):
        sp.study({})
    bad = project.write("base: base.yaml\nvary: {make_points.count: [0]}", "bad.yaml")
    with pytest.raises(sp.ConfigError, match=r"^bad.yaml:2:\d+: stages.0 \(make_points\): count: must be"):
        sp.study(bad)
