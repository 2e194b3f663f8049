"""The results as people read them: each metric's plain name, what it means and its unit, grouped by what it tells.

To show another metric, add an `Entry` to the section where it belongs; one that a run has not measured is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.markup import Number, folded, table, text_of


@dataclass(frozen=True)
class Entry:
    """A line of the results: a metric's plain name, its key in `metrics.json`, its meaning in a sentence, its unit."""

    title: str
    key: str
    meaning: str
    unit: str = ""


MM, MM2, MM3, PER_MM = "mm", "mm\u00b2", "mm\u00b3", "mm\u207b\u00b9"

SECTIONS: Mapping[str, tuple[Entry, ...]] = {
    "Porosity": (
        Entry("Porosity", "porosity", "Share of the outer shape that is pore, measured on the written solid."),
        Entry("Porosity asked for", "porosity_requested", "What the iso-value was solved for."),
        Entry("Iso-value", "iso", "Solid is where the field is above it: pores grow as it grows."),
        Entry("Open porosity", "porosity_open", "Share of the outer shape that is pore and reached from outside."),
        Entry("Closed porosity", "porosity_closed", "Share of the outer shape that is pore and reached from nowhere."),
        Entry("Volume of the solid", "volume_mm3", "What has to be printed.", MM3),
        Entry("Volume of the outer shape", "outer_volume_mm3", "The anatomy before it was made porous.", MM3),
    ),
    "Struts": (
        Entry(
            "Strut thickness, mean", "strut_thickness_mean", "Of the greatest ball in the solid about each point.", MM
        ),
        Entry(
            "Strut thickness, deviation", "strut_thickness_std", "How far strut thickness spreads about its mean.", MM
        ),
        Entry("Thinnest strut", "thinnest_strut_mm", "The least ball about a mesh edge that fits into the solid.", MM),
        Entry("Struts broken", "struts_broken", "Mesh edges that are not solid all along, by the certificate."),
        Entry("Struts interrupted", "struts_interrupted", "Mesh edges that leave the solid in the file itself."),
        Entry("Pieces of solid", "solid_pieces", "One is what a printer wants; more are loose."),
        Entry("Largest piece of solid", "solid_largest_fraction", "Its share of the solid's volume."),
    ),
    "Pores": (
        Entry("Pore size, mean", "pore_size_mean", "Of the greatest ball in the pore space about each point.", MM),
        Entry("Pore size, deviation", "pore_size_std", "How far pore size spreads about its mean.", MM),
        Entry(
            "Narrowest throat", "narrowest_throat_mm", "The least ball about a channel that fits into the pores.", MM
        ),
        Entry("Pieces of pore space", "pore_pieces", "One lets fluid and cells reach everywhere."),
        Entry("Largest piece of pore space", "pore_largest_fraction", "Its share of the pore volume."),
        Entry("Closed pores", "closed_pores", "Cavities in the solid that nothing can reach."),
    ),
    "Connectivity": (
        Entry("Channels closed", "channels_closed", "Passages from pore to pore that are shut at this iso-value."),
        Entry("Channels interrupted", "channels_interrupted", "Passages that meet solid in the file itself."),
        Entry(
            "Accessible pore volume", "accessible_fraction", "Share of the pore volume that is reached from outside."
        ),
        Entry(
            "Connectivity density",
            "connectivity_density",
            "Loops of struts in each cubic millimetre.",
            "mm\u207b\u00b3",
        ),
        Entry(
            "Degree of anisotropy",
            "degree_of_anisotropy",
            "0 where all directions are alike, towards 1 where one rules.",
        ),
    ),
    "Transport": (
        Entry("Tortuosity across x", "tortuosity_x", "How much longer the way through the pores is made, across x."),
        Entry("Tortuosity across y", "tortuosity_y", "The same across y."),
        Entry("Tortuosity across z", "tortuosity_z", "The same across z."),
    ),
    "Surface": (
        Entry("Area of the solid", "area_mm2", "Where cells can settle, the outer surface included.", MM2),
        Entry("Surface per volume", "surface_per_volume", "Area of the solid in each cubic millimetre of it.", PER_MM),
        Entry("Manifold", "is_manifold", "Whether the surface is closed, with two triangles at each edge."),
        Entry("Triangles", "triangles", "Of the solid's surface."),
    ),
    "Printability": (
        Entry("Size along x", "size_x_mm", "Room that it takes.", MM),
        Entry("Size along y", "size_y_mm", "Room that it takes.", MM),
        Entry("Size along z", "size_z_mm", "Room that it takes.", MM),
        Entry("Struts and channels too thin for the voxels", "under_resolved", "Thinner than two voxels."),
    ),
    "How it was computed": (
        Entry("Cells", "cells", "Of the volume mesh; each holds one pore."),
        Entry("Elements", "elements", "Points and segments that the field is interpolated from."),
        Entry("Voxels", "voxels", "Samples of the field."),
        Entry("Voxel size", "voxel_size", "Distance between samples: finer details are lost.", MM),
    ),
}

HIGHLIGHTS = ("porosity", "strut_thickness_mean", "pore_size_mean", "volume_mm3", "area_mm2")
"""Metrics that stand large at the top of the page."""

_ENTRIES = {entry.key: entry for entries in SECTIONS.values() for entry in entries}


def highlights(metrics: Mapping[str, Fact]) -> str:
    """Return the metrics that tell most in large type."""
    known = [_ENTRIES[key] for key in HIGHLIGHTS if metrics.get(key) is not None]
    cards = "".join(f"<div><dt>{entry.title}</dt><dd>{value_of(entry, metrics)}</dd></div>" for entry in known)
    return f'<dl class="highlights">{cards}</dl>' if cards else ""


def results(metrics: Mapping[str, Fact]) -> str:
    """Return the tables of what was measured, and all of `metrics.json` folded."""
    parts = []
    for title, entries in SECTIONS.items():
        rows = [
            (entry.title, value_of(entry, metrics), f'<span class="meaning">{entry.meaning}</span>')
            for entry in entries
            if metrics.get(entry.key) is not None
        ]
        parts.append(f"<h3>{title}</h3>\n{table((), rows, 'results')}" if rows else "")
    every = ((f"<code>{text_of(key)}</code>", _sortable(value)) for key, value in metrics.items())
    return "\n".join(filter(None, parts)) + folded("All metrics", table(("Key", "Value"), every, "facts sortable"))


def value_of(entry: Entry, metrics: Mapping[str, Fact]) -> str:
    """Return a metric with its unit, escaped."""
    value = text_of(metrics.get(entry.key))
    return f"{value}\u202f{entry.unit}" if entry.unit else value


def _sortable(value: Fact) -> str | Number:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return Number(text_of(value), float(value)) if is_number else text_of(value)  # type: ignore[arg-type]
