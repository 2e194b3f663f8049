"""Stage `mesh_solid`: fill the solid with tetrahedra for finite elements, and write files for FE programs."""

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
    "the solid itself is stored: without mesh_solid in the config, the same command writes its files without computing "
    "it again"
)

Format = Literal["vtu", "inp"]


class MeshSolidParams(Params):
    """Parameters of `mesh_solid`."""

    edge_length: Millimetres | None = Field(default=None, gt=0.0)
    """Edge length of the tetrahedra; by default 2 volume / area of the solid, about half the strut thickness."""

    formats: Annotated[tuple[Format, ...], EachOnce] = Field(default=("vtu", "inp"), min_length=1)
    """Files to write, in mm: `solid_mesh.vtu`, `solid_mesh.inp` (Abaqus, C3D4)."""

    time_limit: Annotated[float, Unit("s")] = Field(default=3600.0, gt=0.0)
    """Time limit of the meshing."""


@stage(writes="solid_mesh", version=1, repeatable=False)
def mesh_solid(solid: Solid, *, params: MeshSolidParams, out: Path) -> VolumeMesh:
    """Fill the solid with tetrahedra for finite elements, written as VTU and Abaqus INP and read back.

    Coordinates are float64 in mm. fTetWild is not deterministic: the mesh is stored, and later runs use it. Meshing
    takes minutes, more with more struts. Raises `StageError` if fTetWild crashes or takes more than `time_limit`, if
    the volume or the number of pieces differs from the solid's, or if a file differs from the mesh when read back.
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
