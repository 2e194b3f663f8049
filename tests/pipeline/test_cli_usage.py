from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from subprocess import Popen

import pytest

from pipeline.workplace import Project
from scaffold_pipeline import __version__
from scaffold_pipeline.testing import SLOW_TO_IMPORT

SOUND = """
    stages:
      - use: make_points
      - use: scatter_points
      - use: write_points
      - use: count_points
    """
WRONG = """
    stages:
      - use: make_points
        count: 0
      - use: scater_points
    """


def test_validate_says_ok_and_runs_nothing(project: Project):
    answer = project.command("validate", project.write(SOUND))
    assert (answer.code, answer.out, answer.err) == (0, "config.yaml: ok, 4 stages\n", "")
    assert not Path("runs").exists()
    assert project.command("validate", "config.yaml", "--json").json["valid"] is True


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_validate_tells_all_faults(project: Project, options: list[str]):
    answer = project.command("validate", project.write(WRONG), "--set", "nowhere.x=1", *options)
    assert answer.code == 2
    assert len(answer.err.splitlines()) == 3
    assert answer.err.startswith("--set nowhere.x=1: ")


def test_stages_lists_all_and_names_the_broken_one(project: Project):
    answer = project.command("stages")
    lines = answer.out.splitlines()
    assert (answer.code, answer.err) == (0, "")
    assert "make_points        Make points along x." in lines
    assert any(line.startswith("broken: stage 'broken_stage': fake-plugin cannot be loaded from") for line in lines)


def test_stages_with_a_name_describes_one(project: Project):
    answer = project.command("stages", "grow_points")
    assert answer.code == 0
    assert "factor: number in times, default 2.0" in answer.out
    unknown = project.command("stages", "grow_point")
    assert unknown.code == 2
    assert unknown.err == "no stage is called 'grow_point'; did you mean 'grow_points'?\n"
    broken = project.command("stages", "broken_stage")
    assert broken.code == 1
    assert broken.err.startswith("stage 'broken_stage': fake-plugin cannot be loaded from fake_stages:not_there")


def test_stages_as_markdown_is_a_table(project: Project):
    lines = project.command("stages", "--markdown").out.splitlines()
    assert len({line.count("|") for line in lines}) == 1


def test_schema_is_json(project: Project):
    assert project.command("schema").json["title"] == "scaffold-pipeline config"


# inspect


def test_inspect_measures_a_file(project: Project):
    Path("flat.off").write_text("OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n")
    answer = project.command("inspect", "flat.off", "--units", "cm", "--json")
    assert answer.code == 0
    assert answer.json["volume_mm3"] == pytest.approx(1000.0 / 6.0)


def test_inspect_ends_with_1_and_a_line_where_a_run_would_refuse(project: Project):
    Path("open.off").write_text("OFF\n4 1 0\n0 0 0\n9 0 0\n0 9 0\n0 0 9\n3 0 2 1\n")
    answer = project.command("inspect", "open.off", "--units", "mm", "--json")
    assert (answer.code, answer.json["loads"], answer.json["boundary_edges"]) == (1, False, 3)
    assert answer.err.startswith("load_surface: open.off: ")
    assert len(answer.err.splitlines()) == 1


def test_inspect_tells_of_an_odd_size_with_the_number(project: Project):
    Path("tiny.off").write_text("OFF\n4 4 0\n0 0 0\n.1 0 0\n0 .1 0\n0 0 .1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n")
    answer = project.command("inspect", "tiny.off", "--json")
    assert (answer.code, answer.err) == (0, "")
    assert "its longest side is 0.1 mm, not between 1 and 2000 mm" in answer.json["warnings"]


@pytest.mark.parametrize(
    ("arguments", "rule"),
    [
        (["no.stl"], "no.stl: no such file:"),
        (["."], ".: must be a file, but"),
        (["flat.off", "--units", "feet"], "flat.off: Input should be 'mm', 'cm', 'm' or 'inch'"),
    ],
)
def test_inspect_refuses_with_a_line(project: Project, arguments: list[str], rule: str):
    Path("flat.off").write_text("OFF\n")
    answer = project.command("inspect", *arguments)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith(rule)
    assert "config" not in answer.err
    assert len(answer.err.splitlines()) == 1


