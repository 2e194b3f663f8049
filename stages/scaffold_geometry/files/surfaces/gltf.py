"""glTF 2.0 (Khronos, "glTF 2.0 specification", 2021), as one binary file (.glb) or as JSON with embedded numbers.

A scene in metres with y up. Not read by trimesh, which does not scale normalised integers, ignores instances, and
returns empty meshes for compressed ones. Unsupported content that affects the shape is refused by its name.
"""

from __future__ import annotations

import json
import struct
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.surfaces.accessors import Accessors
from scaffold_geometry.files.surfaces.polygons import Polygons, of_triangles, split_fan, split_strip
from scaffold_geometry.files.surfaces.transforms import Placed, join_placed
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError

Json = dict[str, Any]

_READ = frozenset({"KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_node_visibility"})
_OF_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_", "KHR_xmp")
"""Prefixes of extensions that affect only the appearance."""
_DRACO = "KHR_draco_mesh_compression"
_MODES = {4: lambda row: row.reshape(-1, 3), 5: split_strip, 6: split_fan}
_MODE_NAMES = ("points", "lines", "line loops", "line strips")
_DEEPEST = 200
"""Most levels of nested nodes; more means a cycle."""
_AS_TRIANGLES = "export it as plain triangles"


def read_gltf(path: Path) -> Polygons:
    """Read the glTF file `path`, GLB or JSON."""
    content = path.read_bytes()
    document, binary = _glb_chunks(content, path.name) if content[:4] == b"glTF" else (content, b"")
    try:
        gltf = json.loads(document.decode("utf-8-sig"))
    except ValueError as error:
        raise StageError(
            f"{path.name}: cannot be read as {path.suffix[1:].upper()}: its JSON is invalid; {AGAIN}"
        ) from error
    try:
        return _Scene(gltf, binary, path.name).polygons()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        reason = " ".join(str(error).split())[:80]
        raise StageError(
            f"{path.name}: cannot be read as {path.suffix[1:].upper()}: its JSON refers to missing content "
            f"({reason}); {AGAIN}"
        ) from error


def _glb_chunks(content: bytes, name: str) -> tuple[bytes, bytes]:
    """Return the JSON and the binary chunk of a GLB."""
    if len(content) < 20 or struct.unpack_from("<I", content, 4) != (2,):  # header and chunk header, in bytes
        raise StageError(f"{name}: cannot be read as GLB: its header is not that of version 2; {AGAIN}")
    (length,) = struct.unpack_from("<I", content, 8)
    if length > len(content):
        raise StageError(f"{name}: announces {length} bytes, but has {len(content)}: it is cut off; {AGAIN}")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, at)
        if at + 8 + size > length:
            raise StageError(f"{name}: a part of it announces {size} bytes, but {length - at - 8} follow; {AGAIN}")
        chunks.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise StageError(f"{name}: cannot be read as GLB: it holds no JSON; {AGAIN}")
    return chunks[b"JSON"], chunks.get(b"BIN\0", b"")


