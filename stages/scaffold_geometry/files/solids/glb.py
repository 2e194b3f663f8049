"""Binary glTF 2.0 (Khronos, "glTF 2.0 specification"): a scene in metres with y up, as the format defines both.

The stored positions are those of the other files, mm in the input's axes to the bit; the matrix of the one node takes
them to metres and turns z up. A reader that applies it in float32 rounds once more.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.files.solids.model import APPLICATION, Mesh, Model, mesh_as_read
from scaffold_geometry.files.solids.readers import mesh_of_polydata, reading
from scaffold_pipeline.errors import StageError

TO_METRES_Y_UP = ((0.001, 0.0, 0.0, 0.0), (0.0, 0.0, 0.001, 0.0), (0.0, -0.001, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""The node's matrix, by rows: x, y, z in mm become x, z, -y in m."""

_FLOAT, _UINT32 = 5126, 5125
_VERTEX_DATA, _INDEX_DATA = 34962, 34963


def write(path: Path, model: Model) -> None:
    """Write the model as GLB."""
    vertices = model.mesh.vertices.astype("<f4").tobytes()  # of 12 bytes each, so that the indices stay aligned
    faces = model.mesh.faces.astype("<u4").tobytes()
    text = json.dumps(_scene(model, len(vertices), len(faces)), separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(b"JSON", [text]), (b"BIN\0", [vertices, faces])]
    with path.open("wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, 12 + 16 + len(text) + len(vertices) + len(faces)))
        for name, parts in chunks:
            stream.write(struct.pack("<I4s", sum(map(len, parts)), name))
            stream.writelines(parts)


def _scene(model: Model, vertex_bytes: int, face_bytes: int) -> dict[str, Any]:
    """Return the JSON of the file: one scene, node, mesh, material and buffer."""
    vertices, faces = model.mesh
    extras = {**model.notes, "note": "positions are mm in the input's axes; the node's matrix gives metres, y up"}
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": vertex_bytes, "target": _VERTEX_DATA},
        {"buffer": 0, "byteOffset": vertex_bytes, "byteLength": face_bytes, "target": _INDEX_DATA},
    ]
    positions = {
        "bufferView": 0,
        "componentType": _FLOAT,
        "count": len(vertices),
        "type": "VEC3",
        "min": vertices.min(axis=0).tolist(),
        "max": vertices.max(axis=0).tolist(),
    }
    indices = {"bufferView": 1, "componentType": _UINT32, "count": faces.size, "type": "SCALAR"}
    shine = {"baseColorFactor": _linear(model.colour), "metallicFactor": 0.0, "roughnessFactor": 0.8}
    columns = [row[column] for column in range(4) for row in TO_METRES_Y_UP]
    return {
        "asset": {"version": "2.0", "generator": APPLICATION, "extras": extras},
        "scene": 0,
        "scenes": [{"name": model.title, "nodes": [0]}],
        "nodes": [{"name": model.title, "mesh": 0, "matrix": columns}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0, "mode": 4}]}],
        "materials": [{"name": "solid", "pbrMetallicRoughness": shine}],
        "accessors": [positions, indices],
        "bufferViews": views,
        "buffers": [{"byteLength": vertex_bytes + face_bytes}],
    }


def _linear(colour: str) -> list[float]:
    """Return red, green, blue and alpha in the linear light that glTF asks for (IEC 61966-2-1)."""
    shares = [int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return [*(round(share, 6) for share in linear), 1.0]


def read_by_trimesh(path: Path) -> Mesh:
    """Return what trimesh reads, before the node's matrix, which must be the one to metres."""
    import trimesh

    with reading("GLB", "trimesh"):
        scene = trimesh.load_scene(path, process=False)
        (node,) = scene.graph.nodes_geometry
        matrix, name = scene.graph[node]
        if not np.array_equal(matrix, TO_METRES_Y_UP):
            raise StageError(f"must be placed in metres with y up, but its node's matrix is {matrix.tolist()}")
        return mesh_as_read(scene.geometry[name].vertices, scene.geometry[name].faces)


def read_by_vtk(path: Path) -> Mesh:
    """Return what VTK reads, before the node's matrix."""
    from vtkmodules.vtkIOGeometry import vtkGLTFReader

    with reading("GLB", "VTK"):
        reader = vtkGLTFReader()
        reader.SetFileName(str(path))
        reader.ApplyDeformationsToGeometryOff()
        reader.Update()
        block = reader.GetOutput()
        while hasattr(block, "GetNumberOfBlocks"):
            block = block.GetBlock(0)
        return mesh_of_polydata(block, "GLB")
