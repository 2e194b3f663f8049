"""Stage `draw_mesh`: a picture of a mesh, its edges as struts and its channels, to look at beside the solid."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scaffold_geometry.drawing.renders import draw_in_child, draw_segments
from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_pipeline.artifacts import CellMesh, Drawing, WrittenFiles
from scaffold_pipeline.stages.contract import Params, stage


class DrawMeshParams(Params):
    """Parameters of `draw_mesh`."""

    channels: bool = True
    """Whether the channels, cell centre to face centre, are drawn too, thinner and in blue."""


DRAWINGS = (Drawing("mesh.png", "Mesh", "Struts along the edges of the mesh, channels from cell to cell."),)


@stage(writes="mesh_picture", version=1, drawings=DRAWINGS)
def draw_mesh(mesh: CellMesh, *, params: DrawMeshParams, out: Path) -> WrittenFiles:
    """Draw the edges of a mesh, and its channels, as `mesh.png`, in the view that `preview.png` has."""
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    channels = np.stack([skeleton.channel_starts, skeleton.channel_ends], axis=1)
    arrays = {"struts": mesh.vertices[mesh.edges], "channels": channels[: len(channels) if params.channels else 0]}
    return WrittenFiles({"mesh_picture": draw_in_child(draw_segments, arrays, out / "mesh.png")})
