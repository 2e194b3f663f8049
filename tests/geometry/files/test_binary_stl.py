from __future__ import annotations

import struct

import numpy as np
import pytest

from scaffold_geometry.files import binary_stl
from scaffold_geometry.files.binary_stl import from_stl, to_stl
from scaffold_geometry.surfaces import merge_corners as merge_corners_module
from scaffold_geometry.surfaces.merge_corners import merge_corners
from scaffold_pipeline.errors import StageError

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def test_what_is_written_is_read_back():
    vertices, faces = from_stl(to_stl(TETRAHEDRON, OUTWARD, "a test, mm"))

    assert len(vertices) == len(TETRAHEDRON)
    assert np.array_equal(vertices[faces], TETRAHEDRON[OUTWARD])
    assert (vertices.dtype, faces.dtype) == (np.float64, np.int64)


def test_bytes_follow_the_format():
    content = to_stl(TETRAHEDRON, OUTWARD, "a test, mm")
    normal, corners = struct.unpack_from("<3f", content, 84), struct.unpack_from("<9f", content, 96)

    assert content[:80] == b"a test, mm".ljust(80)
    assert struct.unpack_from("<I", content, 80) == (4,)
    assert len(content) == 84 + 4 * 50
    assert normal == (0.0, 0.0, -1.0)
    assert np.array_equal(np.reshape(corners, (3, 3)), TETRAHEDRON[OUTWARD[0]])


def test_bytes_are_the_same_each_time_and_for_either_zero():
    negative_zeros = np.where(TETRAHEDRON == 0.0, -0.0, TETRAHEDRON)

    assert to_stl(TETRAHEDRON, OUTWARD, "x") == to_stl(TETRAHEDRON, OUTWARD, "x")
    assert to_stl(negative_zeros, OUTWARD, "x") == to_stl(TETRAHEDRON, OUTWARD, "x")


def test_a_large_mesh_is_the_same_written_in_parts(monkeypatch: pytest.MonkeyPatch):
    whole = to_stl(TETRAHEDRON, OUTWARD, "x")
    monkeypatch.setattr(binary_stl, "_AT_ONCE", 3)

    assert to_stl(TETRAHEDRON, OUTWARD, "x") == whole


@pytest.mark.parametrize("header", ["solid heel", "Solid", "x" * 81, "Knöchel"])
def test_a_header_that_readers_mistake_is_refused(header: str):
    with pytest.raises(StageError, match="STL header: must be ASCII"):
        to_stl(TETRAHEDRON, OUTWARD, header)


def test_a_coordinate_beyond_float32_is_refused():
    with pytest.raises(StageError, match="must be finite in float32, but 1 of 12"):
        to_stl(TETRAHEDRON + np.array([[1e39, 0, 0], *([[0, 0, 0]] * 3)]), OUTWARD, "x")


@pytest.mark.parametrize("claimed", [0, 3, 5, 2**32 - 1])
def test_a_lying_count_is_detected(claimed: int):
    content = to_stl(TETRAHEDRON, OUTWARD, "x")

    with pytest.raises(StageError, match=rf"binary STL: {claimed} triangles need \d+ bytes, got 284"):
        from_stl(content[:80] + struct.pack("<I", claimed) + content[84:])


@pytest.mark.parametrize("content", [b"", b"solid x\nendsolid x\n", b"\0" * 83])
def test_what_is_too_short_is_refused(content: bytes):
    with pytest.raises(StageError, match=r"binary STL: .* not a binary STL"):
        from_stl(content)


def test_a_coordinate_that_is_no_number_is_refused():
    content = bytearray(to_stl(TETRAHEDRON, OUTWARD, "x"))
    struct.pack_into("<f", content, 96, float("nan"))

    with pytest.raises(StageError, match="must be finite"):
        from_stl(bytes(content))


def test_an_empty_file_has_no_vertices():
    vertices, faces = from_stl(to_stl(TETRAHEDRON, np.empty((0, 3), np.int64), "x"))

    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))


def test_only_equal_coordinates_are_merged():
    near = np.nextafter(np.float32(1.0), np.float32(2.0))
    corners = np.array([[[1, 0, 0], [near, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 1, 0], [-0.0, 0, 5]]], np.float32)

    vertices, faces = merge_corners(corners)

    assert faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert vertices[1, 0] - vertices[0, 0] == pytest.approx(2.0**-23)


def test_merging_is_exact_where_keys_collide(monkeypatch: pytest.MonkeyPatch):
    points = np.random.default_rng(3).integers(0, 4, size=(200, 3, 3)).astype(np.float32)
    vertices, faces = merge_corners(points)
    monkeypatch.setattr(merge_corners_module, "_keys", lambda rows: rows[:, 0].astype(np.uint64))

    by_collision = merge_corners(points)

    assert len(vertices) == len(np.unique(points.reshape(-1, 3), axis=0))
    assert np.array_equal(vertices[faces], points)
    assert np.array_equal(by_collision[0], vertices)
    assert np.array_equal(by_collision[1], faces)
