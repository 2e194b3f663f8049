"""Stage `measure_plate`: measure a plate as it will be in the file, and apply the quality gates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from scaffold_geometry.measures.declarations import AREA, COMPUTED, POROSITY, SIZE
from scaffold_geometry.measures.gates import MANIFOLD, POROSITY_ASKED_FOR, to_number
from scaffold_geometry.surfaces import shells
from scaffold_pipeline.artifacts import (
    CERTIFICATE_METRICS,
    Certificate,
    Contour,
    Fact,
    Gate,
    Metric,
    Metrics,
    PlanarMesh,
    ScalarField,
    Solid,
    SurfaceMesh,
)
from scaffold_pipeline.stages.contract import Params, Share, stage

METRICS = (
    *POROSITY,
    *CERTIFICATE_METRICS,
    Metric("pore_pieces", "", "Pieces of pore space", "Each is a separate hole.", "Pores"),
    Metric("holes", "", "Holes", "Of the contour.", "Pores"),
    AREA,
    *shells.METRICS,
    *SIZE,
    *COMPUTED,
)
"""The metrics of `measure_plate`, except those of the stage that makes the field."""

GATES = (
    MANIFOLD,
    Gate("one_piece", "The plate is one piece.", "gate_one_piece"),
    POROSITY_ASKED_FOR,
    Gate("struts_whole", "All struts are whole.", "gate_struts_whole"),
)


class MeasurePlateParams(Params):
    """Parameters of `measure_plate`: a switch and a tolerance for each quality gate."""

    porosity_tolerance: Share = Field(default=0.005, gt=0.0, lt=1.0)
    """Greatest difference of the porosity from the requested one."""

    gate_manifold: bool = True
    """Whether an open or non-manifold plate fails."""

    gate_one_piece: bool = True
    """Whether a plate of several pieces fails."""

    gate_porosity: bool = True
    """Whether a porosity outside the tolerance fails."""

    gate_struts_whole: bool = True
    """Whether an iso at which struts are broken fails, by the field's certificate."""


@stage(writes="metrics", version=1, metrics=METRICS, gates=GATES)
def measure_plate(
    solid: Solid, contour: Contour, field: ScalarField, mesh: PlanarMesh | None = None, *, params: MeasurePlateParams
) -> Metrics:
    """Measure a plate as read back from its file, and apply the quality gates.

    Its porosity is 1 - (its volume) / (area within the contour's outline x its height). Pores need not be connected:
    between whole struts each pore is a separate hole.
    """
    from scaffold_geometry.files.binary_stl import from_stl, to_stl
    from scaffold_geometry.surfaces.shells import shell_facts

    vertices, faces = from_stl(to_stl(solid.vertices, solid.faces, "measured"))
    file, size = SurfaceMesh(vertices, faces), np.ptp(vertices, axis=0)
    outer_volume = contour.outline.area * float(size[2])
    values: dict[str, Fact] = {
        "porosity": 1.0 - file.volume / outer_volume,
        "porosity_requested": contour.porosity_requested,
        "iso": contour.iso,
        **(_certificate_facts(field.certificate, contour.iso) if field.certificate else {}),
        **shell_facts(vertices, faces),
        "holes": contour.holes,
        "pore_pieces": len(solid.pore_volumes),
        **{f"size_{axis}_mm": float(length) for axis, length in zip("xyz", size, strict=True)},
        "volume_mm3": file.volume,
        "area_mm2": file.area,
        "outer_volume_mm3": outer_volume,
        "triangles": len(faces),
        "cells": mesh.summary()["cells"] if mesh else None,
        "elements": None,
        **field.facts,
        "voxels": int(field.values.size),
        "voxel_size": field.spacing,
    }
    return Metrics(values, tuple(_failed_gates(values, params)))


def _certificate_facts(certificate: Certificate, iso: float) -> dict[str, Fact]:
    """Return what the certificate says, but for the count of what is too thin: channels in a plane all end so."""
    return {name: fact for name, fact in certificate.at(iso).items() if name != "under_resolved"}


def _failed_gates(values: dict[str, Fact], params: MeasurePlateParams) -> Iterator[str]:
    """Yield a line for each gate that is on and fails: which, by how much, and what to change."""
    if params.gate_manifold and not values["is_manifold"]:
        yield "manifold: the plate has open, non-manifold or touching parts; use other voxels, or another porosity"
    if params.gate_one_piece and values["solid_pieces"] != 1:
        yield (
            f"one_piece: {values['solid_pieces']} pieces instead of 1; lower porosity or iso, or let contour drop "
            "slivers (min_piece)"
        )
    porosity, asked = to_number(values["porosity"]), values["porosity_requested"]
    if params.gate_porosity and asked is not None and abs(porosity - to_number(asked)) > params.porosity_tolerance:
        yield (
            f"porosity: {porosity:.4f} differs from the {to_number(asked):g} requested by more than "
            f"{params.porosity_tolerance:g}; smaller voxels bring it nearer"
        )
    if params.gate_struts_whole and values.get("struts_broken"):
        iso, high = to_number(values["iso"]), to_number(values["strut_min"])
        yield (
            f"struts_whole: iso {iso:.4f} is {iso - high:.4f} above strut_min: {values['struts_broken']} of "
            f"{values['struts']} struts may be broken; lower porosity or iso"
        )
