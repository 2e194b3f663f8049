"""The front door: `run`, `open_run`, what a `Run` gives, and that it is the command's own work."""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
import webbrowser
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import scaffold_pipeline as sp
from scaffold_pipeline.artifacts import Metrics

CHAIN = """
    name: chain
    seed: 7
    stages:
      - use: make_points
        count: 6
      - use: scatter_points
      - use: draw_points
      - use: count_points
      - use: write_points
        as: written
"""


CHAIN_LABELS = ("make_points", "scatter_points", "draw_points", "count_points")


def config():
    uses = CHAIN_LABELS
    return {"name": "chain", "seed": 7, "stages": [{"use": use} for use in uses]}


def outputs(run):
    return {stage["label"]: (stage["output"], stage["files"]) for stage in run.record["stages"]}


def results(run):
    return {
        name: run.record["files"][name]["sha256"]
        for name in ("points.txt", "config.yaml", "solved")
        if name in run.files
    }


def test_a_folder_that_cannot_be_made_is_one_line(project):  # noqa: ARG001
    Path("taken").write_text("a file", encoding="utf-8")
    with pytest.raises(sp.PipelineError, match=r"taken: cannot be made a folder for results \(File exists\); choose"):
        sp.run(config(), out="taken")
    with pytest.raises(sp.StageError, match=r"^write_points: taken: cannot be made a folder for results"):
        sp.stages.write_points(sp.stages.make_points(), out="taken")
    with pytest.raises(sp.ConfigError, match=r"^out: must be the path of a folder, got 3$"):
        sp.run(config(), out=3)


def test_what_it_makes_has_the_hashes_of_what_the_command_makes(project):
    path = project.write(CHAIN)
    assert project.command("run", path, "--out", "by_command", "--quiet").code == 0
    by_command, by_call = sp.open_run("by_command"), sp.run(path)
    assert outputs(by_call) == outputs(by_command)
    assert results(by_call) == results(by_command)
    assert by_call.record["config_sha256"] == by_command.record["config_sha256"]


def test_a_dict_makes_what_its_yaml_makes(project):
    text = "seed: 7\nstages: [{use: make_points}, {use: scatter_points}, {use: draw_points}, {use: count_points}]"
    assert outputs(sp.run(config())) == outputs(sp.run(project.write(text)))


def test_blas_that_is_loaded_with_many_threads_gives_the_commands_last_digits(project):
    path = project.write("stages: [{use: make_points}, {use: solve_points}]")
    process = project.start("run", path, "--out", "by_command", "--quiet")
    process.communicate()
    np.linalg.solve(np.eye(300), np.ones(300))  # numpy's BLAS is there, with a thread a core
    assert outputs(sp.run(path)) == outputs(sp.open_run("by_command"))


def test_settings_go_the_road_of_set(project):
    path = project.write(CHAIN)
    made = sp.run(
        path, settings={"make_points.count": np.int64(9), "seed": 8, "write_points.names": ("a.txt", "b.txt")}
    )
    assert len(made["points"].places) == 9
    assert made.record["seed"] == 8
    assert {"a.txt", "b.txt"} < set(made.files)


def test_paths_are_seen_from_the_current_folder_in_dicts_and_settings_and_from_the_file_in_files(project):
    (project.folder / "points.txt").write_text("1 2 3")
    asked = {"stages": [{"use": "read_points", "path": Path("points.txt")}]}
    assert len(sp.run(asked)["points"].places) == 3
    elsewhere = project.write("stages: [{use: read_points, path: points.txt}]", "deep/config.yaml")
    with pytest.raises(sp.ConfigError, match=r"deep/config.yaml:1:\d+: .* no such file: .*deep/points.txt"):
        sp.run(elsewhere)
    assert len(sp.run(elsewhere, settings={"read_points.path": "points.txt"})["points"].places) == 3


