"""Binary glTF 2.0 (Khronos, "glTF 2.0 specification"): a scene in metres with y up, as the format defines both.

The stored positions are the same as in the other files, mm in the input's axes, to the bit; the matrix of the single
node converts them to metres with y up. A reader that applies it in float32 rounds once more.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scaffold_geometry.files.solids.model import APPLICATION, Mesh, Model, mesh_as_read
from scaffold_geometry.files.solids.readers import mesh_of_polydata, reading
from scaffold_pipeline.errors import StageError

TO_METRES_Y_UP = ((0.001, 0.0, 0.0, 0.0), (0.0, 0.0, 0.001, 0.0), (0.0, -0.001, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""The node's matrix, by rows: x, y, z in mm become x, z, -y in m."""


def write(path: Path, model: Model) -> None:
    """Write the model as GLB."""
    import trimesh

    look = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name="solid"))
    scene = trimesh.Scene()
    scene.add_geometry(
        trimesh.Trimesh(*model.mesh, process=False, visual=look),
        node_name="solid",
        transform=np.array(TO_METRES_Y_UP),
    )
    path.write_bytes(scene.export(file_type="glb", include_normals=False, tree_postprocessor=partial(_complete, model)))


def _complete(model: Model, tree: dict[str, Any]) -> None:
    """Add to the JSON of a file what trimesh does not write, or writes with too few digits."""
    extras = {**model.notes, "note": "positions are mm in the input's axes; the node's matrix gives metres, y up"}
    tree["asset"] |= {"generator": APPLICATION, "extras": extras}
    tree["scenes"][0]["name"] = tree["nodes"][0]["name"] = model.title
    tree["materials"][0]["pbrMetallicRoughness"] = {
        "baseColorFactor": _linear(model.colour),
        "metallicFactor": 0.0,
        "roughnessFactor": 0.8,
    }


def _linear(colour: str) -> list[float]:
    """Return red, green, blue and alpha in linear light, as glTF requires (IEC 61966-2-1)."""
    shares = [int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return [*(round(share, 6) for share in linear), 1.0]


def read_by_trimesh(path: Path) -> Mesh:
    """Return the mesh read by trimesh, without the node's matrix, which must be the one to metres."""
    import trimesh

    with reading("GLB", "trimesh"):
        scene = trimesh.load_scene(path, process=False)
        (node,) = scene.graph.nodes_geometry
        matrix, name = scene.graph[node]
        if not np.array_equal(matrix, TO_METRES_Y_UP):
            raise StageError(f"must be in metres with y up, but its node's matrix is {matrix.tolist()}")
        return mesh_as_read(scene.geometry[name].vertices, scene.geometry[name].faces)


def read_by_vtk(path: Path) -> Mesh:
    """Return the mesh read by VTK, without the node's matrix."""
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
