"""Metrics that several measuring stages share, and the facts of a place."""

from __future__ import annotations

from dataclasses import replace

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.artifacts import Fact, Metric

_VOLUMES = "volumes of the triangles: exact"
AREAS = "areas of the triangles: exact; the pores' part is what does not lie on the outer shape"
_POROSITY, _COMPUTED = "Porosity", "How it was computed"

POROSITY = (
    Metric(
        "porosity",
        "",
        "Porosity",
        "Share of the outer shape that is pore, on the written solid; Po(tot), 1 - BV/TV.",
        _POROSITY,
        symbol="Po(tot), 1 - BV/TV",
        method=_VOLUMES,
        shown_in=("headline", "caption"),
    ),
    Metric(
        "porosity_requested", "", "Requested porosity", "The porosity that the iso-value was solved for.", _POROSITY
    ),
    Metric(
        "iso",
        "",
        "Iso-value",
        "The solid is where the field is above it; pores grow with it.",
        _POROSITY,
        shown_in=("caption",),
    ),
    Metric(
        "porosity_open",
        "",
        "Open porosity",
        "Share that is pore and connected to the outside; Po(op).",
        _POROSITY,
        symbol="Po(op)",
        method=_VOLUMES,
    ),
    Metric(
        "porosity_closed",
        "",
        "Closed porosity",
        "Share that is pore and not connected to the outside; Po(cl).",
        _POROSITY,
        symbol="Po(cl)",
        method=_VOLUMES,
    ),
    Metric(
        "volume_mm3",
        "mm\u00b3",
        "Volume of the solid",
        "Material to be printed; BV.",
        _POROSITY,
        symbol="BV",
        method=_VOLUMES,
        shown_in=("headline",),
    ),
    Metric(
        "outer_volume_mm3",
        "mm\u00b3",
        "Volume of the outer shape",
        "Volume of the anatomical shape, solid and pores; TV.",
        _POROSITY,
        symbol="TV",
        method=_VOLUMES,
    ),
)
"""Metrics of porosity."""

PORES = (
    Metric("pore_pieces", "", "Pieces of pore space", "With one piece, fluid and cells can reach all pores.", "Pores"),
    Metric("pore_largest_fraction", "", "Largest piece of pore space", "Its share of the pore volume.", "Pores"),
    Metric("pore_networks", "", "Networks of pores", "Number of separate pore networks of the field by design.", ""),
    Metric(
        "pore_networks_fraction",
        "",
        "Share of the networks",
        "Share of the pore volume in as many of the largest pieces.",
        "",
    ),
)
"""Metrics of the connectivity of the pores."""

AREA = Metric(
    "area_mm2",
    "mm\u00b2",
    "Area of the solid",
    "Surface area, the outer surface included; BS.",
    "Surface",
    symbol="BS",
    method=AREAS,
    shown_in=("headline",),
)

SIZE = (
    Metric("triangles", "", "Triangles", "Of the solid's surface.", "Surface"),
    Metric("size_{axis}_mm", "mm", "Size along {axis}", "Of the bounding box.", "Printability"),
)
"""Metrics of size."""

COMPUTED = (
    Metric("cells", "", "Cells", "Of the volume mesh; each holds one pore.", _COMPUTED),
    Metric("elements", "", "Elements", "Points and segments that the field is interpolated from.", _COMPUTED),
    Metric("voxels", "", "Voxels", "Number of samples of the field.", _COMPUTED),
    Metric("voxel_size", "mm", "Voxel size", "Distance between samples; finer details are not resolved.", _COMPUTED),
)
"""Metrics of the computation of the field."""

GATES_NOT_APPLIED = Metric("gates_not_applied", "", "Gates not applied", "Gates without a metric to check.", "")


def place_metrics(name: str, title: str, meaning: str, method: str) -> tuple[Metric, Metric]:
    """Return the declarations of a place: three numbers under `NAME_place`, and the text under `NAME_at` as it was."""
    place = Metric(f"{name}_place", "mm", title, meaning, "", method=method)
    return place, replace(place, key=f"{name}_at", instead=place.key)


def place_facts(name: str, place: Floats | None) -> dict[str, Fact]:
    """Return a place (3,), mm, under both of its keys."""
    return {
        f"{name}_place": None if place is None else place.tolist(),
        f"{name}_at": None if place is None else to_place(place),
    }


def to_place(point: Floats) -> str:
    """Return a place (3,), mm, or a direction in words.

    >>> import numpy as np
    >>> to_place(np.array([1.0, 2.34567, -3.0]))
    '1, 2.346, -3'
    """
    return ", ".join(f"{coordinate:.4g}" for coordinate in point)
