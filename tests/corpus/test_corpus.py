"""Whatever file comes in, a good solid or clear lines come out: real anatomy, broken surfaces, volume meshes."""

from __future__ import annotations

from pathlib import Path

import pytest

from corpus import outcome as corpus
from corpus.outcome import outcome_of

DATA = Path(__file__).parents[2].parent / "shared" / "data"
FILES = sorted(path for kind in ("anatomy", "dirty", "volume") for path in (DATA / kind).glob("*") if path.is_file())


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data is not beside this checkout")
@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_file_yields_a_good_solid_or_clear_lines(file: Path, tmp_path: Path):
    outcome = outcome_of(file, tmp_path)
    assert outcome.is_allowed, outcome


def cube(path: Path, *, closed: bool = True):
    corners = [f"v {x} {y} {z}" for x in (0, 10) for y in (0, 10) for z in (0, 10)]
    faces = ["1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4"]
    path.write_text("\n".join([*corners, *(f"f {face}" for face in faces[: None if closed else -8])]) + "\n")
    return path


def test_a_cube_yields_a_solid(tmp_path: Path):
    outcome = outcome_of(cube(tmp_path / "cube.obj"), tmp_path)
    assert (outcome.verdict, outcome.is_allowed) == ("solid", True), outcome


def test_an_open_box_is_refused_by_a_line(tmp_path: Path):
    outcome = outcome_of(cube(tmp_path / "open.obj", closed=False), tmp_path, repair="none")
    assert (outcome.verdict, outcome.is_allowed) == ("refused", True), outcome
    assert "open.obj" in outcome.said


@pytest.mark.parametrize(
    ("code", "lines", "has_solid"),
    [
        (-11, ["died"], False),  # a crash
        (124, ["no end after 600 s"], False),  # a hang
        (1, ["Traceback (most recent call last):", "KeyError: 3"], False),
        (1, [], False),  # no word
        (1, ["refused"], True),  # a file left behind
        (3, ["gate failed"], False),  # and none kept
    ],
)
def test_what_is_not_allowed_is_told_apart(code: int, lines: list[str], has_solid: bool, tmp_path: Path):  # noqa: FBT001
    if has_solid:
        (tmp_path / "solid.stl").write_bytes(b"")
    assert not corpus._judged(corpus._Ended(code, lines), tmp_path, 1.0).is_allowed
