"""3MF (3MF Core Specification 1.3): its build items, read by lib3mf in a child process, which may crash.

lib3mf reads components, transforms and parts of the production extension. It silently ignores unknown extensions and
data of slicers beside the model, so `package` checks for these first.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.lib3mf_meshes import mesh_arrays
from scaffold_geometry.files.surfaces.package import require_readable, with_content_types
from scaffold_geometry.files.surfaces.polygons import Polygons, of_triangles
from scaffold_geometry.files.surfaces.transforms import Placed, join_placed
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import call_in_child

READING_SECONDS = 300.0
"""Time limit: lib3mf reads a million triangles in about ten seconds."""

_UNITS = {"MicroMeter": "micron", "MilliMeter": "mm", "CentiMeter": "cm", "Inch": "inch", "Foot": "foot", "Meter": "m"}
_DEEPEST = 100
"""Most levels of nested components; more means a cycle."""
_NO_MODEL_VOLUMES = ("cura:infill_mesh", "cura:cutting_mesh", "cura:anti_overhang_mesh", "cura:support_mesh")
_CHECKED_UUIDS = 0x80B0
"""lib3mf's warning of a missing UUID, which does not affect the shape."""
_AS_TRIANGLES = "export it as plain triangles"


def read_three_mf(path: Path) -> Polygons:
    """Read the 3MF file `path`."""
    require_readable(path)
    about = f"{path.name} cannot be read as 3MF; export it again, as triangles only"
    scalars: dict[str, str | int | float | bool | None] = {"path": str(path.resolve())}
    found = call_in_child(three_mf_triangles, {}, scalars, seconds=READING_SECONDS, about=about)
    if "refusal" in found:
        raise StageError(f"{path.name}: {found['refusal']}")
    return of_triangles(found["vertices"], found["faces"])._replace(
        unit=str(found["unit"]), notes=tuple(found["notes"].tolist()), doubts=tuple(found["doubts"].tolist())
    )


def three_mf_triangles(*, path: str) -> dict[str, NDArray[Any]]:
    """Return `vertices`, `faces`, `unit`, `notes` and `doubts` of a file, or its `refusal`; for the child process."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(StrictModeActive=False)
    try:
        reader.ReadFromFile(with_content_types(path))
    except lib3mf.ELib3MFException as error:
        return {"refusal": np.array(f"cannot be read as 3MF: lib3mf says {_words(error)}; export it again")}
    complaints = [reader.GetWarning(k) for k in range(reader.GetWarningCount())]
    try:
        build = _Build(model)
        vertices, faces, doubts = build.triangles()
    except StageError as error:
        return {"refusal": np.array(str(error))}
    notes = [
        *build.notes,
        *dict.fromkeys(f"lib3mf: {message}" for code, message in complaints if code != _CHECKED_UUIDS),
    ]
    return {
        "vertices": vertices,
        "faces": faces,
        "unit": np.array(_UNITS[model.GetUnit().name]),
        "notes": np.array(notes, np.str_),
        "doubts": np.array(doubts, np.str_),
    }


def _words(error: Exception) -> str:
    return " ".join(str(error).split()).partition(": ")[2][:100] or type(error).__name__


class _Item(NamedTuple):
    """An object, its transform, and its level of nesting."""

    object: Any
    matrix: Floats
    depth: int


class _Build:
    """The objects of a model's build items with their transforms; lib3mf identifies objects by part and number."""

    def __init__(self, model: Any) -> None:  # noqa: ANN401 - lib3mf ships no types
        self._model = model
        self._meshes: dict[int, tuple[Floats, Ints]] = {}
        self.notes: list[str] = []

    def triangles(self) -> tuple[Floats, Ints, tuple[str, ...]]:
        """Return vertices and faces of all build items, and warnings for the user."""
        items = self._model.GetBuildItems()
        if not items.Count():
            raise StageError(
                "has no build items, so no object has a position; put the object on the plate and export it again"
            )
        placed: list[Placed] = []
        while items.MoveNext():
            item = items.GetCurrent()
            matrix = _matrix(item.GetObjectTransform()) if item.HasObjectTransform() else np.eye(4)
            self._place(_Item(item.GetObjectResource(), matrix, 0), placed)
        if not placed:
            rest = "; ".join(self.notes) or "all are empty"
            raise StageError(f"builds no object of type model ({rest}); {_AS_TRIANGLES}")
        vertices, faces, doubts = join_placed(placed, "component", "its build")
        return vertices, faces, doubts

    def _place(self, item: _Item, placed: list[Placed]) -> None:
        thing, matrix, depth = item
        kind = thing.GetType().name.lower()
        if kind != "model":
            self.notes.append(f"left out object {thing.GetModelResourceID()} of type {kind}")
        elif depth > _DEEPEST:
            raise StageError(f"its components contain each other in a cycle; {AGAIN}")
        elif thing.IsMeshObject():
            vertices, faces = self._mesh(thing)
            placed += [Placed(vertices, faces, matrix)] if len(faces) else []
        elif thing.IsComponentsObject():
            for k in range(thing.GetComponentCount()):
                component = thing.GetComponent(k)
                inner = _matrix(component.GetTransform()) if component.HasTransform() else np.eye(4)
                self._place(_Item(component.GetObjectResource(), matrix @ inner, depth + 1), placed)
        else:
            raise StageError(
                f"object {thing.GetModelResourceID()} is an implicit or volumetric shape, which is not supported; "
                f"{_AS_TRIANGLES}"
            )

    def _mesh(self, mesh: Any) -> tuple[Floats, Ints]:  # noqa: ANN401
        number = mesh.GetUniqueResourceID()
        if number not in self._meshes:
            self._require_plain(mesh)
            vertices, faces = mesh_arrays(mesh)
            self._meshes[number] = vertices.astype(np.float64), faces.astype(np.int64)
        return self._meshes[number]

    def _require_plain(self, mesh: Any) -> None:  # noqa: ANN401
        """Require that a mesh is the whole shape of its object."""
        name = f"object {mesh.GetModelResourceID()}"
        if mesh.BeamLattice().GetBeamCount():
            raise StageError(f"{name} has beams (the beam lattice extension), which are not supported; {_AS_TRIANGLES}")
        if mesh.HasSlices(Recursive=True) and mesh.GetSlicesMeshResolution().name == "Lowres":
            raise StageError(
                f"{name} is given by slices (the slice extension), which are not supported; {_AS_TRIANGLES}"
            )
        described = mesh.GetMetaDataGroup()
        for k in range(described.GetMetaDataCount()):
            entry = described.GetMetaData(k)
            key = f"{entry.GetNameSpace()}:{entry.GetName()}".rpartition("/")[2]
            if key.endswith(tuple(of.partition(":")[2] for of in _NO_MODEL_VOLUMES)) and entry.GetValue() == "True":
                raise StageError(f"{name} is not a separate body for the slicer ({entry.GetName()}); remove it there")


def _matrix(transform: Any) -> Floats:  # noqa: ANN401
    """Return lib3mf's transform as a matrix for column vectors: lib3mf stores it for row vectors."""
    rows = np.array([[transform.Fields[i][j] for j in range(3)] for i in range(4)], np.float64)
    matrix = np.eye(4)
    matrix[:3] = rows.T
    return matrix
