"""Stage `draw_solid`: what `report.html` shows of the solid: a simplified copy to turn about, and three sections.

It comes last in a config, and nothing depends on it: what cannot be drawn is a warning.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scaffold_geometry.drawing.sections import AXES, nearest_values, section_svg, sections, simplify_surface
from scaffold_pipeline.artifacts import Fact, Metrics, OuterShape, Solid, SurfaceMesh, WrittenFiles
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import call_in_child
from scaffold_pipeline.stages.contract import Params, Share, Unit, stage

Arrays: TypeAlias = dict[str, NDArray[np.generic]]

_SECONDS = 300.0
"""Time for each child; 5 million triangles take a tenth of it."""

_OUTER_TRIANGLES = 20_000
"""Of the outer shape's copy, which is seen through."""

_WITHIN_ENDS = Field(gt=0.0, lt=1.0)


class DrawSolidParams(Params):
    """Parameters of `draw_solid`."""

    triangles: Annotated[int, Unit("triangles")] = Field(default=300_000, ge=1000, le=1_000_000)
    """Of the copy that the page shows in 3-D, at most; 300,000 make a page of some 4 MB."""

    sections: tuple[Annotated[Share, _WITHIN_ENDS], Annotated[Share, _WITHIN_ENDS], Annotated[Share, _WITHIN_ENDS]] = (
        0.5,
        0.5,
        0.5,
    )
    """Where the planes across x, y and z cut, from the solid's one end to the other."""


@stage(
    writes="drawing",
    version=1,
    libraries=("fast_simplification", "libigl", "llvmlite", "manifold3d", "numba", "pyvista", "scipy", "vtk"),
)
def draw_solid(
    solid: Solid,
    outer: OuterShape | None = None,
    metrics: Metrics | None = None,
    *,
    params: DrawSolidParams,
    out: Path,
) -> WrittenFiles:
    """Write what the page shows: `view.npz`, a copy of few triangles, and three sections as SVG.

    The copy has the outer shape too, and the strut thickness at each vertex where `metrics` has it, taken from the
    nearest vertex of the solid. A section shows the solid filled and the outer shape as a line, in mm. All is drawn in
    child processes; what fails is a `PipelineWarning`, and the facts say why.
    """
    facts = _write_view(solid, outer, metrics, params.triangles, out / "view.npz")
    return WrittenFiles(facts | _write_sections(solid, outer, params.sections, out))


def _write_view(
    solid: Solid, outer: OuterShape | None, metrics: Metrics | None, triangles: int, path: Path
) -> dict[str, Fact]:
    try:
        copy = _simplify(solid, triangles)
        outside = _simplify(outer, _OUTER_TRIANGLES) if outer else {}
    except StageError as error:
        return {"view": _not_drawn(path.name, error)}
    thickness = metrics.strut_thickness if metrics else np.empty(0)
    if len(thickness) == len(solid.vertices):
        copy["thickness"] = nearest_values(copy["vertices"].astype(np.float64), solid.vertices, thickness)
    shown = {**copy, **{f"outer_{name}": values for name, values in outside.items()}}
    np.savez_compressed(path, allow_pickle=False, triangles=np.int64(len(solid.faces)), **shown)
    return {"view": path.name, "view_triangles": len(copy["faces"]), "view_has_thickness": "thickness" in copy}


def _simplify(surface: SurfaceMesh, triangles: int) -> Arrays:
    arrays = {"vertices": surface.vertices, "faces": surface.faces}
    return call_in_child(
        simplify_surface, arrays, {"triangles": triangles}, seconds=_SECONDS, about="simplifying the solid"
    )


def _write_sections(
    solid: Solid, outer: OuterShape | None, shares: tuple[float, float, float], out: Path
) -> dict[str, Fact]:
    low, high = solid.bounds
    places = dict(zip(AXES, (low + (high - low) * shares).tolist(), strict=True))
    try:
        cut, line = _sections(solid, places), _sections(outer, places) if outer else {}
    except StageError as error:
        return {"sections": _not_drawn("section", error)}
    box = np.stack([np.minimum(low, outer.bounds[0]), np.maximum(high, outer.bounds[1])]) if outer else solid.bounds
    for axis, place in places.items():
        text = section_svg(axis, place, box, _rings(cut, axis), _rings(line, axis))
        (out / f"section_{axis}.svg").write_text(text, encoding="utf-8")
    return {f"section_{axis}_at": place for axis, place in places.items()}


def _sections(surface: SurfaceMesh, places: dict[str, float]) -> Arrays:
    arrays = {"vertices": surface.vertices, "faces": surface.faces}
    return call_in_child(sections, arrays, {**places}, seconds=_SECONDS, about="cutting the solid")


def _rings(found: Arrays, axis: str) -> list[NDArray[np.float64]]:
    if not found:
        return []
    points, sizes = found[f"points_{axis}"].astype(np.float64), found[f"sizes_{axis}"].astype(np.int64)
    return np.split(points, np.cumsum(sizes)[:-1]) if len(sizes) else []


def _not_drawn(what: str, error: StageError) -> str:
    warn(f"no {what} was drawn: {error}; all other files are complete")
    return f"none: {error}"