class _Scene:
    """The scene of a file: its nodes with their transforms."""

    def __init__(self, gltf: Json, binary: bytes, name: str) -> None:
        if not isinstance(gltf, dict) or "asset" not in gltf:
            raise StageError(f"{name}: cannot be read as glTF: its JSON has no `asset`; {AGAIN}")
        self._gltf, self._name, self._left_out = gltf, name, list[str]()
        self._require_readable()
        buffers = [_buffer(of, binary if k == 0 else b"", name) for k, of in enumerate(gltf.get("buffers", []))]
        self._accessors = Accessors(gltf, buffers, name)
        self._meshes: dict[int, tuple[Floats, Ints]] = {}
        self._coded: set[int] = set()

    def polygons(self) -> Polygons:
        """Return the triangles of all nodes of the scene, in metres."""
        placed: list[Placed] = []
        for root in self._roots():
            self._walk(root, np.eye(4), 0, placed)
        vertices, faces, doubts = join_placed(placed, "node", self._name)
        return of_triangles(vertices, faces)._replace(
            unit="m", up="y", notes=tuple(dict.fromkeys(self._left_out)), doubts=doubts
        )

    def _require_readable(self) -> None:
        required = self._gltf.get("extensionsRequired", [])
        unknown = [name for name in required if name not in _READ and not str(name).startswith(_OF_LOOKS)]
        if unknown:
            names = ", ".join(map(str, unknown))
            raise StageError(f"{self._name}: requires the extension {names}, which is not supported; {_AS_TRIANGLES}")

    def _roots(self) -> list[int]:
        scenes = self._gltf.get("scenes", [])
        nodes = self._gltf.get("nodes", [])
        if scenes:
            return list(scenes[self._gltf.get("scene", 0)].get("nodes", []))
        below = {child for node in nodes for child in node.get("children", [])}
        return [k for k in range(len(nodes)) if k not in below]

    def _walk(self, number: int, above: Floats, depth: int, placed: list[Placed]) -> None:
        if depth > _DEEPEST:
            raise StageError(f"{self._name}: its nodes contain each other in a cycle; {AGAIN}")
        node = _item(self._gltf["nodes"], number)
        if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True):
            self._left_out.append("left out what the file marks as hidden (KHR_node_visibility)")
            return
        matrix = above @ _matrix(node)
        if "mesh" in node:
            if "skin" in node:
                raise StageError(
                    f"{self._name}: a mesh is deformed by a skin (bones), which is not supported; {_AS_TRIANGLES}"
                )
            vertices, faces = self._mesh(node["mesh"])
            is_coded = node["mesh"] in self._coded
            placed += [Placed(vertices, faces, matrix @ instance, is_coded) for instance in self._instances(node)]
        for child in node.get("children", []):
            self._walk(child, matrix, depth + 1, placed)

    def _instances(self, node: Json) -> list[Floats]:
        """Return the matrices of a node's instances; the identity if it has none."""
        instancing = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        if instancing is None:
            return [np.eye(4)]
        columns = {
            key: self._accessors.values(instancing["attributes"][key])
            for key in ("TRANSLATION", "ROTATION", "SCALE")
            if key in instancing["attributes"]
        }
        if len({len(column) for column in columns.values()}) != 1:
            raise StageError(
                f"{self._name}: its instances have no translations, or not as many as rotations and scales; {AGAIN}"
            )
        names = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        count = len(next(iter(columns.values())))
        return [_matrix({names[key]: column[k] for key, column in columns.items()}) for k in range(count)]

    def _mesh(self, number: int) -> tuple[Floats, Ints]:
        """Return the vertices and triangles of all primitives of a mesh."""
        if number not in self._meshes:
            primitives = _item(self._gltf["meshes"], number)["primitives"]
            parts = [self._primitive(part) for part in primitives]
            if any(
                self._accessors.is_coded(part["attributes"]["POSITION"])
                for part in primitives
                if "POSITION" in part.get("attributes", {})
            ):
                self._coded.add(number)
            starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
            self._meshes[number] = (
                np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in parts)]),
                np.concatenate(
                    [np.empty((0, 3), np.int64), *(f + s for (_, f), s in zip(parts, starts, strict=False))]
                ),
            )
        return self._meshes[number]

    def _primitive(self, primitive: Json) -> tuple[Floats, Ints]:
        mode = primitive.get("mode", 4)  # triangles
        nothing = np.empty((0, 3)), np.empty((0, 3), np.int64)
        if mode not in _MODES:
            self._left_out.append(f"left out {_MODE_NAMES[mode]}, which are not surfaces")
            return nothing
        if primitive.get("targets"):
            raise StageError(f"{self._name}: a mesh has morph targets, which are not supported; {_AS_TRIANGLES}")
        attributes = primitive.get("attributes", {})
        if "POSITION" not in attributes:
            self._left_out.append("left out a mesh without positions")
            return nothing
        is_draco = _DRACO in primitive.get("extensions", {})
        if is_draco and "bufferView" not in _item(self._gltf["accessors"], attributes["POSITION"]):
            raise StageError(f"{self._name}: a mesh is compressed by {_DRACO}, which is not supported; {_AS_TRIANGLES}")
        vertices = self._accessors.values(attributes["POSITION"])
        if vertices.shape[1] != 3:  # x, y, z
            raise StageError(f"{self._name}: its positions have {vertices.shape[1]} coordinates, must have 3; {AGAIN}")
        row = self._accessors.indices(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))
        if mode == 4 and len(row) % 3:
            raise StageError(f"{self._name}: {len(row)} corners of triangles are not a multiple of 3; {AGAIN}")
        if len(row) and (row.min() < 0 or row.max() >= len(vertices)):
            raise StageError(
                f"{self._name}: faces name vertices {row.min()}..{row.max()}, but those of the mesh are "
                f"0..{len(vertices) - 1}; {AGAIN}"
            )
        return vertices, _MODES[mode](row)


def _item(rows: list[Any], number: int) -> Json:
    """Return an item by its number, which must be 0 or more."""
    if not isinstance(number, int) or number < 0:
        raise IndexError(f"{number!r} is not an index")
    return dict(rows[number])


def _buffer(buffer: Json, binary: bytes, name: str) -> bytes:
    """Return the bytes of a buffer, which must be in the file itself, as the run's record has only its hash."""
    uri = buffer.get("uri")
    if uri is None:
        content = binary
    elif str(uri).startswith("data:"):
        content = b64decode(str(uri).partition(",")[2], validate=True)
    else:
        raise StageError(f"{name}: keeps its numbers in another file ({str(uri)[:60]}); export it as one file, .glb")
    is_fallback = any("meshopt" in key for key in buffer.get("extensions", {}))
    if len(content) < buffer["byteLength"] and not is_fallback:
        raise StageError(f"{name}: announces {buffer['byteLength']} bytes of numbers, but has {len(content)}; {AGAIN}")
    return content


def _matrix(node: Json) -> Floats:
    """Return the matrix of a node: as given, or from its scale, rotation and translation in this order."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(node.get("rotation", (0.0, 0.0, 0.0, 1.0))) * np.array(
        node.get("scale", (1.0, 1.0, 1.0))
    )
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _rotation(quaternion: Any) -> Floats:  # noqa: ANN401 - four numbers of JSON or of an array
    """Return the matrix of a quaternion x, y, z, w."""
    x, y, z, w = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