@pytest.mark.parametrize(
    ("asked", "settings", "message"),
    [
        (
            {"stages": [{"use": "make_points", "count": 0}]},
            None,
            "stages.0 (make_points): count: must be greater than or equal to 1, got 0",
        ),
        (
            {"stages": [{"use": "make_point"}]},
            None,
            "stages.0 (make_point): no stage is called 'make_point'; did you mean 'make_points'?",
        ),
        (
            {"stages": [{"use": "make_points"}]},
            {"make_points.count": -1},
            "settings['make_points.count']: stages.0 (make_points): count: must be greater than or equal to 1, got -1",
        ),
        (
            {"stages": [{"use": "make_points"}]},
            {"make_points.step": float("nan")},
            "settings['make_points.step']: stages.0 (make_points): step: must be a finite number, got nan",
        ),
        (
            {"stages": [{"use": "make_points"}]},
            {"jitter.amount": 1},
            "settings['jitter.amount']: the config has no stage 'jitter'; known: make_points",
        ),
        (
            {"stages": [{"use": "make_points"}]},
            [("seed", 1)],
            "settings: must map stage.parameter to values, got [('seed', 1)]",
        ),
        (
            {"stages": [{"use": "make_points"}], "name": 3},
            None,
            "name: must be letters, digits, dots, dashes and underscores, as it names a folder, got 3",
        ),
        ({}, None, "stages: must be a list of at least one stage, each with `use: NAME`"),
        (42, None, "a config is the path of a YAML file or a dict, got 42"),
        ("absent.yaml", None, "absent.yaml: no such file; `scaffold-pipeline new DIR` writes one"),
    ],
)
def test_a_config_that_cannot_run_is_one_line_a_fault(project, asked, settings, message):  # noqa: ARG001
    with pytest.raises(sp.ConfigError) as error:
        sp.run(asked, settings=settings)
    assert str(error.value) == message


def test_a_fault_of_a_file_has_its_place(project):
    path = project.write("stages:\n  - use: make_points\n    count: 0\n")
    with pytest.raises(sp.ConfigError) as error:
        sp.run(path)
    assert str(error.value).startswith("config.yaml:3:5: stages.0 (make_points): count: ")


def test_a_stage_that_fails_raises_its_line_and_leaves_nothing(project, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(project.folder))
    with pytest.raises(sp.StageError, match=r"^fail: the points are too few, 4; give more$"):
        sp.run({"stages": [{"use": "fail", "how": "stage_error"}]})
    assert list(project.folder.iterdir()) == []


def test_a_gate_that_failed_is_no_error_but_the_verdict(project):  # noqa: ARG001
    made = sp.run(config(), settings={"count_points.least": 5})
    assert made.quality == ["points: must be 5 at least, got 4"]
    assert made.failed_gates == ("points: must be 5 at least, got 4",)
    assert sp.run(config()).quality == "pass"
    assert sp.run(config()).failed_gates == ()


def test_it_maps_slots_and_stages_to_artifacts(project):  # noqa: ARG001
    made = sp.run(config())
    assert list(made) == ["points", "picture", "metrics"]
    assert len(made) == 3
    assert made["points"] is made["scatter_points"] is made["points"]
    assert len(made["make_points"].places) == 4
    assert isinstance(made["metrics"], Metrics)
    assert made.metrics["points"] == 4
    assert "points" in made
    assert "solid" not in made
    assert made._ipython_key_completions_() == [*CHAIN_LABELS, "points", "picture", "metrics"]
    with pytest.raises(KeyError, match="no slot or stage 'point'; did you mean 'points'"):
        made["point"]


def test_without_a_folder_all_is_gone_with_the_run(project, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(project.folder))
    points = sp.run(config())["points"]
    gc.collect()
    assert list(project.folder.iterdir()) == []
    assert points.places.shape == (4, 3)
    made = sp.run(config())
    assert made.folder.parent == project.folder
    assert made.page.is_file()
    del made
    gc.collect()
    assert list(project.folder.iterdir()) == []


def test_a_script_that_ends_leaves_nothing(project):
    code = "import scaffold_pipeline as sp; made = sp.run({'stages': [{'use': 'make_points'}]}); print(made.folder)"
    environment = {**os.environ, "TMPDIR": str(project.folder)}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert Path(ended.stdout.strip()).parent == project.folder
    assert list(project.folder.iterdir()) == []


def test_a_folder_holds_what_the_command_leaves_and_is_gone_on_from(project):
    path = project.write(CHAIN)
    assert {stage["reused"] for stage in sp.run(path, out="here").record["stages"]} == {False}
    assert {stage["reused"] for stage in sp.run(path, out=Path("here")).record["stages"]} == {True}
    assert project.command("run", path, "--out", "here", "--dry-run", "--json").json["unchanged"] == [
        *("make_points", "scatter_points", "draw_points", "count_points", "written")
    ]


