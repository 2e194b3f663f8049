"""STL as programs write it: sizes that do not fit the count, tails, names that are words of the format, commas."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.binary_stl import to_stl
from scaffold_geometry.files.surfaces.reading import read_surface
from scaffold_pipeline.errors import PipelineWarning, StageError
from shapes import ball

VERTICES, FACES = ball(7.0, (20.0, 5.0, 3.0), divisions=2)
CORNERS = VERTICES.astype(np.float32)[FACES].astype(np.float64)


def binary(header: bytes = b"", count: int | None = None, tail: bytes = b""):
    content = to_stl(VERTICES, FACES, "x")
    return header.ljust(80) + struct.pack("<I", len(FACES) if count is None else count) + content[84:] + tail


def text(name: str = "part", end: str = "endsolid part\n", corners: np.ndarray = CORNERS):
    rows = [
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x:.9e} {y:.9e} {z:.9e}\n" for x, y, z in corner)
        + " endloop\nendfacet\n"
        for corner in corners
    ]
    return f"solid {name}\n{''.join(rows)}{end}"


def corners_of(folder: Path, content: bytes | str):
    path = folder / "part.stl"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    found = read_surface(path)
    return found.vertices[found.faces]


def refused(folder: Path, content: bytes | str, said: str):
    with pytest.raises(StageError, match=said) as caught:
        corners_of(folder, content)
    assert "\n" not in str(caught.value)
    assert "np." not in str(caught.value)


@pytest.mark.parametrize("tail", [b"\0\0", b"\r\n", b"COLOR=red", b"\0" * 50, b"made by a scanner, " * 40])
@pytest.mark.parametrize("header", [b"", b"solid made by a program", b"solid facet normal"])
def test_bytes_after_the_last_triangle_are_left_out_with_a_warning(tmp_path: Path, header: bytes, tail: bytes):
    with pytest.warns(PipelineWarning, match=f"left out {len(tail)} bytes after its last triangle"):
        assert np.array_equal(corners_of(tmp_path, binary(header, tail=tail)), CORNERS)


@pytest.mark.parametrize("header", [b"solid", b"solid facet normal endsolid", b"\xef\xbb\xbfsolid"])
def test_a_binary_file_may_begin_with_solid(tmp_path: Path, header: bytes):
    assert np.array_equal(corners_of(tmp_path, binary(header)), CORNERS)


@pytest.mark.parametrize("count", [0, 2**32 - 1])
def test_a_count_that_was_never_written_is_taken_from_the_size_with_a_warning(tmp_path: Path, count: int):
    with pytest.warns(PipelineWarning, match=f"announces {count} triangles; read all {len(FACES)} that follow"):
        assert np.array_equal(corners_of(tmp_path, binary(count=count)), CORNERS)


@pytest.mark.parametrize(
    ("count", "said"), [(5, "announces 5 triangles, but more"), (200, "is not an STL file, or damaged")]
)
def test_a_count_that_lies_is_refused(tmp_path: Path, count: int, said: str):
    refused(tmp_path, binary(count=count), said)


def test_a_file_of_no_count_that_ends_within_a_triangle_is_refused(tmp_path: Path):
    refused(tmp_path, binary(count=0)[:-7], "is not an STL file, or damaged")


@pytest.mark.parametrize(
    "end",
    [
        *("endsolid part\n", "endsolid", "endsolid\n\n\n", "ENDSOLID part\n", "end solid\n", "end solid part\n"),
        *("endsolid part\n; end of export\n", "endsolid part\n\0\0\0", "endsolid part\n\x1a", "  endsolid x\r\n"),
        "endsolid facet normal endfacet vertex 1 2 3\n",
    ],
)
def test_text_may_end_in_many_ways(tmp_path: Path, end: str):
    assert np.allclose(corners_of(tmp_path, text(end=end)), CORNERS, rtol=1e-7)


@pytest.mark.parametrize("name", ["", "facet normal 1 2 3", "vertex 1 2 3", "endsolid", "a solid endfacet", "Knöchel"])
def test_a_solid_may_have_any_name(tmp_path: Path, name: str):
    assert np.allclose(corners_of(tmp_path, text(name, f"endsolid {name}\n")), CORNERS, rtol=1e-7)


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_may_have_any_line_ends_and_byte_order_mark(tmp_path: Path, encoding: str, line_end: str):
    content = text().replace("\n", line_end).encode(encoding)
    assert np.allclose(corners_of(tmp_path, content), CORNERS, rtol=1e-7)


def test_text_of_one_line_is_read(tmp_path: Path):
    assert np.allclose(corners_of(tmp_path, " ".join(text("").split())), CORNERS, rtol=1e-7)


def test_several_solids_are_one_surface_and_said_so(tmp_path: Path):
    path = tmp_path / "part.stl"
    path.write_text(text("a", "endsolid a\n", CORNERS[:50]) + text("b", "endsolid b\n", CORNERS[50:]))
    found = read_surface(path)
    assert np.allclose(found.vertices[found.faces], CORNERS, rtol=1e-7)
    assert "its 2 solids are read as one surface" in found.notes


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (text()[:-40], "cut off or damaged"),
        (text(end=""), "no `endsolid` at the end"),
        (text() + "solid b\n", "cut off or damaged"),
        (text() + "solid b\nfacet normal 0 0 0\n", "cut off or damaged"),
        (text(end="") + text()[: text().index("endfacet")], "cut off or damaged"),
    ],
)
def test_text_that_is_cut_off_is_refused(tmp_path: Path, content: str, said: str):
    refused(tmp_path, content, said)


def test_decimal_commas_are_refused_with_the_line_and_the_cause(tmp_path: Path):
    refused(
        tmp_path, text().replace(".", ","), r"part\.stl:4: a vertex .* '2,7.*'; it has a decimal comma: export it with"
    )


def test_a_word_that_is_no_number_is_refused_with_its_line(tmp_path: Path):
    lines = text().split("\n")
    lines[10] = "  vertex 1 two 3"
    refused(tmp_path, "\n".join(lines), r"part\.stl:11: a vertex must be three numbers, got 'two'; the file is damaged")


@pytest.mark.parametrize("space", ["RAS", "LPS"])
def test_anatomical_axes_of_the_header_are_told_and_nothing_is_turned(tmp_path: Path, space: str):
    path = tmp_path / "part.stl"
    for content in (binary(f"3D Slicer output. SPACE={space}".encode()), text(f"x SPACE={space}").encode()):
        path.write_bytes(content)
        found = read_surface(path)
        assert found.space == space
        assert any(space in note for note in found.notes)
        assert np.allclose(found.vertices[found.faces], CORNERS, rtol=1e-7)
