"""`check_stage` runs a stage: each rule is shown to be broken by a stage that is sound but for that."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent, indent

import numpy as np
import pytest

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.errors import StageDefinitionError, StageError
from scaffold_pipeline.stages.registry import load_stage
from scaffold_pipeline.testing import check_stage

pytestmark = pytest.mark.usefixtures("project")
Install = Callable[..., None]

HEAD = """
import os
import random
import tempfile
import warnings
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fake_stages import Block, DrawPointsParams, Points
from scaffold_pipeline.artifacts import Artifact, Metrics
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import stage

CALLS = []


@dataclass(frozen=True, eq=False)
class Counted(Points):
    count: int = field(default=0, init=False)


@dataclass(frozen=True, eq=False)
class Noted(Points):
    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "places", self.places + 0.0)


@dataclass(frozen=True, eq=False)
class Aware(Points):
    def summary(self):
        return {"name": getattr(self, "name", "unnamed")}


@dataclass(frozen=True, eq=False)
class Told(Points):
    facts: Mapping[str, object] = field(default_factory=dict)

    def summary(self):
        return dict(self.facts)
"""


def points() -> Artifact:
    """Return an input for the stages of this file."""
    make_points = load_stage("make_points")
    return make_points.function(params=make_points.params())


def install_stage(install: Install, body: str, *, arguments: str = "", options: str = "", kind: str = "Points") -> None:
    text = f"""{HEAD}