def test_a_current_folder_that_changes_takes_nothing_away(project, monkeypatch):
    made = sp.run(config(), out="here")
    (project.folder / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    assert made["points"].places.shape == (4, 3)
    assert made.page.is_file()


def test_until_stops_early_and_then_there_is_no_page(project):  # noqa: ARG001
    made = sp.run(config(), until="scatter_points")
    assert list(made) == ["points"]
    assert made.quality == "not measured"
    assert made.files == {}
    with pytest.raises(sp.PipelineError, match="stopped early; run it to the end"):
        made.show()
    with pytest.raises(
        sp.ConfigError, match=r"^until: the config has no stage 'scatter'; did you mean 'scatter_points'"
    ):
        sp.run(config(), until="scatter")


def test_a_cache_gives_what_another_run_has_made(project):  # noqa: ARG001
    sp.run(config(), cache="shared")
    assert all(stage["reused"] for stage in sp.run(config(), cache="shared").record["stages"])


def test_warnings_of_stages_are_warnings(project):  # noqa: ARG001
    asked = {"stages": [{"use": "make_points"}, {"use": "grow_points", "factor": 100.0}]}
    with pytest.warns(sp.PipelineWarning, match="^grow_points: the points reach beyond 100 mm$"):
        made = sp.run(asked)
    assert made.warnings == ("grow_points: the points reach beyond 100 mm",)


def test_runs_in_threads_go_one_at_a_time(project):  # noqa: ARG001
    with ThreadPoolExecutor(4) as threads:
        made = list(threads.map(lambda seed: sp.run(config(), settings={"seed": seed}), [1, 2, 1, 2]))
    assert outputs(made[0]) == outputs(made[2]) != outputs(made[1]) == outputs(made[3])


def test_a_run_is_pickled_as_a_way_to_its_folder(project):  # noqa: ARG001
    kept = sp.run(config(), out="here")
    assert np.array_equal(pickle.loads(pickle.dumps(kept))["points"].places, kept["points"].places)  # noqa: S301 - our own
    copy = pickle.loads(pickle.dumps(sp.run(config())))  # noqa: S301 - our own
    gc.collect()
    with pytest.raises(sp.PipelineError, match="is removed with the Run that `run` returned; give out=FOLDER"):
        copy["points"]


def test_a_run_says_what_it_is(project):  # noqa: ARG001
    made = sp.run(config(), settings={"name": "chain"})
    assert repr(made).startswith("<Run 'chain': points, picture, metrics; quality: pass; ")
    assert made == made  # noqa: PLR0124 - not by values
    assert made != sp.run(config())
    assert len({made, made}) == 1


def test_open_run_refuses_what_is_no_run(project):
    with pytest.raises(sp.PipelineError, match="there is no record of a finished run"):
        sp.open_run(project.folder)


def test_a_notebook_shows_verdict_and_numbers_with_all_texts_escaped(project):  # noqa: ARG001
    made = sp.run(config(), settings={"count_points.least": 5})
    shown = made._repr_html_()
    assert "<strong>chain</strong>, quality: <strong>FAILED</strong>" in shown
    assert "points: must be 5 at least" in shown
    assert "img" not in shown
    (made.folder / "preview.png").write_bytes(b"png")
    harmless = sp.Run(
        made.folder,
        {**made.record, "name": "<b>", "files": {"preview.png": {}}, "warnings": ["<script>"]},
        {"quality": ["a: <i>"], "porosity": 0.65432},
    )._repr_html_()
    assert 'src="data:image/png;base64,cG5n"' in harmless
    assert "0.6543" in harmless
    assert not [tag for tag in ("<b>", "<i>", "<script>") if tag in harmless]


def test_show_opens_the_page_in_the_browser_a_copy_where_it_would_be_gone(project, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(project.folder))
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    kept = sp.run(config(), out="here")
    kept.show()
    assert opened == [kept.page.as_uri()]
    sp.run(config()).show()
    gc.collect()
    copies = list(project.folder.glob("scaffold-*.html"))
    assert [path.as_uri() for path in copies] == opened[1:]
    assert "chain" in copies[0].read_text(encoding="utf-8")


def test_show_displays_the_page_in_a_notebook(project, monkeypatch):  # noqa: ARG001
    from IPython import display

    shown = []
    monkeypatch.setattr(display, "display", shown.append)
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: SimpleNamespace(kernel=True))
    sp.run(config()).show()
    assert shown[0].data.startswith('<div><iframe sandbox="allow-scripts"')
    assert shown[0].data.count("<iframe") == 1
    assert "&lt;html" in shown[0].data


def test_verbose_tells_of_each_stage(project):
    sp.run(config(), verbose=True)
    assert "scatter_points: " in project.capture.readouterr().err
    sp.run(config())
    assert project.capture.readouterr().err == ""
