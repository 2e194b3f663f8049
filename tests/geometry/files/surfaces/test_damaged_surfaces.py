"""Cut off anywhere or with bytes turned over, a file is read or refused by one line: no crash, no other error.

VTK's formats are read in a child process, which takes what kills it; a few cuts of each show that it does.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.solids.formats import FORMATS
from scaffold_geometry.files.solids.model import Mesh, Model
from scaffold_geometry.files.surfaces import three_mf
from scaffold_geometry.files.surfaces.reading import READERS, read_surface
from scaffold_pipeline.errors import PipelineWarning, StageError
from shapes import ball

VERTICES, FACES = ball(7.0, (20.0, 5.0, 3.0), divisions=2)
SINGLE = VERTICES.astype(np.float32)
CUTS, FLIPS = 50, 60


def ascii_stl():
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    rows = ["".join(f"vertex {x:.8e} {y:.8e} {z:.8e}\n" for x, y, z in corners) for corners in VERTICES[FACES]]
    return f"solid a ball\n{''.join(facet.format(row) for row in rows)}endsolid a ball\n"


def off():
    return f"OFF\n{len(VERTICES)} {len(FACES)} 0\n{table(VERTICES)}{table(np.insert(FACES, 0, 3, axis=1))}"


def ascii_ply():
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(VERTICES)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    header += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    return header + table(VERTICES) + table(np.insert(FACES, 0, 3, axis=1))


def table(rows: np.ndarray):
    stream = io.StringIO()
    np.savetxt(stream, rows, fmt="%.8g")
    return stream.getvalue()


def written(path: Path):
    texts: dict[str, Callable[[], str]] = {"ascii.stl": ascii_stl, "ball.off": off, "ascii.ply": ascii_ply}
    if path.name in texts:
        path.write_text(texts[path.name]())
    else:
        model = Model(Mesh(SINGLE, FACES), "ball", "#aabbcc", None)
        FORMATS[path.suffix[1:]].write(path, model)
    return path.read_bytes()


NAMES = ["ascii.stl", "binary.stl", "ball.off", "ball.obj", "ascii.ply", "binary.ply", "ball.3mf", "ball.glb"]


@pytest.fixture(autouse=True)
def _read_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(three_mf, "call_in_child", lambda function, arrays, scalars, **_: function(**arrays, **scalars))


def outcome(path: Path, content: bytes):
    """Return how many triangles are read, or the line of the refusal."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PipelineWarning)
        try:
            return len(read_surface(path).faces)
        except StageError as error:
            return str(error)


def require_clear(said: str | int, name: str):
    if isinstance(said, str):
        assert name in said
        assert "\n" not in said
        assert len(said) < 400
        assert "Error:" not in said.replace("lib3mf", "")
        assert "np." not in said


@pytest.mark.parametrize("name", NAMES)
def test_a_file_cut_off_anywhere_is_whole_or_refused(tmp_path: Path, name: str):
    path = tmp_path / name
    content = written(path)
    for cut in range(CUTS):
        said = outcome(path, content[: len(content) * cut // CUTS])
        require_clear(said, name)
        if name != "ball.obj":  # which announces nothing
            assert isinstance(said, str), f"{said} triangles of {len(FACES)} from {cut} in {CUTS} parts"


@pytest.mark.parametrize("name", NAMES)
def test_turned_bytes_end_in_a_surface_or_a_line(tmp_path: Path, name: str):
    path = tmp_path / name
    content = written(path)
    rng = np.random.default_rng(7)
    for _ in range(FLIPS):
        damaged = np.frombuffer(content, np.uint8).copy()
        at = rng.integers(0, len(damaged) if rng.random() < 0.5 else min(len(damaged), 400), size=rng.integers(1, 9))
        damaged[at] = rng.integers(0, 256, size=len(at))
        require_clear(outcome(path, damaged.tobytes()), name)


@pytest.mark.parametrize("suffix", sorted(READERS))
@pytest.mark.parametrize(
    "content", [b"\0" * 200, b"\xff" * 200, b"\n\n\n", b"ply", b"glTF", b"PK\x05\x06" + b"\0" * 18]
)
def test_what_is_no_surface_at_all_is_one_line(tmp_path: Path, suffix: str, content: bytes):
    said = outcome(tmp_path / f"junk{suffix}", content)
    assert isinstance(said, str)
    require_clear(said, f"junk{suffix}")


@pytest.mark.parametrize("count", [b"4294967295", b"99999999999999999999"])
@pytest.mark.parametrize("what", [b"vertex", b"face"])
def test_a_count_beyond_all_memory_is_refused_before_anything_is_made(tmp_path: Path, what: bytes, count: bytes):
    content = written(tmp_path / "binary.ply")
    start = content.index(b"element " + what) + len(b"element " + what)
    end = content.index(b"\n", start)
    said = outcome(tmp_path / "binary.ply", content[:start] + b" " + count + content[end:])
    assert "cut off before" in str(said)
