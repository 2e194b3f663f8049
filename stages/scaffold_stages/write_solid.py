"""Stage `write_solid`: the solid as STL and 3MF, each file read back and checked, and a picture of it.

The 3MF text is written here, not by lib3mf: its writer multiplies coordinates in float32, so they come back
up to one float32 step off, and it gives new UUIDs each time. lib3mf reads the file back, in its strict mode.
"""

from __future__ import annotations

import ctypes
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from scaffold_pipeline import __version__
from scaffold_pipeline.artifacts import Fact, Ints, Solid, SurfaceMesh, WrittenFiles
from scaffold_pipeline.contract import Params, stage
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.isolation import call_in_child
from scaffold_pipeline.store import hash_file
from scaffold_stages._kernels.picture import draw_surface
from scaffold_stages._kernels.stl import Singles, merge_corners, to_single, to_stl

VOLUME_TOLERANCE = 1e-4
"""How far the volume of a file may be from that of the solid, as a share of it."""

RENDER_SECONDS = 300.0
"""Time for a picture; one of 8 million triangles takes half a minute on two busy cores, without a GPU."""

_WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow") if sys.platform == "linux" else ("",)

_REMEDY = (
    "write what intersect_outer makes, which is closed and exact in float32; where the shape lies far from the "
    "origin, move it nearer"
)

_ROWS_AT_ONCE = 1 << 16
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
    '<Relationship Target="/3D/3dmodel.model" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>\n'
)


class WriteSolidParams(Params):
    """Parameters of `write_solid`."""

    formats: tuple[Literal["stl", "3mf"], ...] = Field(default=("stl", "3mf"), min_length=1)
    """The files to write, `solid.stl` and `solid.3mf`, each once."""

    name: str = Field(default="scaffold", min_length=1, max_length=200)
    """Title in the 3MF file."""

    preview: bool = True
    """Whether to draw `preview.png`."""

    @field_validator("formats")
    @classmethod
    def _each_once(cls, formats: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(formats)) != len(formats):
            raise ValueError(f"must name each format once, got {', '.join(formats)}")
        return formats

    @field_validator("name")
    @classmethod
    def _printable(cls, name: str) -> str:
        if not name.isprintable():
            raise ValueError(f"must have printable characters only, got {name!r}")
        return name


@dataclass(frozen=True)
class _Checked:
    """A file's triangles, (m, 3, 3), found to be printable, and their volume in mm^3."""

    corners: Singles
    volume: float


@stage(writes="written", version=1)
def write_solid(solid: Solid, *, params: WriteSolidParams, out: Path, config_hash: str | None = None) -> WrittenFiles:
    """Write the solid to `out` as STL and 3MF, in mm, and draw it; each file is read back and checked.

    The 3MF file names `config_hash`, the hash of the configuration that the solid comes from.
    Raises `StageError` where a file, its corners merged by equal coordinates, is not closed, manifold and
    outward, or has another volume than the solid; that file is deleted. A picture that cannot be drawn is
    a `PipelineWarning`.
    """
    vertices, metadata = _rounded(solid), _metadata(params.name, config_hash)
    facts: dict[str, Fact] = {}
    checked: _Checked | None = None
    for kind in params.formats:
        path = out / f"solid.{kind}"
        _WRITERS[kind](path, vertices, solid.faces, metadata)
        try:
            checked = _require_printable(_READERS[kind](path), solid, checked)
        except StageError as error:
            path.unlink()
            raise StageError(f"{path.name}: {error}; the file was deleted") from error
        facts |= _facts_of_file(path, kind, checked)
    facts["preview"] = _preview(vertices, solid.faces, out) if params.preview else "not asked for"
    return WrittenFiles(facts)


def _metadata(name: str, config_hash: str | None) -> dict[str, str]:
    metadata = {"Title": name, "Application": f"scaffold-pipeline {__version__}"}
    return metadata if config_hash is None else {**metadata, "scaffold:config_sha256": config_hash}


def _rounded(solid: Solid) -> Singles:
    """Return the vertices as the files hold them, float32; a warning where that moves one."""
    single = to_single(solid.vertices)
    moved = np.abs(single - solid.vertices)
    if moved.any():
        warnings.warn(
            f"solid: {int(moved.any(axis=1).sum())} of {len(moved)} vertices are not exact in float32; in the files "
            f"they lie up to {moved.max():.2g} mm off",
            PipelineWarning,
            stacklevel=3,
        )
    return single


def _facts_of_file(path: Path, kind: str, checked: _Checked) -> dict[str, Fact]:
    return {
        f"{kind}_bytes": path.stat().st_size,
        f"{kind}_sha256": hash_file(path),
        f"{kind}_volume_mm3": checked.volume,
        f"{kind}_triangles": len(checked.corners),
    }


