"""Stage `draw_mesh`: a picture of a mesh, with its edges (struts) and channels, for comparison with the solid."""

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
    """Whether to draw the channels, from cell centre to face centre, thinner and blue."""


DRAWINGS = (Drawing("mesh.png", "Mesh", "Struts along the edges of the mesh, channels from cell to cell."),)


@stage(writes="mesh_picture", version=1, drawings=DRAWINGS)
def draw_mesh(mesh: CellMesh, *, params: DrawMeshParams, out: Path) -> WrittenFiles:
    """Draw the edges and channels of a mesh to `mesh.png`, in the view of `preview.png`."""
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    channels = np.stack([skeleton.channel_starts, skeleton.channel_ends], axis=1)
    arrays = {"struts": mesh.vertices[mesh.edges], "channels": channels[: len(channels) if params.channels else 0]}
    return WrittenFiles({"mesh_picture": draw_in_child(draw_segments, arrays, out / "mesh.png")})
