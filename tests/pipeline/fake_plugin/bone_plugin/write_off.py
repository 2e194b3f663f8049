"""Stage `write_off`: the solid as OFF, read back by two programs and checked like the files of `write_solid`."""

from __future__ import annotations

from pathlib import Path

from scaffold_geometry.files.solids.checks import FileVerifier, expect_solid
from scaffold_geometry.files.solids.formats import FileFormat
from scaffold_geometry.files.solids.model import Mesh, Model, rows
from scaffold_geometry.files.solids.readers import mesh_by_trimesh, mesh_by_vtk
from scaffold_geometry.files.solids.writing import round_to_float32, write_verified
from scaffold_pipeline.artifacts import Solid, WrittenFiles
from scaffold_pipeline.stages.contract import Params, Title, stage


class WriteOffParams(Params):
    """Parameters of `write_off`."""

    name: Title = "scaffold"
    """Title, a comment in the file."""


@stage(writes="off_file", version=1)
def write_off(solid: Solid, *, params: WriteOffParams, out: Path, config_hash: str | None = None) -> WrittenFiles:
    """Write the solid as `solid.off`: text, mm, float32 coordinates without loss."""
    model = Model(round_to_float32(solid), params.name, "#E3DAC9", config_hash)
    path = out / "solid.off"
    volume = write_verified(path, OFF, model, FileVerifier(model.mesh, expect_solid(solid)))
    return WrittenFiles({"off_triangles": len(model.mesh.faces), "off_volume_mm3": volume})


def write(path: Path, model: Model) -> None:
    """Write the model as OFF; nine digits restore each float32 exactly."""
    vertices, faces = model.mesh
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(f"OFF\n# {model.title}; {model.notes}\n{len(vertices)} {len(faces)} 0\n")
        stream.writelines(rows("%.9g %.9g %.9g\n", vertices))
        stream.writelines(rows("3 %d %d %d\n", faces))


def read_by_trimesh(path: Path) -> Mesh:
    """Return the mesh read by trimesh."""
    return mesh_by_trimesh(path, "OFF")


def read_by_vtk(path: Path) -> Mesh:
    """Return the mesh read by VTK."""
    from vtkmodules.vtkIOGeometry import vtkOFFReader

    return mesh_by_vtk(vtkOFFReader(), path, "OFF")


OFF = FileFormat(write, {"trimesh": read_by_trimesh, "VTK": read_by_vtk})
