"""3MF: unit, title, configuration and colour (3MF Core Specification 1.3).

Not written by lib3mf, whose writer multiplies coordinates in float32, an error of up to one step, and writes new UUIDs
each time. lib3mf reads the file back in its strict mode. The second reader is expat, as trimesh needs 2 GB for a
million triangles.
"""

from __future__ import annotations

import zipfile
from array import array
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape

import numpy as np

from scaffold_geometry.files.lib3mf_meshes import mesh_arrays
from scaffold_geometry.files.solids.model import APPLICATION, Mesh, Model, Text, mesh_as_read, rows
from scaffold_geometry.files.solids.readers import reading
from scaffold_pipeline.errors import StageError

_MODEL = "3D/3dmodel.model"
_NAMESPACE = "urn:scaffold-pipeline"
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_CONTENT_TYPES = (
    f'<?xml version="1.0" encoding="UTF-8"?>\n<Types xmlns="{_PACKAGE}/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
)
_RELATIONSHIPS = (
    f'<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="{_PACKAGE}/relationships">'
    f'<Relationship Target="/{_MODEL}" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>\n'
)


def write(path: Path, model: Model) -> None:
    """Write the model as 3MF."""
    is_large = 64 * (len(model.mesh.vertices) + len(model.mesh.faces)) > 2**31  # bytes; not every slicer reads zip64
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as package:  # dated 1980, so repeatable
        for member, parts in (
            ("[Content_Types].xml", iter([_CONTENT_TYPES])),
            ("_rels/.rels", iter([_RELATIONSHIPS])),
            (_MODEL, _text(model)),
        ):
            with package.open(member, "w", force_zip64=is_large) as stream:
                for part in parts:
                    stream.write(part.encode())


def _text(model: Model) -> Text:
    """Yield the XML of the model: nine digits restore each float32 exactly."""
    yield (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en" xmlns="{_CORE}" '
        f'xmlns:scaffold="{_NAMESPACE}">\n'
    )
    metadata = {"Title": model.title, "Application": APPLICATION}
    if model.config_hash is not None:
        metadata["scaffold:config_sha256"] = model.config_hash
    for name, value in metadata.items():
        yield f'<metadata name="{name}" preserve="1">{escape(value)}</metadata>\n'
    yield f'<resources><basematerials id="1"><base name="solid" displaycolor="{model.colour}"/></basematerials>\n'
    yield '<object id="2" type="model" pid="1" pindex="0"><mesh>\n<vertices>\n'
    yield from rows('<vertex x="%.9g" y="%.9g" z="%.9g"/>\n', model.mesh.vertices)
    yield "</vertices>\n<triangles>\n"
    yield from rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', model.mesh.faces)
    yield '</triangles>\n</mesh></object></resources>\n<build><item objectid="2"/></build>\n</model>\n'


def read_by_lib3mf(path: Path) -> Mesh:
    """Return the mesh read by lib3mf in its strict mode; checks the unit, and that lib3mf finds the mesh manifold."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(StrictModeActive=True)
    with reading("3MF", "lib3mf"):
        reader.ReadFromFile(str(path))
    objects = model.GetMeshObjects()
    if model.GetUnit() != lib3mf.ModelUnit.MilliMeter or objects.Count() != 1 or not objects.MoveNext():
        raise StageError(f"must have one object in mm, but has {objects.Count()} in {model.GetUnit().name}")
    mesh = objects.GetCurrentMeshObject()
    if not mesh.IsManifoldAndOriented():
        raise StageError("must be manifold and oriented, but lib3mf says it is not; write what intersect_outer makes")
    return mesh_as_read(*mesh_arrays(mesh))


def read_by_expat(path: Path) -> Mesh:
    """Return the mesh in the XML, read element by element."""
    places, corners = array("d"), array("q")

    def take(tag: str, attributes: dict[str, str]) -> None:
        if tag == "vertex":
            places.extend((float(attributes["x"]), float(attributes["y"]), float(attributes["z"])))
        elif tag == "triangle":
            corners.extend((int(attributes["v1"]), int(attributes["v2"]), int(attributes["v3"])))

    parser = expat.ParserCreate()
    parser.StartElementHandler = take
    with reading("3MF", "expat"), zipfile.ZipFile(path) as package, package.open(_MODEL) as stream:
        parser.ParseFile(stream)
    vertices = np.frombuffer(places, np.float64).reshape(-1, 3)
    return mesh_as_read(vertices, np.frombuffer(corners, np.int64).reshape(-1, 3))