@stage(writes="points", version=1{options})
def tried(points: {kind}, *, params: DrawPointsParams{arguments}) -> Points:
    "Try."
{indent(dedent(body).strip(), "    ")}
"""
    install("tried_package", text, "tried")


def faults(*, inputs: dict[str, Artifact] | None = None) -> list[str]:
    with pytest.raises(StageDefinitionError) as caught:
        check_stage("tried", inputs={"points": points()} if inputs is None else inputs)
    return [line.removeprefix("stage 'tried': ") for line in str(caught.value).splitlines()]


BESIDE = ", out: Path, rng: np.random.Generator, config_hash: str | None = None, executor: Executor | None = None"


def test_a_sound_stage_passes_whatever_it_takes(install: Install):
    install_stage(
        install,
        """
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "between.txt").write_text("gone")
        (out / "points.txt").write_text(str(config_hash))
        warn("this is for the user")
        moved = points.places + rng.normal(size=points.places.shape)
        return Points(executor.submit(np.sqrt, moved**2).result() if executor else np.sqrt(moved**2))
        """,
        arguments=BESIDE,
    )
    home, state = Path.cwd(), np.random.get_state()[1].tolist()  # type: ignore[index, union-attr]  # noqa: NPY002
    folders = tempfile.gettempdir(), os.environ.get("TMPDIR")
    check_stage("tried", inputs={"points": points()}, params={}, seed=3)
    assert (Path.cwd(), np.random.get_state()[1].tolist()) == (home, state)  # type: ignore[index, union-attr]  # noqa: NPY002
    assert (tempfile.gettempdir(), os.environ.get("TMPDIR")) == folders


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("return Points(np.random.uniform(size=(1, 3)))", "uses numpy's global random numbers; use `rng` alone"),
        ("return Points(np.full((1, 3), random.random()))", "two equal calls give a different Points; draw random"),
        ("os.chdir('..'); return points", "changes the working directory; use paths instead"),
        ("Path('a.txt').touch(); return points", "writes a.txt into the working directory; use `out`"),
        ("tempfile.mkdtemp(prefix='a-'); return points", "leaves a-"),
        ("warnings.warn('oh'); return points", "warns UserWarning in tried_package.py:"),
        ("np.log(np.zeros(1)); return points", "warns RuntimeWarning in tried_package.py:"),
        ("return Metrics({})", "returned a Metrics, but its annotation is Points"),
        ("return Counted(points.places)", "its Counted cannot be stored and loaded: "),
        ("return Told(points.places, {'a': np.int64(3)})", "its Told cannot be stored and loaded: "),
        ("return Told(points.places, {'a': float('nan')})", "its Told cannot be stored and loaded: "),
        ("return Noted(points.places)", "the array 'places' of its Noted is writable; call `own_array` in"),
    ],
)
def test_a_stage_that_does_what_it_must_not_is_told_so(install: Install, body: str, fault: str):
    install_stage(install, body.replace("; ", "\n"))
    (found,) = faults()
    assert found.startswith(fault)


def test_another_result_at_the_second_call_is_told_unless_it_is_declared(install: Install):
    body = "CALLS.append(1)\nreturn Points(np.full((1, 3), len(CALLS)))"
    install_stage(install, body)
    remedy = "draw random numbers from `rng` alone, order sets, or declare it repeatable=False"
    assert faults() == [f"two equal calls give a different Points; {remedy}"]
    install_stage(install, body, options=", repeatable=False")
    check_stage("tried", inputs={"points": points()})


def test_another_file_at_the_second_call_is_told(install: Install):
    body = "CALLS.append(1)\n(out / f'{len(CALLS)}.txt').touch()\n(out / 'same.txt').touch()\nreturn points"
    install_stage(install, body, arguments=", out: Path")
    assert [fault.partition(";")[0] for fault in faults()] == [
        "two equal calls give a different file 1.txt",
        "two equal calls give a different file 2.txt",
    ]


def test_a_result_that_depends_on_who_helps_is_told(install: Install):
    body = "return Points(np.full((1, 3), 1.0 if executor else 2.0))"
    install_stage(install, body, arguments=", executor: Executor | None = None")
    assert faults()[0].startswith("two equal calls give a different Points")


def test_a_result_with_more_than_its_fields_is_told(install: Install):
    install_stage(install, "made = Aware(points.places)\nobject.__setattr__(made, 'name', 'a')\nreturn made")
    assert faults() == ["its Aware differs when loaded from the store; keep all its state in its fields"]


@pytest.mark.parametrize(
    "change", ["points.places.setflags(write=True)\npoints.places[0] = 9.0", "object.__setattr__(points, 'side', 3.0)"]
)
def test_a_changed_input_is_told(install: Install, change: str):
    install_stage(install, f"{change}\nreturn Points(np.zeros((1, 3)))", kind="Block")
    make_block = load_stage("make_block")
    block = make_block.function(params=make_block.params(log=os.devnull))
    assert faults(inputs={"points": block}) == ["changes its input 'points'; return a new artifact instead"]


def test_files_outside_are_told_wherever_python_changes_them(install: Install, tmp_path: Path):
    for name in ("removed", "renamed"):
        (tmp_path / name).touch()
    install_stage(
        install,
        f"""
        here = Path({str(tmp_path)!r})
        (here / "made").write_text("text")
        (here / "folder").mkdir(exist_ok=True)
        (here / "removed").unlink()
        (here / "renamed").rename(here / "moved")
        (here / ".cache").mkdir(exist_ok=True)
        (here / ".cache" / "table").touch()
        (here / "made").read_text()
        return points
        """,
    )
    told = [f"writes {tmp_path / name}, outside `out`" for name in ("made", "folder", "removed", "renamed", "moved")]
    assert faults() == told


@pytest.mark.parametrize("name", ["run.json", ".hidden", "folder/inside.txt"])
def test_what_may_not_lie_in_out_is_told(install: Install, name: str):
    body = f"path = out / {name!r}\npath.parent.mkdir(exist_ok=True)\npath.touch()\nreturn points"
    install_stage(install, body, arguments=", out: Path")
    assert [fault.rpartition(", got ")[2] for fault in faults()] == [name.partition("/")[0]]


def test_inputs_and_parameters_that_do_not_fit_are_told(install: Install):
    install_stage(install, "return points", kind="Block")
    assert faults(inputs={}) == ["needs the input 'points', a Block, to be run; give it in `inputs`"]
    assert faults(inputs={"points": points(), "other": points()}) == [
        "the input 'points' must be a Block, got a Points",
        "does not read the given input 'other'",
    ]
    with pytest.raises(StageDefinitionError, match=r"(?s)the given parameters are invalid: .*least"):
        check_stage("count_points", inputs={"points": points()}, params={"least": "many"})
    with pytest.raises(StageDefinitionError) as caught:
        check_stage("count_points", inputs={"points": points()}, params={"lest": 1})
    refused = "stage 'count_points': the given parameters are invalid: unknown parameter 'lest'; did you mean 'least'?"
    assert str(caught.value) == refused


def test_what_a_stage_raises_is_passed_on_with_everything_put_back(install: Install):
    install_stage(install, "Path('a').touch()\nraise StageError('too few points')")
    home = Path.cwd()
    with pytest.raises(StageError, match=r"^too few points$"):
        check_stage("tried", inputs={"points": points()})
    assert Path.cwd() == home


def test_a_stage_without_inputs_or_parameters_given_is_not_run(install: Install):
    install_stage(install, "raise AssertionError")
    check_stage("tried")


def test_parameters_may_name_files_from_the_working_directory(tmp_path: Path):
    (tmp_path / "points.txt").write_text("1.0 2.0")
    check_stage("read_points", params={"path": "points.txt"})
    made = load_stage("read_points").params.model_validate({"path": "points.txt"})
    check_stage("read_points", params=made)