# Usage and help


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rnu"], 'Unknown command "rnu". Did you mean "run"?'),
        (["run"], "requires an argument"),
        (["run", "config.yaml", "--untl", "x"], "Did you mean --until?"),
        (["run", "config.yaml", "surplus"], "surplus"),
        (["validate", "config.yaml", "--out", "x"], "--out"),
    ],
)
def test_a_wrong_command_line_is_exit_code_2_with_a_suggestion(project: Project, arguments: list[str], words: str):
    project.write(SOUND)
    answer = project.command(*arguments)
    assert (answer.code, answer.out) == (2, "")
    assert words in answer.err
    assert "Traceback" not in answer.err


def test_version_is_printed(project: Project):
    answer = project.command("--version")
    assert (answer.code, answer.out.strip()) == (0, __version__)


def test_help_names_every_command_and_exit_code(project: Project):
    text = project.command("--help").out
    for command in ("run", "validate", "stages", "schema", "new", "inspect"):
        assert f"│ {command} " in text
    assert "Exit codes: 0 ok; 1 a stage failed; 2 configuration or usage; 3 a quality gate" in text


IMPORTED = """
import json, sys
from scaffold_pipeline.cli.app import main
main(sys.argv[1:])
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})), file=sys.stderr)
"""


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize(
    ("arguments", "also_absent"),
    [
        (["--help"], ["numpy", "pydantic", "ruamel", "scaffold_stages", "fake_stages"]),
        (["run", "--help"], ["numpy", "pydantic", "ruamel", "scaffold_stages", "fake_stages"]),
        (["validate", "--help"], ["numpy", "pydantic", "ruamel", "scaffold_stages", "fake_stages"]),
        (["--version"], ["numpy", "pydantic", "ruamel", "scaffold_stages", "fake_stages"]),
        (["stages"], []),
        (["schema"], []),
    ],
)
def test_what_computes_nothing_imports_nothing_that_is_slow(arguments: list[str], also_absent: list[str]):
    command = [sys.executable, "-c", IMPORTED, *arguments]
    told = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=True)
    imported = set(json.loads(told.stderr.splitlines()[-1]))
    assert "scaffold_pipeline" in imported
    assert not imported & {*SLOW_TO_IMPORT, *also_absent}


@pytest.mark.usefixtures("project")
def test_the_module_is_the_command_and_a_reader_that_stops_is_no_fault():
    command = [sys.executable, "-m", "scaffold_pipeline", "schema"]
    with Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


def _exit_code(arguments: list[str], redirection: str) -> int:
    """Run the command in a shell with its streams redirected."""
    words = [sys.executable, "-m", "scaffold_pipeline", *arguments]
    return subprocess.run(["sh", "-c", f'"$@" {redirection}', "sh", *words], check=False).returncode


@pytest.mark.parametrize("redirection", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_a_closed_stream_fails_no_run(project: Project, quiet: list[str], redirection: str):
    config = project.write(SOUND)
    assert _exit_code(["run", str(config), "--out", "closed", *quiet], redirection) == 0
    assert Path("closed/metrics.json").is_file()
    assert _exit_code(["validate", str(project.write(WRONG))], redirection) == 2


@pytest.mark.parametrize("both", [False, True], ids=["standard output", "and standard error"])
def test_a_reader_that_has_gone_fails_no_run(project: Project, *, both: bool):
    config = project.write(SOUND)
    reading, writing = os.pipe()
    os.close(reading)
    words = [sys.executable, "-m", "scaffold_pipeline", "run", str(config), "--out", "unread"]
    done = subprocess.run(words, stdout=writing, stderr=writing if both else None, check=False)
    os.close(writing)
    assert done.returncode == 0
    assert Path("unread/metrics.json").is_file()