def _require_printable(corners: Singles, solid: Solid, before: _Checked | None) -> _Checked:
    """Check the triangles (m, 3, 3) of a file, at once where the file `before` held the very same."""
    if before is not None and np.array_equal(corners, before.corners):
        return before
    if len(corners) != len(solid.faces):
        raise StageError(f"must hold {len(solid.faces)} triangles, but {len(corners)} were read back")
    surface = SurfaceMesh(*merge_corners(corners))
    _require_closed(surface.faces, len(surface.vertices))
    _require_manifold(surface)
    _require_outward(surface)
    volume = surface.volume
    if not abs(volume - solid.volume) <= VOLUME_TOLERANCE * solid.volume:
        raise StageError(
            f"must keep the solid's volume to {VOLUME_TOLERANCE:g}, but it is {volume:.9g} mm^3 "
            f"instead of {solid.volume:.9g}; {_REMEDY}"
        )
    return _Checked(corners, volume)


def _require_closed(faces: Ints, count: int) -> None:
    """Check that each edge has two triangles which walk it in opposite directions."""
    starts, ends = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    if collapsed := int((starts == ends).sum()):
        raise StageError(f"must have no collapsed edge, but {collapsed} are shorter than float32 holds; {_REMEDY}")
    forward, backward = np.sort(starts * count + ends), np.sort(ends * count + starts)
    if twice := int((forward[1:] == forward[:-1]).sum()):
        raise StageError(
            f"must be manifold, but {twice} edges have more than two triangles or are walked twice in one direction; "
            f"{_REMEDY}"
        )
    if not np.array_equal(forward, backward):
        single = len(np.setdiff1d(forward, backward, assume_unique=True))
        raise StageError(f"must be closed, but {single} edges have one triangle only; {_REMEDY}")


