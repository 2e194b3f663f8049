"""Stage `write_contour`: a planar contour as drawings, for viewing, and for laser cutting, milling or CAD."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.artifacts import Contour, Drawing, Fact, WrittenFiles
from scaffold_pipeline.runs.store import hash_file
from scaffold_pipeline.stages.contract import EachOnce, Params, Title, Unit, stage

Format = Literal["svg", "png"]

_INK, _PAPER = (51, 55, 61), (255, 255, 255)
_MARGIN = 0.02
"""Margin around the outline, as a share of its longest side."""
_OVERSAMPLING = 4
"""A pixel is the mean of 4 x 4 samples."""


class WriteContourParams(Params):
    """Parameters of `write_contour`."""

    formats: Annotated[tuple[Format, ...], EachOnce] = Field(default=("svg", "png"), min_length=1)
    """Files to write: `contour.svg`, `contour.png`."""

    name: Title = "scaffold"
    """Title in the SVG file."""

    pixels: Annotated[int, Unit("pixels")] = Field(default=1200, ge=16, le=8000)
    """Longest side of the PNG."""


DRAWINGS = (
    Drawing("contour.png", "Contour", "The solid is dark."),
    Drawing("contour.svg", "Contour, in mm", "The solid is dark."),
)


@stage(writes="contour_files", version=1, drawings=DRAWINGS)
def write_contour(contour: Contour, *, params: WriteContourParams, out: Path) -> WrittenFiles:
    """Write the contour as SVG, in mm and with its coordinates, and as PNG, the solid dark on white.

    In the SVG y points down: a point x, y of the plane is at x, -y. The contour is one path with the even-odd fill
    rule.
    """
    facts: dict[str, Fact] = {}
    for kind in params.formats:
        path = out / f"contour.{kind}"
        path.write_bytes(_WRITERS[kind](contour, params))
        facts |= {f"{kind}_bytes": path.stat().st_size, f"{kind}_sha256": hash_file(path)}
    return WrittenFiles(facts)


def _window(contour: Contour) -> Floats:
    """Return the least and greatest corner of the drawing, (2, 2) mm."""
    bounds = np.stack([contour.outline.points.min(axis=0), contour.outline.points.max(axis=0)])
    margin = _MARGIN * np.ptp(bounds, axis=0).max()
    return np.stack([bounds[0] - margin, bounds[1] + margin])


def _svg(contour: Contour, params: WriteContourParams) -> bytes:
    (left, low), (right, high) = _window(contour).tolist()
    width, height = _length(right - left), _length(high - low)
    about = f"mm; solid where the field is above {contour.iso:.9g}; porosity {contour.porosity:.6f}"
    path = "".join(_subpath(ring) for ring in contour.solid.rings)
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="{_length(left)} {_length(-high)} {width} {height}">\n'
        f"<title>{escape(params.name)}</title>\n<desc>{about}</desc>\n"
        f'<path fill="#{bytes(_INK).hex()}" fill-rule="evenodd" d="{path}"/>\n</svg>\n'
    )
    return text.encode()


def _subpath(ring: Floats) -> str:
    points = " ".join(f"{_length(x)},{_length(-y)}" for x, y in ring.tolist())
    return f"\nM{points}Z"


def _length(length: float) -> str:
    """Return mm with six decimals, about single precision for a part of a few cm, without trailing zeros.

    >>> [_length(length) for length in (2.0, -0.1234567, -1e-9)]
    ['2', '-0.123457', '0']
    """
    text = f"{length:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _png(contour: Contour, params: WriteContourParams) -> bytes:
    from scaffold_geometry.drawing.renders import to_png
    from scaffold_geometry.planar.regions import rasterise

    (left, low), (right, high) = _window(contour).tolist()
    scale = params.pixels / max(right - left, high - low)
    rows, columns = (max(1, round(scale * length)) for length in (high - low, right - left))
    pixels = [
        _OVERSAMPLING * scale * np.column_stack([high - ring[:, 1], ring[:, 0] - left]) - 0.5
        for ring in contour.solid.rings
    ]
    filled = rasterise(pixels, (_OVERSAMPLING * rows, _OVERSAMPLING * columns))
    share = filled.reshape(rows, _OVERSAMPLING, columns, _OVERSAMPLING).mean(axis=(1, 3))[:, :, None]
    image: NDArray[np.uint8] = np.round(share * _INK + (1.0 - share) * _PAPER).astype(np.uint8)
    return to_png(image).tobytes()


_WRITERS: dict[str, Callable[[Contour, WriteContourParams], bytes]] = {"svg": _svg, "png": _png}
