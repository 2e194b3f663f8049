"""Stage `mesh_solid`: the solid filled with tetrahedra for finite elements, in files that their programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from scaffold_geometry.files.solids.finite_elements import WRITERS, require_read_back
from scaffold_geometry.volumes.tetrahedra import mesh_of
from scaffold_pipeline.artifacts import Solid, VolumeMesh
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import EachOnce, Millimetres, Params, Unit, stage

_KEPT = (
    "the solid is stored all the same: without mesh_solid in the config, the same command writes its files and does "
    "not compute it again"
)

Format = Literal["vtu", "inp"]


class MeshSolidParams(Params):
    """Parameters of `mesh_solid`."""

    edge_length: Millimetres | None = Field(default=None, gt=0.0)
    """Edge length of the tetrahedra; by default twice the solid's volume over its area, half a strut's thickness."""

    formats: Annotated[tuple[Format, ...], EachOnce] = Field(default=("vtu", "inp"), min_length=1)
    """The files to write, `solid_mesh.vtu` and `solid_mesh.inp` (Abaqus, C3D4), each once; mm."""

    time_limit: Annotated[float, Unit("s")] = Field(default=3600.0, gt=0.0)
    """Time after which the mesh is given up."""


@stage(writes="solid_mesh", version=1, repeatable=False)
def mesh_solid(solid: Solid, *, params: MeshSolidParams, out: Path) -> VolumeMesh:
    """Fill the solid with tetrahedra for finite elements, written as VTU and Abaqus INP and read back.

    Coordinates are mm in float64. fTetWild cannot repeat itself: the result is stored, and a later run goes on from it.
    It takes minutes, and longer the more struts there are. Raises `StageError` where fTetWild dies or takes more than
    `time_limit`, the cells have another volume or other pieces than the solid, or a file does not give them back.
    """
    try:
        mesh = mesh_of(solid, params.edge_length, params.time_limit)
        for kind in params.formats:
            _write_checked(kind, out / f"solid_mesh.{kind}", mesh)
    except StageError as error:
        raise StageError(f"{error}; {_KEPT}") from error
    return mesh


def _write_checked(kind: Format, path: Path, mesh: VolumeMesh) -> None:
    try:
        WRITERS[kind](path, mesh)
        require_read_back(path, mesh)
    except StageError as error:
        raise StageError(f"{path.name}: {error}") from error
