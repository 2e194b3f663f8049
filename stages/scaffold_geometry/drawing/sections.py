"""Views of a solid for the report page: a simplified copy for the 3-D view, and sections as SVG drawings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.drawing.renders import round_length
from scaffold_geometry.surfaces.booleans import to_manifold

Rings = list[Floats]

AXES = "xyz"

_TURNS = {"x": (0.0, -90.0, -90.0), "y": (90.0, 0.0, 90.0), "z": (0.0, 0.0, 0.0)}
"""Degrees about x, y and z, in this order, that turn an axis to z, and the next two (y, z; z, x) to x and y."""

ACROSS = {"x": "yz", "y": "xz", "z": "xy"}
"""The axes of a section's drawing, to the right and upward."""

_STEPS = 4000
"""Resolution of a drawing, steps per longest side: finer than a screen or a sheet of paper shows."""

_MARGIN, _FOOT, _LEAST_WIDTH = 0.03, 0.11, 0.45
"""Margin around a drawing, height of the foot with the scale bar, and least width for its text, in longest sides."""

_BAR_SHARE = 0.2


def simplify_surface(vertices: Floats, faces: Ints, *, triangles: int) -> dict[str, NDArray[np.generic]]:
    """Return a surface of at most about `triangles` triangles: `vertices` float32, `faces` int32.

    M. Garland, P. Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997. A surface with fewer
    triangles is not simplified.
    """
    points, corners = vertices.astype(np.float32), faces.astype(np.int32)
    if len(corners) > triangles:
        import fast_simplification

        points, corners = fast_simplification.simplify(points, corners, target_count=triangles)
    return {"vertices": np.asarray(points, np.float32), "faces": np.asarray(corners, np.int32)}


def nearest_values(points: Floats, vertices: Floats, values: Floats) -> NDArray[np.float32]:
    """Return at `points` (k, 3) the value of the nearest vertex; `vertices` (n, 3) have `values` (n,)."""
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(vertices).query(points)
    nearest_value: NDArray[np.float32] = values[nearest].astype(np.float32)
    return nearest_value


def sections(vertices: Floats, faces: Ints, *, x: float, y: float, z: float) -> dict[str, NDArray[np.generic]]:
    """Return the rings of the sections of a closed, outward surface with planes across each axis, at x, y and z mm.

    `points_x` (n, 2) mm are the points of all rings at `x`, ring after ring, along the axes in `ACROSS`; `sizes_x` (k,)
    are the numbers of points of the rings.
    """
    body = to_manifold(vertices, faces, "section")
    answer: dict[str, NDArray[np.generic]] = {}
    for axis, place in zip(AXES, (x, y, z), strict=True):
        rings = [np.array(ring) for ring in body.rotate(_TURNS[axis]).slice(place).to_polygons()]
        points = np.concatenate([np.empty((0, 2)), *rings])
        answer[f"points_{axis}"] = points[:, ::-1] if axis == "y" else points
        answer[f"sizes_{axis}"] = np.array([len(ring) for ring in rings], np.int64)
    return answer


def section_svg(axis: str, place: float, box: Floats, solid: Rings, outer: Rings) -> str:
    """Return a drawing of a section across `axis` at `place` mm: the solid filled, the outer shape as a line.

    `box` (2, 3) mm are the least and the greatest corner of the whole: all sections of one box have the same scale. A
    scale bar and the names of the axes are below; colours follow the viewer's light or dark mode.
    """
    sides = [AXES.index(other) for other in ACROSS[axis]]
    (left, low), (right, high) = box[:, sides].tolist()
    longest = float(np.ptp(box, axis=0).max())
    step, margin = longest / _STEPS, _MARGIN * _STEPS
    inner, height = (right - left) / step, (high - low) / step
    width = max(inner, _LEAST_WIDTH * _STEPS) + 2.0 * margin
    corner = np.array([left - (width - inner) / 2.0 * step, high + margin * step])
    bar = round_length(_BAR_SHARE * longest)
    foot, whole = height + 2.0 * margin, height + (2.0 * _MARGIN + _FOOT) * _STEPS

    def drawn(rings: Rings) -> str:
        return "".join(_path((ring - corner) * (1.0, -1.0) / step) for ring in rings)

    at = f"{axis} = {round(place, 2) + 0.0:g} mm"  # 0 for -0
    names = f"{ACROSS[axis][0]} \u2192\u2002{ACROSS[axis][1]} \u2191\u2002{at}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width * step:.4f}mm" height="{whole * step:.4f}mm" '
        f'viewBox="0 0 {width:.0f} {whole:.0f}">\n'
        f"<title>Section across {axis} at {at}</title>\n<style>{_STYLE}</style>\n"
        f'<rect width="100%" height="100%"/>\n<path class="outer" d="{drawn(outer)}"/>\n'
        f'<path class="solid" d="{drawn(solid)}"/>\n'
        f'<path class="bar" d="M{margin:.0f} {foot + 80.0:.0f}h{bar / step:.0f}"/>\n'
        f'<text x="{margin + bar / step + 60.0:.0f}" y="{foot + 125.0:.0f}">{bar:g} mm</text>\n'
        f'<text x="{margin:.0f}" y="{foot + 340.0:.0f}">{names}</text>\n</svg>\n'
    )


def _path(points: Floats) -> str:
    """Return a ring, rounded to whole steps, as a closed path of relative moves; an empty text if no area is left."""
    steps = np.rint(points).astype(np.int64)
    steps = steps[(steps != np.roll(steps, 1, axis=0)).any(axis=1)]
    if len(steps) < 3:  # two bound nothing
        return ""
    moves = " ".join(f"{x} {y}" for x, y in np.diff(steps, axis=0).tolist())
    return f"M{steps[0, 0]} {steps[0, 1]}l{moves}z"


_STYLE = (
    "rect{fill:#fff}.solid{fill:#8f7a55;fill-rule:evenodd}.outer{fill:#eef3f7;stroke:#2f6f9f;stroke-width:9;"
    "fill-rule:evenodd}.bar{stroke:#23272e;stroke-width:24}text{fill:#23272e;font:150px system-ui,sans-serif}"
    "@media (prefers-color-scheme:dark){rect{fill:#22252b}.solid{fill:#e6d9bd}.outer{fill:#1b2733;stroke:#7db4de}"
    ".bar{stroke:#e6e3dc}text{fill:#e6e3dc}}"
)
