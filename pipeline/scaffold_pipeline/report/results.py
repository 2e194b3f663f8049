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
        Entry(
            "Porosity", "porosity", "Share of the outer shape that is pore, on the written solid; Po(tot), 1 - BV/TV."
        ),
        Entry("Porosity asked for", "porosity_requested", "What the iso-value was solved for."),
        Entry("Iso-value", "iso", "Solid is where the field is above it: pores grow as it grows."),
        Entry("Open porosity", "porosity_open", "Share that is pore and reached from outside; Po(op)."),
        Entry("Closed porosity", "porosity_closed", "Share that is pore and reached from nowhere; Po(cl)."),
        Entry("Volume of the solid", "volume_mm3", "What has to be printed; BV.", MM3),
        Entry("Volume of the outer shape", "outer_volume_mm3", "The anatomy before it was made porous; TV.", MM3),
    ),
    "Struts": (
        Entry(
            "Strut thickness, mean",
            "strut_thickness_mean",
            "The greatest ball in the solid about each point; Tb.Th.",
            MM,
        ),
        Entry("Strut thickness, median", "strut_thickness_median", "Half of the solid is thinner.", MM),
        Entry("Strut thickness, 5th percentile", "strut_thickness_p5", "A twentieth of the solid is thinner.", MM),
        Entry("Strut thickness, 95th percentile", "strut_thickness_p95", "A twentieth of the solid is thicker.", MM),
        Entry("Thinnest neck of solid", "strut_thickness_smallest", "Where two parts meet by the least ball.", MM),
        Entry("Thinnest strut", "thinnest_strut_mm", "The least ball about a mesh edge that fits into the solid.", MM),
        Entry("Struts broken", "struts_broken", "Mesh edges that are not solid all along, by the certificate."),
        Entry("Struts interrupted", "struts_interrupted", "Mesh edges that leave the solid in the file itself."),
        Entry("Pieces of solid", "solid_pieces", "One is what a printer wants; more are loose."),
        Entry("Largest piece of solid", "solid_largest_fraction", "Its share of the solid's volume."),
    ),
    "Pores": (
        Entry("Pore size, mean", "pore_size_mean", "The greatest ball in the pores about each point; Tb.Sp.", MM),
        Entry("Pore size, median", "pore_size_median", "Half of the pore space is narrower.", MM),
        Entry("Pore size, 5th percentile", "pore_size_p5", "A twentieth of the pore space is narrower.", MM),
        Entry("Pore size, 95th percentile", "pore_size_p95", "A twentieth of the pore space is wider.", MM),
        Entry("Narrowest neck of pores", "pore_size_smallest", "Where two pores meet by the least ball.", MM),
        Entry("Throat to half of the pores", "throat_50", "The largest ball that reaches half of the pore space.", MM),
        Entry(
            "Throat to nine tenths of the pores", "throat_90", "The largest ball that reaches nine tenths of it.", MM
        ),
        Entry("Throat to nearly all pores", "throat_99", "The largest ball that reaches 99 % of it.", MM),
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
        Entry("Loops", "loops", "Struts that could be cut before the solid falls apart."),
        Entry(
            "Connectivity density", "connectivity_density_per_mm3", "Loops in each mm\u00b3; Conn.D.", "mm\u207b\u00b3"
        ),
        Entry(
            "Degree of anisotropy",
            "anisotropy_degree",
            "0 where all directions are alike, towards 1 where one rules; DA.",
        ),
        Entry("Direction of anisotropy", "anisotropy_axis", "Along which struts run most."),
    ),
    "Transport": (
        *(
            Entry(f"Tortuosity along {axis}", f"tortuosity_{axis}", "How much the way through the pores is drawn out.")
            for axis in "xyz"
        ),
        *(
            Entry(
                f"Diffusivity along {axis}",
                f"relative_diffusivity_{axis}",
                "Of a molecule through the pores, against the free fluid's.",
            )
            for axis in "xyz"
        ),
    ),
    "Surface": (
        Entry("Area of the solid", "area_mm2", "Where cells can settle, the outer surface included; BS.", MM2),
        Entry(
            "Area of the pores", "pore_surface_mm2", "What of it faces pores: without the cut of the outer shape.", MM2
        ),
        Entry("Surface per solid volume", "surface_per_solid_per_mm", "BS/BV.", PER_MM),
        Entry("Surface per total volume", "surface_per_total_per_mm", "BS/TV.", PER_MM),
        Entry("Manifold", "is_manifold", "Whether the surface is closed, with two triangles at each edge."),
        Entry("Triangles", "triangles", "Of the solid's surface."),
    ),
    "Printability": (
        *(Entry(f"Size along {axis}", f"size_{axis}_mm", "Room that it takes.", MM) for axis in "xyz"),
        Entry("Thinnest wall", "thinnest_wall_mm", "Of all walls that the surface shows.", MM),
        Entry("Edges that run out to nothing", "knife_edge_mm", "Length of all rims that are too sharp.", MM),
        Entry("Overhangs", "overhang_area_mm2", "Area that needs support in the build direction.", MM2),
        Entry("Islands", "unsupported_islands", "Places where printing would begin in mid-air."),
        Entry("Voids that hold powder", "enclosed_voids", "Cavities out of which nothing can be blown."),
        Entry("Sliver triangles", "sliver_triangles", "Too flat for some programs."),
        Entry("Struts and channels too thin for the voxels", "under_resolved", "Thinner than two voxels."),
    ),
    "How it was computed": (
        Entry("Cells", "cells", "Of the volume mesh; each holds one pore."),
        Entry("Elements", "elements", "Points and segments that the field is interpolated from."),
        Entry("Voxels", "voxels", "Samples of the field."),
        Entry("Voxel size", "voxel_size", "Distance between samples: finer details are lost.", MM),
        Entry("Voxel size of the measures", "measure_voxel_size", "Thicknesses and sizes are off by one at most.", MM),
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
