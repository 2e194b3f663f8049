"""Rule `size`: more triangles, or a larger file, than the program that slices takes."""

from __future__ import annotations

from collections.abc import Iterator

from scaffold_geometry.measures.printability.rules import Outcome, PrintRules
from scaffold_pipeline.artifacts import Finding, SurfaceMesh

_HEADER_BYTES = 84
_TRIANGLE_BYTES = 50


def file_size(surface: SurfaceMesh, rules: PrintRules) -> Outcome:
    """Return the size of the binary STL, 84 bytes and 50 a triangle."""
    triangles = len(surface.faces)
    size = _HEADER_BYTES + _TRIANGLE_BYTES * triangles
    faults = "; ".join(_faults(triangles, size, rules))
    remedy = "simplify the solid, or use larger voxels"
    return Outcome({"stl_bytes": size}, Finding("size", f"{faults}; {remedy}") if faults else None)


def _faults(triangles: int, size: int, rules: PrintRules) -> Iterator[str]:
    if rules.max_triangles is not None and triangles > rules.max_triangles:
        yield f"{triangles} triangles, at most {rules.max_triangles} are taken"
    if rules.max_file_bytes is not None and size > rules.max_file_bytes:
        yield f"a binary STL of {size} bytes, at most {rules.max_file_bytes} are taken"