def _require_manifold(surface: SurfaceMesh) -> None:
    """Check that manifold3d takes the surface as it is, without splitting vertices where pieces only touch."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(surface.vertices), surface.faces.astype(np.uint64))
    manifold = manifold3d.Manifold(mesh)
    if manifold.status() != manifold3d.Error.NoError:
        raise StageError(f"must be manifold, but manifold3d says {manifold.status().name}; {_REMEDY}")
    if (touching := manifold.num_vert() - len(surface.vertices)) > 0:
        raise StageError(f"must be manifold, but surfaces touch at {touching} vertices; {_REMEDY}")


def _require_outward(surface: SurfaceMesh) -> None:
    """Check that a piece which is inside out, the wall of a closed pore, lies in the box of one that is not."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces, vertices = surface.faces, surface.vertices - surface.bounds.mean(axis=0)
    links = (np.ones(len(faces), np.int8), (faces[:, 0], faces[:, 1]))
    links_too = (np.ones(len(faces), np.int8), (faces[:, 1], faces[:, 2]))
    shape = (len(vertices), len(vertices))
    count, piece = connected_components(coo_array(links, shape) + coo_array(links_too, shape), directed=False)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volumes = np.bincount(piece[faces[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0, minlength=count)
    if (volumes > 0.0).all():
        return
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, vertices)
    np.maximum.at(high, piece, vertices)
    is_solid = volumes > 0.0
    stray = sum(
        not ((low[is_solid] < low[i]) & (high[is_solid] > high[i])).all(axis=1).any() for i in np.flatnonzero(~is_solid)
    )
    if stray:
        raise StageError(f"must be outward, but {stray} of {count} pieces are inside out; {_REMEDY}")


def _write_stl(path: Path, vertices: Singles, faces: Ints, metadata: Mapping[str, str]) -> None:  # noqa: ARG001 - STL has no place for it
    path.write_bytes(to_stl(vertices, faces, f"scaffold-pipeline {__version__}, unit: mm"))


def _read_stl(path: Path) -> Singles:
    """Return the triangles that trimesh, no code of ours, reads, (m, 3, 3)."""
    from trimesh.exchange.stl import HeaderError, load_stl_binary

    try:
        with path.open("rb") as stream:
            loaded = load_stl_binary(stream)
    except HeaderError as error:
        raise StageError(f"must be valid binary STL, but trimesh says: {error}") from error
    return to_single(loaded["vertices"][loaded["faces"]])


def _write_3mf(path: Path, vertices: Singles, faces: Ints, metadata: Mapping[str, str]) -> None:
    is_large = 64 * (len(vertices) + len(faces)) > 2**31  # bytes; not every slicer reads zip64
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as package:  # dated 1980, so repeatable
        for member, parts in (
            ("[Content_Types].xml", iter([_CONTENT_TYPES])),
            ("_rels/.rels", iter([_RELATIONSHIPS])),
            ("3D/3dmodel.model", _model(vertices, faces, metadata)),
        ):
            with package.open(member, "w", force_zip64=is_large) as stream:
                for part in parts:
                    stream.write(part.encode())


def _model(vertices: Singles, faces: Ints, metadata: Mapping[str, str]) -> Iterator[str]:
    """Yield the text of the 3MF model: nine digits give each float32 back (3MF Core Specification 1.3)."""
    yield (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en" xmlns="{_CORE}" '
        f'xmlns:scaffold="{_NAMESPACE}">\n'
    )
    for name, value in metadata.items():
        yield f'<metadata name="{name}" preserve="1">{escape(value)}</metadata>\n'
    yield '<resources><object id="1" type="model"><mesh>\n<vertices>\n'
    yield from _rows('<vertex x="%.9g" y="%.9g" z="%.9g"/>\n', vertices)
    yield "</vertices>\n<triangles>\n"
    yield from _rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', faces)
    yield '</triangles>\n</mesh></object></resources>\n<build><item objectid="1"/></build>\n</model>\n'


def _rows(row: str, table: NDArray[Any]) -> Iterator[str]:
    for start in range(0, len(table), _ROWS_AT_ONCE):
        part = table[start : start + _ROWS_AT_ONCE]
        yield (row * len(part)) % tuple(part.reshape(-1).tolist())


def _read_3mf(path: Path) -> Singles:
    """Return the triangles that lib3mf reads in its strict mode, (m, 3, 3); checks the unit."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(StrictModeActive=True)
    try:
        reader.ReadFromFile(str(path))
    except lib3mf.ELib3MFException as error:
        raise StageError(f"must be valid 3MF, but lib3mf says: {error}") from error
    objects = model.GetMeshObjects()
    if model.GetUnit() != lib3mf.ModelUnit.MilliMeter or objects.Count() != 1 or not objects.MoveNext():
        raise StageError(f"must hold one object in mm, but holds {objects.Count()} in {model.GetUnit().name}")
    mesh = objects.GetCurrentMeshObject()
    if not mesh.IsManifoldAndOriented():
        raise StageError(f"must be manifold and oriented, but lib3mf says it is not; {_REMEDY}")
    vertices, faces = _arrays(mesh)
    return to_single(vertices[faces])


def _arrays(mesh: Any) -> tuple[Singles, NDArray[np.uint32]]:  # noqa: ANN401 - lib3mf ships no types
    """Return the vertices and faces of lib3mf's mesh, filled by its C functions.

    Its Python functions make an object of every vertex and triangle, gigabytes for a fine solid.
    """
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    vertices = np.empty((mesh.GetVertexCount(), 3), np.float32)
    faces = np.empty((mesh.GetTriangleCount(), 3), np.uint32)
    for function, array, item in (
        (wrapper.lib.lib3mf_meshobject_getvertices, vertices, lib3mf.Position),
        (wrapper.lib.lib3mf_meshobject_gettriangleindices, faces, lib3mf.Triangle),
    ):
        size, pointer = ctypes.c_uint64(len(array)), array.ctypes.data_as(ctypes.POINTER(item))
        wrapper.checkError(mesh, function(mesh._handle, size, ctypes.c_uint64(), pointer))  # noqa: SLF001 - see above
    return vertices, faces


def _preview(vertices: Singles, faces: Ints, out: Path) -> str:
    """Draw `preview.png` in a child process; return its name, or why there is none."""
    arrays = {"vertices": vertices, "faces": faces.astype(np.int32)}
    reasons = []
    for window in _WINDOWS:
        try:
            picture = call_in_child(
                draw_surface, arrays, {"window": window}, seconds=RENDER_SECONDS, about=window or "VTK"
            )
        except StageError as error:
            reasons.append(str(error))
            continue
        (out / "preview.png").write_bytes(picture["png"].tobytes())
        return "preview.png"
    reason = "; ".join(reasons)
    warnings.warn(
        f"no preview.png was drawn: {reason}; off-screen drawing needs, on Debian, libegl1 and libgl1-mesa-dri; "
        "the solid's files are complete",
        PipelineWarning,
        stacklevel=3,
    )
    return f"none: {reason}"


_WRITERS: dict[str, Callable[[Path, Singles, Ints, Mapping[str, str]], None]] = {"stl": _write_stl, "3mf": _write_3mf}
_READERS: dict[str, Callable[[Path], Singles]] = {"stl": _read_stl, "3mf": _read_3mf}
