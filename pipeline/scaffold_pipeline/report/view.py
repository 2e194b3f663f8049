"""The 3-D view of the solid: the content of `view.npz`, packed, and the values for `view.html.j2`."""

from __future__ import annotations

import zlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, NamedTuple, TypeAlias
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.report.wording import to_text

Arrays: TypeAlias = Mapping[str, NDArray[Any]]

RAMP = ("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725")
"""Viridis, readable with colour blindness, from thin to thick."""

MARKS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#23272e")
"""Okabe and Ito's colours, distinct with colour blindness: one for each rule."""

MOST_PLACES = 2000
"""Most places of a finding that the view marks."""

_BONE, _CAP, _GLASS = "#e3dac9", "#b4603e", "#5b8fc0"
_FULL = 65535
"""Greatest packed coordinate: 1/65535 of the longest side is finer than a screen shows."""

_ENDS = (2.0, 95.0)
"""Percentiles of the strut thickness at the ends of the colour scale; with a few thick nodes all else would be dark."""


@dataclass(frozen=True, eq=False)
class View:
    """The content of `view.npz`: simplified surfaces, (n, 3) mm and (m, 3), and a thickness per vertex, (n,) or (0,).

    `triangles` is the number of triangles of the solid itself.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    thickness: NDArray[np.float64]
    outer_vertices: NDArray[np.float64]
    outer_faces: NDArray[np.int64]
    triangles: int


def read_view(content: bytes) -> View:
    """Return the content of a file `view.npz`; raises `ValueError` if it is damaged or another kind of file."""
    try:
        with np.load(BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        view = View(
            *_surface(arrays, ""), _values(arrays), *_surface(arrays, "outer_"), triangles=int(arrays["triangles"])
        )
    except (OSError, EOFError, KeyError, TypeError, BadZipFile, zlib.error) as error:
        raise ValueError(f"is damaged ({error})") from error
    if len(view.thickness) not in {0, len(view.vertices)} or not len(view.faces):
        raise ValueError("is not a view of a solid")
    return view


def _surface(arrays: Arrays, prefix: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    vertices = arrays.get(f"{prefix}vertices", np.empty((0, 3))).astype(np.float64)
    faces = arrays.get(f"{prefix}faces", np.empty((0, 3))).astype(np.int64)
    if vertices.shape != (len(vertices), 3) or faces.shape != (len(faces), 3) or not np.isfinite(vertices).all():
        raise ValueError(f"{prefix}vertices or {prefix}faces are no surface")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"{prefix}faces name vertices that are not there")
    return vertices, faces


def _values(arrays: Arrays) -> NDArray[np.float64]:
    values = arrays.get("thickness", np.empty(0)).astype(np.float64)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError("thickness is no list of numbers")
    return values


class Mark(NamedTuple):
    """A finding whose places the view marks: its number, its rule, its colour, and its number of places."""

    number: int
    rule: object
    colour: str
    places: int


@dataclass(frozen=True)
class DrawnView:
    """The values for `view.html.j2`: the facts for the script, and the packed arrays as text."""

    facts: Mapping[str, Any]
    packed: str
    has_thickness: bool
    has_outer: bool
    marks: tuple[Mark, ...]
    extent: str
    legend: tuple[str, ...]
    summary: str


def draw_view(view: View, findings: Sequence[Mapping[str, Any]]) -> DrawnView:
    """Return the 3-D view of a solid, `findings` being those of `measures.json`."""
    everything = np.concatenate([view.vertices, view.outer_vertices])
    low, size = everything.min(axis=0), np.ptp(everything, axis=0)
    scale = float(size.max()) or 1.0
    ends = np.percentile(view.thickness, _ENDS).tolist() if len(view.thickness) else None
    marks = [
        Mark(number, finding.get("rule"), colour_of(number), len(places_of(finding)[:MOST_PLACES]))
        for number, finding in enumerate(findings)
    ]
    return DrawnView(
        facts={
            "vertices": len(view.vertices),
            "faces": len(view.faces),
            "outerVertices": len(view.outer_vertices),
            "outerFaces": len(view.outer_faces),
            "low": low.tolist(),
            "size": size.tolist(),
            "scale": scale,
            "thickness": ends,
            "findings": [_mark_finding(finding, number) for number, finding in enumerate(findings)],
            "ramp": RAMP,
            "bone": _BONE,
            "cap": _CAP,
            "glass": _GLASS,
        },
        packed=b64encode(_pack_view(view, low, scale, ends)).decode(),
        has_thickness=bool(len(view.thickness)),
        has_outer=bool(len(view.outer_faces)),
        marks=tuple(mark for mark in marks if mark.places),
        extent=" \u00d7 ".join(to_text(length) for length in size.tolist()),
        legend=_legend(ends),
        summary=_view_summary(view),
    )


def _pack_view(view: View, low: NDArray[np.float64], scale: float, ends: list[float] | None) -> bytes:
    """Return faces, vertices and thickness packed for the script: numbers of 4, 2 and 1 bytes, deflated."""
    corners = [faces.astype("<u4") for faces in (view.faces, view.outer_faces)]
    places = [np.rint((points - low) / scale * _FULL).astype("<u2") for points in (view.vertices, view.outer_vertices)]
    thickness = np.empty(0)
    if ends is not None:
        thickness = np.rint(255.0 * np.clip((view.thickness - ends[0]) / (ends[1] - ends[0] or 1.0), 0.0, 1.0))
    whole = b"".join(part.tobytes() for part in (*corners, *places, thickness.astype(np.uint8)))
    return zlib.compress(whole, 9)


def places_of(finding: Mapping[str, Any]) -> list[list[float]]:
    """Return the valid places of a finding: three finite numbers each, mm."""
    found = finding.get("places")
    try:
        places = np.asarray(found if isinstance(found, list) else [], np.float64).reshape(-1, 3)
    except (ValueError, TypeError):
        return []
    listed: list[list[float]] = places[np.isfinite(places).all(axis=1)].round(4).tolist()
    return listed


def colour_of(number: int) -> str:
    """Return the colour that marks a finding, by its number."""
    return MARKS[number % len(MARKS)]


def _mark_finding(finding: Mapping[str, Any], number: int) -> dict[str, Any]:
    return {"colour": colour_of(number), "places": places_of(finding)[:MOST_PLACES]}


def _legend(ends: list[float] | None) -> tuple[str, ...]:
    if ends is None:
        return ()
    low, high = ends
    return f"{low:.3g} or less", f"{(low + high) / 2.0:.3g}", f"{high:.3g} or more"


def _view_summary(view: View) -> str:
    shown, whole = len(view.faces), view.triangles
    if shown >= whole:
        return f"All {to_text(whole)} triangles are shown."
    return f"Simplified for this page to {to_text(shown)} of {to_text(whole)} triangles; the files have all of them."
