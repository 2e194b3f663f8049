"""glTF: numbers of any type, spread, sparse and normalised; strips, fans, instances; the rest refused by its name."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scaffold_geometry.files.surfaces.reading import read_surface
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.errors import PipelineWarning, StageError
from shapes import ball

VERTICES, FACES = ball(0.03, (0.01, 0.02, 0.0), divisions=2)
VERTICES, INDICES = VERTICES.astype(np.float32), FACES.astype(np.uint32)
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class Gltf:
    """A file in the making: `scene` is its JSON, of one node with one mesh of one primitive."""

    def __init__(
        self, vertices: np.ndarray = VERTICES, indices: np.ndarray | None = INDICES, **primitive: object
    ) -> None:
        self.bytes = b""
        self.scene: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        attributes = {"POSITION": self.add(vertices)}
        self.primitive = {"attributes": attributes, **primitive}
        if indices is not None:
            self.primitive["indices"] = self.add(indices.reshape(-1, 1))
        self.node: dict[str, Any] = {"mesh": 0}
        self.scene |= {"nodes": [self.node], "meshes": [{"primitives": [self.primitive]}]}

    def view(self, content: bytes, **more: object):
        self.bytes += b"\0" * (-len(self.bytes) % 4)
        self.scene["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": len(content), **more}
        )
        self.bytes += content
        return len(self.scene["bufferViews"]) - 1

    def add(self, rows: np.ndarray, **more: object):
        rows = np.asarray(rows)
        kind = rows.dtype.str[1:]
        accessor = {"componentType": CODES[kind], "count": len(rows), "type": WIDTHS[rows.shape[1]], **more}
        self.scene["accessors"].append({"bufferView": self.view(rows.tobytes()), **accessor})
        return len(self.scene["accessors"]) - 1

    def content(self, suffix: str = ".glb"):
        self.scene["buffers"] = [{"byteLength": len(self.bytes)}]
        if suffix == ".gltf":
            self.scene["buffers"][0]["uri"] = (
                "data:application/octet-stream;base64," + base64.b64encode(self.bytes).decode()
            )
            return json.dumps(self.scene).encode()
        text = json.dumps(self.scene).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.bytes), b"BIN\0") + self.bytes
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def read(self, folder: Path, suffix: str = ".glb"):
        path = folder / f"ball{suffix}"
        path.write_bytes(self.content(suffix))
        return read_surface(path)


def volume(found):
    return float(triangles.piece_volumes(found.vertices, found.faces, np.zeros(len(found.faces), np.int64)).sum())


BALL = volume(type("Found", (), {"vertices": VERTICES.astype(float), "faces": FACES}))


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("kind", [np.uint16, np.uint32])
def test_a_mesh_in_metres_with_y_up_is_read(tmp_path: Path, suffix: str, kind: type):
    found = Gltf(indices=FACES.astype(kind)).read(tmp_path, suffix)
    assert (found.unit, found.up) == ("m", "y")
    assert np.array_equal(found.vertices, VERTICES)
    assert np.array_equal(found.faces, FACES)


@pytest.mark.parametrize("kind", [np.uint8, np.int8, np.uint16, np.int16])
@pytest.mark.parametrize("is_normalised", [True, False])
def test_quantised_places_are_scaled_as_they_say(tmp_path: Path, kind: type, is_normalised: bool):  # noqa: FBT001
    most = np.iinfo(kind).max
    steps = np.round((VERTICES - VERTICES.min(axis=0)) / 0.06 * most).astype(kind)
    gltf = Gltf(steps)
    gltf.scene["extensionsRequired"] = gltf.scene["extensionsUsed"] = ["KHR_mesh_quantization"]
    gltf.scene["accessors"][0]["normalized"] = is_normalised
    gltf.node["scale"] = [0.06 / (1 if is_normalised else most)] * 3
    found = gltf.read(tmp_path)
    assert np.allclose(found.vertices, VERTICES - VERTICES.min(axis=0), atol=0.06 / most)


def test_rows_may_lie_apart(tmp_path: Path):
    gltf = Gltf(np.zeros((1, 3), np.float32))
    rows = np.concatenate([VERTICES, np.full((len(VERTICES), 1), 9.0, np.float32)], axis=1)
    gltf.scene["accessors"][0] |= {"bufferView": gltf.view(rows.tobytes(), byteStride=16), "count": len(rows)}
    assert np.array_equal(gltf.read(tmp_path).vertices, VERTICES)


@pytest.mark.parametrize("has_base", [True, False])
def test_a_sparse_accessor_replaces_rows(tmp_path: Path, has_base: bool):  # noqa: FBT001
    gltf = Gltf()
    at, new = np.array([3, 5], np.uint16), np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], np.float32)
    indices = {"bufferView": gltf.view(at.tobytes()), "componentType": CODES["u2"]}
    gltf.scene["accessors"][0]["sparse"] = {
        "count": 2,
        "indices": indices,
        "values": {"bufferView": gltf.view(new.tobytes())},
    }
    if not has_base:
        del gltf.scene["accessors"][0]["bufferView"]
    wanted = VERTICES.copy() if has_base else np.zeros_like(VERTICES)
    wanted[[3, 5]] = new
    assert np.array_equal(gltf.read(tmp_path).vertices, wanted)


TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)


@pytest.mark.parametrize(
    ("mode", "row", "faces"),
    [
        (5, [0, 1, 2, 3, 0, 1], [(0, 1, 2), (2, 1, 3), (2, 3, 0), (0, 3, 1)]),
        (5, [0, 1, 2, 2, 3, 3], [(0, 1, 2)]),
        (6, [0, 1, 2, 3, 1], [(0, 1, 2), (0, 2, 3), (0, 3, 1)]),
        (4, [0, 1, 2], [(0, 1, 2)]),
    ],
)
def test_strips_and_fans_are_cut_into_triangles(
    tmp_path: Path, mode: int, row: list[int], faces: list[tuple[int, ...]]
):
    found = Gltf(TETRAHEDRON, np.array(row, np.uint8), mode=mode).read(tmp_path)
    assert found.faces.tolist() == [list(face) for face in faces]


def test_vertices_without_indices_are_triangles_in_a_row(tmp_path: Path):
    found = Gltf(VERTICES[FACES].reshape(-1, 3), None).read(tmp_path)
    assert np.array_equal(found.vertices[found.faces], VERTICES[FACES])


def test_lines_are_left_out_and_said_so(tmp_path: Path):
    gltf = Gltf()
    gltf.scene["meshes"][0]["primitives"].append({**gltf.primitive, "mode": 1})
    found = gltf.read(tmp_path)
    assert len(found.faces) == len(FACES)
    assert "left out lines, which are not surfaces" in found.notes


def test_nodes_lie_in_each_other_and_a_mirrored_one_still_faces_outward(tmp_path: Path):
    gltf = Gltf()
    turn = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter turn about z
    child = {"mesh": 0, "translation": [1.0, 0.0, 0.0], "rotation": turn, "scale": [1.0, 2.0, -1.0]}
    gltf.scene |= {
        "nodes": [{"children": [1], "scale": [2.0, 2.0, 2.0]}, child],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    found = gltf.read(tmp_path)
    x, y, z = VERTICES.astype(float).T
    assert np.allclose(found.vertices, 2 * np.column_stack([1 - 2 * y, x, -z]))
    assert volume(found) == pytest.approx(16 * BALL)


def test_only_the_nodes_of_the_scene_are_read(tmp_path: Path):
    gltf = Gltf()
    gltf.scene |= {"nodes": [{"mesh": 0}, {"mesh": 0, "translation": [1, 0, 0]}], "scenes": [{"nodes": [1]}]}
    assert np.allclose(gltf.read(tmp_path).vertices, VERTICES + np.array([1.0, 0.0, 0.0]))


def test_hidden_nodes_are_left_out_and_said_so(tmp_path: Path):
    gltf = Gltf()
    hidden = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}, "children": [2]}
    gltf.scene |= {"nodes": [{"mesh": 0}, hidden, {"mesh": 0}], "extensionsRequired": ["KHR_node_visibility"]}
    found = gltf.read(tmp_path)
    assert len(found.faces) == len(FACES)
    assert "left out what the file marks as hidden (KHR_node_visibility)" in found.notes


def test_instances_are_each_put_in_their_places(tmp_path: Path):
    gltf = Gltf()
    attributes = {
        "TRANSLATION": gltf.add(np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32)),
        "ROTATION": gltf.add(np.array([[0, 0, 0, 127], [127, 0, 0, 0], [0, 0, 0, 127]], np.int8), normalized=True),
        "SCALE": gltf.add(np.array([[1, 1, 1], [1, 1, 1], [3, 3, 3]], np.float32)),
    }
    gltf.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    gltf.scene["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    found = gltf.read(tmp_path)
    assert volume(found) == pytest.approx(29 * BALL)
    assert found.vertices[:, 1].max() == pytest.approx(2 + 3 * VERTICES[:, 1].max(), rel=1e-6)


def _with(change: Callable[[Gltf], object]):
    gltf = Gltf()
    change(gltf)
    return gltf


REFUSED = {
    "requires the extension KHR_draco_mesh_compression": lambda g: g.scene.update(
        extensionsRequired=["KHR_draco_mesh_compression"]
    ),
    "requires the extension EXT_meshopt_compression": lambda g: g.scene.update(
        extensionsRequired=["KHR_mesh_quantization", "EXT_meshopt_compression"]
    ),
    "requires the extension X_new_shapes": lambda g: g.scene.update(extensionsRequired=["X_new_shapes"]),
    "a mesh is compressed by KHR_draco_mesh_compression": lambda g: (
        g.primitive.update(extensions={"KHR_draco_mesh_compression": {}}), g.scene["accessors"][0].pop("bufferView")
    ),
    "a mesh is deformed by a skin": lambda g: g.node.update(skin=0),
    "a mesh has morph targets": lambda g: g.primitive.update(targets=[{"POSITION": 0}]),
    "its nodes contain each other in a cycle": lambda g: g.scene.update(
        nodes=[{"children": [0]}], scenes=[{"nodes": [0]}]
    ),
    "faces name vertices 0..": lambda g: g.scene["accessors"][0].update(count=5),
    "announces 9999 rows": lambda g: g.scene["accessors"][1].update(count=9999),
    "are not a multiple of 3": lambda g: g.scene["accessors"][1].update(count=4),
    "has a singular or invalid matrix": lambda g: g.node.update(scale=[1, 0, 1]),
    "corners of faces must be single whole numbers": lambda g: g.scene["accessors"][1].update(componentType=5126),
    "its JSON refers to missing content": lambda g: g.node.update(mesh=7),
    "its JSON has no `asset`": lambda g: g.scene.pop("asset"),
    "has no triangles": lambda g: g.scene.update(nodes=[]),
}  # fmt: skip


@pytest.mark.parametrize("said", REFUSED)
def test_what_is_not_read_is_refused_by_name(tmp_path: Path, said: str):
    with pytest.raises(StageError, match=said) as caught:
        _with(REFUSED[said]).read(tmp_path)
    assert str(caught.value).startswith("ball.glb: ")
    assert "\n" not in str(caught.value)


def test_numbers_in_another_file_are_refused(tmp_path: Path):
    content = Gltf().content(".gltf").decode().partition('"uri": "')[0] + '"uri": "ball.bin"}]}'
    (tmp_path / "ball.gltf").write_text(content)
    with pytest.raises(
        StageError, match=r"keeps its numbers in another file .ball\.bin.; export it as one file, \.glb"
    ):
        read_surface(tmp_path / "ball.gltf")


@pytest.mark.parametrize("extension", ["KHR_materials_unlit", "KHR_texture_transform", "KHR_lights_punctual"])
def test_extensions_of_looks_may_be_required(tmp_path: Path, extension: str):
    gltf = Gltf()
    gltf.scene["extensionsRequired"] = [extension]
    assert len(gltf.read(tmp_path).faces) == len(FACES)


def test_an_odd_change_of_size_is_warned_of_with_its_factor(tmp_path: Path):
    gltf = Gltf()
    gltf.node["scale"] = [5000.0] * 3
    with pytest.warns(PipelineWarning, match="a node changes the size by a factor of 5000; check"):
        gltf.read(tmp_path)
