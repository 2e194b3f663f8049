"""Stage `write_field`: the field in files for other programs, for checks and further use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from scaffold_pipeline.artifacts import Fact, ScalarField, WrittenFiles
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.runs.store import hash_file
from scaffold_pipeline.stages.contract import EachOnce, InputFile, Params, stage

Format = Literal["vti", "nrrd", "npy"]


class WriteFieldParams(Params):
    """Parameters of `write_field`."""

    formats: Annotated[tuple[Format, ...], EachOnce] = Field(default=("vti", "nrrd", "npy"), min_length=1)
    """Files to write: `field.vti`, `field.nrrd`, and `field.npy` with `field.json`."""

    points: InputFile | None = None
    """CSV file of points x, y, z in mm; the exact field there, without voxels, is written to `field_at_points.csv`."""


@stage(writes="field_files", version=1)
def write_field(field: ScalarField, *, params: WriteFieldParams, out: Path) -> WrittenFiles:
    """Write the field on its voxels as VTI, NRRD and NPY, with origin and spacing in mm, and at points as CSV.

    Each file is read back and compared. Raises `StageError` if a file differs from the field, or if `points` is given
    but the field was not evaluated there.
    """
    if params.points is not None and not len(field.points):
        raise StageError(
            f"points: the field was not evaluated at {params.points.name}, as its stage has no `points`; leave it out"
        )
    facts: dict[str, Fact] = {}
    for kind in params.formats:
        path = out / f"field.{kind}"
        _WRITERS[kind](path, field)
        _require_equal(path, _READERS[kind](path), field)
        facts |= {f"{kind}_bytes": path.stat().st_size, f"{kind}_sha256": hash_file(path)}
    if len(field.points):
        rows = np.column_stack([field.points, field.point_values])
        np.savetxt(out / "field_at_points.csv", rows, "%.17g", ",", header="x,y,z,s", comments="")
        facts["points"] = len(rows)
    return WrittenFiles(facts)


def _require_equal(path: Path, values: np.ndarray, field: ScalarField) -> None:
    """Require that the samples read from a file, first axis fastest, are those of the field."""
    if not np.array_equal(values, field.values.ravel(order="F")):
        path.unlink()
        raise StageError(f"{path.name}: differs from the field when read back; the file was deleted, run again")


def _write_vti(path: Path, field: ScalarField) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    image = vtkImageData()
    image.SetDimensions(*field.values.shape)
    image.SetOrigin(*field.origin)
    image.SetSpacing(field.spacing, field.spacing, field.spacing)
    scalars = numpy_to_vtk(field.values.ravel(order="F"), deep=True)
    scalars.SetName("s")
    image.GetPointData().SetScalars(scalars)
    writer = vtkXMLImageDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    writer.SetCompressorTypeToZLib()
    if not writer.Write():
        raise StageError(f"{path.name}: cannot be written; check the free space on the disk")


def _read_vti(path: Path) -> np.ndarray:
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    return _samples_from(vtkXMLImageDataReader(), path)


def _samples_from(reader: Any, path: Path) -> np.ndarray:  # noqa: ANN401 - VTK's readers have no type in common
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader.SetFileName(str(path))
    reader.Update()
    return np.ravel(vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars()))


def _write_nrrd(path: Path, field: ScalarField) -> None:
    """Write NRRD 4 (teem.sourceforge.net/nrrd/format.html): a text header, an empty line, the first axis fastest."""
    step = f"{field.spacing:.17g}"
    header = {
        "type": "float",
        "dimension": "3",
        "space dimension": "3",
        "sizes": " ".join(map(str, field.values.shape)),
        "kinds": "domain domain domain",
        "space directions": f"({step},0,0) (0,{step},0) (0,0,{step})",
        "space units": '"mm" "mm" "mm"',
        "space origin": f"({','.join(f'{x:.17g}' for x in field.origin)})",
        "endian": "little",
        "encoding": "raw",
    }
    lines = ["NRRD0004", *(f"{name}: {value}" for name, value in header.items())]
    with path.open("wb") as stream:
        stream.write("\n".join(lines).encode("ascii") + b"\n\n")
        stream.write(field.values.astype("<f4").tobytes(order="F"))


def _read_nrrd(path: Path) -> np.ndarray:
    """Read the values back with VTK, which takes a first axis of up to four samples as components."""
    from vtkmodules.vtkIOImage import vtkNrrdReader

    return _samples_from(vtkNrrdReader(), path)


def _write_npy(path: Path, field: ScalarField) -> None:
    np.save(path, field.values, allow_pickle=False)
    place = {"origin": field.origin.tolist(), "spacing": field.spacing, "shape": list(field.values.shape), "unit": "mm"}
    path.with_suffix(".json").write_text(json.dumps(place, indent=2) + "\n", encoding="utf-8")


def _read_npy(path: Path) -> np.ndarray:
    values: np.ndarray = np.load(path, allow_pickle=False)
    return values.ravel(order="F")


_WRITERS: dict[str, Callable[[Path, ScalarField], None]] = {"vti": _write_vti, "nrrd": _write_nrrd, "npy": _write_npy}
_READERS: dict[str, Callable[[Path], np.ndarray]] = {"vti": _read_vti, "nrrd": _read_nrrd, "npy": _read_npy}
