"""Checks of a 3MF package before its meshes are read: start part, extensions, slicer's volumes."""

from __future__ import annotations

import lzma
import shutil
import struct
import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/"
_READ = (
    _CORE,
    "http://schemas.microsoft.com/3dmanufacturing/material/",
    "http://schemas.microsoft.com/3dmanufacturing/production/",
)
"""Prefixes of namespaces that are supported, or that affect only the appearance."""
_NAMES = {
    "beamlattice": "beam lattice",
    "slice": "slice",
    "securecontent": "secure content",
    "volumetric": "volumetric",
    "implicit": "implicit",
    "displacement": "displacement",
    "booleanoperations": "boolean operations",
    "trianglesets": "triangle sets",
}
_UNITS = frozenset({"micron", "millimeter", "centimeter", "inch", "foot", "meter"})
_WHOLE = frozenset({"ModelPart", "normal_part"})
"""Names that slicers give to volumes of the body."""
_START_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_RELATIONS = "_rels/.rels"
_CONTENT_TYPES = "[Content_Types].xml"
_USUAL_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, NotImplementedError, RuntimeError, EOFError),
    *(OSError, ValueError, KeyError, OverflowError),
)
"""Errors of Python's ZIP reader for damaged archives."""
_CHUNK = 1 << 16
_LARGEST_SETTINGS = 1 << 26
"""Most bytes of a slicer's settings, a thousand times their usual size: a small archive can expand to any size."""


class _Element(NamedTuple):
    name: str
    attributes: dict[str, str]


def require_readable(path: Path) -> None:
    """Require that a 3MF file has a start part, and no unsupported content that affects the shape."""
    try:
        with zipfile.ZipFile(path) as package:
            _require_start(package, path.name)
            for member in package.namelist():
                if member.lower().endswith(".model"):
                    _require_known(_elements(package, member, first_only=True)[0], path.name)
                elif member.lower().startswith("metadata/") and member.lower().endswith(".config"):
                    _require_whole_volumes(package, member, path.name)
    except _DAMAGE as error:
        reason = " ".join(str(error).split())[:100]
        raise StageError(f"{path.name}: cannot be read as 3MF, which is a ZIP archive ({reason}); {AGAIN}") from error
    except (expat.ExpatError, IndexError) as error:
        raise StageError(f"{path.name}: cannot be read as 3MF: its XML is damaged ({error}); {AGAIN}") from error


def with_content_types(path: str) -> str:
    """Return `path`, or, if its package lacks the content types that lib3mf requires, a copy that has them.

    The copy is in the working folder, a temporary one of the child process.
    """
    with zipfile.ZipFile(path) as package:
        if _CONTENT_TYPES in package.namelist():
            return path
    copy = shutil.copyfile(path, "completed.3mf")
    with zipfile.ZipFile(copy, "a") as package:
        package.writestr(_CONTENT_TYPES, _USUAL_TYPES)
    return copy


def _require_start(package: zipfile.ZipFile, name: str) -> None:
    """Require that the package's relations name an existing start part."""
    if _RELATIONS not in package.namelist():
        raise StageError(f"{name}: cannot be read as 3MF: it has no {_RELATIONS}, which names its start part; {AGAIN}")
    starts = [
        of.attributes.get("Target", "")
        for of in _elements(package, _RELATIONS)
        if of.attributes.get("Type") == _START_TYPE
    ]
    if not starts:
        raise StageError(f"{name}: cannot be read as 3MF: its {_RELATIONS} names no start part of a 3-D model; {AGAIN}")
    start = starts[0].lstrip("/")
    if start not in package.namelist():
        raise StageError(f"{name}: names {start!r} as its start part, which does not exist; {AGAIN}")
    _require_known(_elements(package, start, first_only=True)[0], name)


def _require_known(root: _Element, name: str) -> None:
    """Require that all required extensions are supported, and that the unit is valid."""
    for prefix in root.attributes.get("requiredextensions", "").split():
        namespace = root.attributes.get(f"xmlns:{prefix}", prefix)
        if not namespace.startswith(_READ):
            words = next((name for key, name in _NAMES.items() if key in namespace.lower()), "")
            which = f"{words} ({namespace})" if words else namespace
            raise StageError(
                f"{name}: requires the extension {which}, which is not supported; export it as plain triangles"
            )
    unit = root.attributes.get("unit", "millimeter")
    if unit not in _UNITS:
        raise StageError(f"{name}: its unit is {unit!r}, must be one of {', '.join(sorted(_UNITS))}; {AGAIN}")


def _require_whole_volumes(package: zipfile.ZipFile, member: str, name: str) -> None:
    """Require that a slicer's settings mark no volume as cutter, modifier or support."""
    if package.getinfo(member).file_size > _LARGEST_SETTINGS:
        raise StageError(
            f"{name}: {member} has {package.getinfo(member).file_size} bytes, too many for a slicer's settings; {AGAIN}"
        )
    try:
        elements = _elements(package, member)
    except expat.ExpatError:  # settings of other programs are not XML
        return
    for element in elements:
        given = element.attributes
        marks = {
            given.get("subtype", "normal_part") if element.name == "part" else "",
            given.get("value", "") if given.get("key") == "volume_type" else "",
            "modifier" if given.get("key") == "modifier" and given.get("value") == "1" else "",
        } - {"", *_WHOLE}
        if marks:
            raise StageError(
                f"{name}: a volume of it is marked {min(marks)} by the slicer ({member}), and 3MF itself does not say "
                "what that does to the body; apply or delete it in the slicer and export the body alone, as STL for "
                "instance"
            )


def _elements(package: zipfile.ZipFile, member: str, *, first_only: bool = False) -> list[_Element]:
    """Return the elements of a member in their order, or its first alone."""
    found: list[_Element] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda name, attributes: found.append(_Element(name.rpartition(":")[2], attributes))
    with package.open(member) as stream:
        while chunk := stream.read(_CHUNK):
            parser.Parse(chunk, False)  # noqa: FBT003 - expat's own
            if first_only and found:
                return found[:1]
        parser.Parse(b"", True)  # noqa: FBT003
    return found
