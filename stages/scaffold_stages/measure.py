"""Stage `measure`: measure the solid as it will be in the file, and apply the quality gates."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats
from scaffold_geometry.measures import morphometry as of_voxels
from scaffold_geometry.measures import struts_and_throats
from scaffold_geometry.measures.declarations import (
    AREA,
    COMPUTED,
    GATES_NOT_APPLIED,
    PORES,
    POROSITY,
    SIZE,
    place_facts,
)
from scaffold_geometry.measures.facts import (
    CONNECTIVITY_METRICS,
    SURFACE_METRICS,
    TRANSPORT_METRICS,
    connectivity_facts,
    surface_facts,
    transport_facts,
)
from scaffold_geometry.measures.gates import GATES, GateParams, failed_gates, gates_not_applied, to_number
from scaffold_geometry.measures.printability import rules
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_geometry.surfaces import shells as of_shells
from scaffold_pipeline.artifacts import (
    CERTIFICATE_METRICS,
    UNDER_RESOLVED,
    Fact,
    IsoSurface,
    Metrics,
    OuterShape,
    ScalarField,
    Solid,
    SurfaceMesh,
    VolumeMesh,
)
from scaffold_pipeline.errors import warn
from scaffold_pipeline.stages.contract import Millimetres, Unit, stage

if TYPE_CHECKING:
    from scaffold_geometry.measures.morphometry import Morphometry
    from scaffold_geometry.measures.printability.verdict import Printability
    from scaffold_geometry.measures.surface_tree import SurfaceTree

_ON_OUTER = 1e-3
"""Distance from the outer shape, voxels, below which a wall of the solid was made by the clip."""


METRICS = (
    *POROSITY,
    *of_voxels.METRICS,
    *struts_and_throats.METRICS,
    *CERTIFICATE_METRICS,
    *PORES,
    *CONNECTIVITY_METRICS,
    *TRANSPORT_METRICS,
    AREA,
    *SURFACE_METRICS,
    *of_shells.METRICS,
    *SIZE,
    *rules.METRICS,
    UNDER_RESOLVED,
    *COMPUTED,
    of_voxels.VOXEL_SIZE,
    GATES_NOT_APPLIED,
)
"""The metrics of `measure`, except those of the stages that make the field and the outer shape."""


class MeasureParams(GateParams):
    """Parameters of `measure`: the measures, the limits of the printer, and the quality gates."""

    morphometry: bool = True
    """Whether thickness, pore sizes, accessible porosity, diffusion and anisotropy are measured."""

    voxel_size: Millimetres | None = Field(default=None, gt=0.0)
    """Voxel size of these measures; by default half the field's, if that gives at most 1e7 voxels."""

    probes: Annotated[tuple[Annotated[float, Field(gt=0.0)], ...], Unit("mm")] = ()
    """Diameters of cells or particles for which the accessible share of the pore space is measured."""

    diffusion: bool = True
    """Whether diffusion through the pores is computed, the slowest of the measures."""

    printing: PrintRules = PrintRules()
    """Limits of the printer: each rule that the solid breaks is a finding, not a failure."""


@stage(
    writes="metrics",
    version=11,
    metrics=METRICS,
    gates=GATES,
)
def measure(
    solid: Solid,
    outer: OuterShape,
    porous: IsoSurface,
    field: ScalarField,
    mesh: VolumeMesh | None = None,
    *,
    params: MeasureParams,
) -> Metrics:
    """Measure the solid as read back from its file, apply the quality gates, and list features difficult to print.

    The solid is written to the bytes of an STL and read back, with vertices merged by position as every reader does;
    `write_solid` writes the same bytes. Without a certificate or a mesh, the gates that need them are not applied;
    `gates_not_applied` lists them.
    """
    from scaffold_geometry.files.binary_stl import from_stl, to_stl
    from scaffold_geometry.measures.printability.verdict import lint
    from scaffold_geometry.measures.surface_tree import SurfaceTree
    from scaffold_geometry.surfaces.shells import shell_facts

    file = SurfaceMesh(*from_stl(to_stl(solid.vertices, solid.faces, "measured")))
    mesh = mesh if field.certificate else None  # a field without one is not made of a mesh
    on_outer = _ON_OUTER * field.spacing
    tree = SurfaceTree(file.vertices, file.faces)
    shells, printed = shell_facts(file.vertices, file.faces), lint(file, params.printing, tree)
    values: dict[str, Fact] = {
        **outer.facts,
        **_porosity_facts(file, outer, printed),
        "porosity_requested": porous.porosity_requested,
        "iso": porous.iso,
        **(field.certificate.at(porous.iso) if field.certificate else {}),
        **shells,
        **_pore_facts(solid.pore_volumes, field.pore_networks),
        **(_thickness_facts(tree, outer, mesh, field.spacing, porous.skin) if mesh else {}),
        **{f"size_{axis}_mm": float(size) for axis, size in zip("xyz", np.ptp(file.bounds, axis=0), strict=True)},
        "volume_mm3": file.volume,
        "area_mm2": file.area,
        "outer_volume_mm3": outer.volume,
        "triangles": len(file.faces),
        "cells": mesh.summary()["cells"] if mesh else None,
        "elements": None,
        **field.facts,
        "voxels": int(field.values.size),
        "voxel_size": field.spacing,
        "gates_not_applied": list(gates_not_applied(field, mesh, params)),
    }
    _warn_of_thin_parts(field, porous.iso, values)
    failed = failed_gates(values, params, most_closed=field.pore_networks * (porous.skin > 0.0))
    metrics = Metrics({**values, **printed.values}, tuple(failed), findings=printed.findings)
    if params.morphometry and not shells["is_manifold"]:
        warn("morphometry: left out, as the solid is not a closed manifold")
    elif params.morphometry:
        topology = connectivity_facts(
            file.faces, int(shells["solid_pieces"]), int(shells["closed_pores"]), outer.volume
        )
        found = _morphometry(file, outer, field.spacing, params, solid.vertices)
        return replace(
            metrics,
            values={**metrics.values, **topology, **surface_facts(file, outer, on_outer), **found.values},
            histograms=found.histograms,
            curves=found.curves,
            strut_thickness=found.strut_thickness,
        )
    return metrics


def _morphometry(
    file: SurfaceMesh, outer: OuterShape, spacing: float, params: MeasureParams, at: Floats
) -> Morphometry:
    """Measure struts and pores on voxels, finer than the field's `spacing`, mm, and diffusion where asked for."""
    from scaffold_geometry.measures.morphometry import morphometry, usual_spacing

    given = params.voxel_size
    used = given or usual_spacing(outer, spacing)
    found = morphometry(file, outer, used, may_refine=given is None, probes=params.probes, at=at)
    return found._replace(values=found.values | (transport_facts(found.image) if params.diffusion else {}))


def _porosity_facts(file: SurfaceMesh, outer: OuterShape, printed: Printability) -> dict[str, Fact]:
    """Return the porosity, and its parts that are open to the outside and that are not: Po(tot), Po(op), Po(cl)."""
    porosity = 1.0 - file.volume / outer.volume
    closed = to_number(printed.values["enclosed_void_mm3"]) / outer.volume
    return {"porosity": porosity, "porosity_open": porosity - closed, "porosity_closed": closed}


def _warn_of_thin_parts(field: ScalarField, iso: float, values: dict[str, Fact]) -> None:
    """Warn of struts and channels that the certificate finds whole and open, but the voxels may not show."""
    thin = values.get("under_resolved")
    if field.certificate is None or not thin:
        return
    size = field.certificate.resolving_voxel_size(iso)
    finest = field.spacing * field.certificate.RING_SHARES[-1]
    remedy = f"voxel_size {size:.3g} mm resolves all" if size else f"voxel_size {finest:.3g} mm would not resolve all"
    struts, channels = (values.get(f"{name}_interrupted") for name in ("struts", "channels"))
    outcome = "may break or close them" if struts is None else f"breaks {struts} struts and closes {channels} channels"
    warn(
        f"under_resolved: {thin} struts and channels are thinner than two voxels of {field.spacing:.3g} mm at iso "
        f"{iso:.4g}, and the surface {outcome}; {remedy}"
    )


def _pore_facts(volumes: Floats, networks: int) -> dict[str, Fact]:
    """Return what share of the pore volume the largest piece holds, and as many as there are networks by design."""
    shares = volumes / volumes.sum()
    return {
        "pore_pieces": len(volumes),
        "pore_largest_fraction": float(shares[:1].sum()),
        "pore_networks": networks,
        "pore_networks_fraction": float(shares[:networks].sum()),
    }


def _thickness_facts(
    tree: SurfaceTree, outer: OuterShape, mesh: VolumeMesh, spacing: float, skin: float
) -> dict[str, Fact]:
    """Measure the struts and channels of the mesh in the file itself, which the certificate cannot see."""
    from scaffold_geometry.fields.skeleton import skeleton_of
    from scaffold_geometry.measures.struts_and_throats import narrowest_throat, thinnest_strut
    from scaffold_geometry.measures.surface_tree import SurfaceTree

    skeleton, shape = skeleton_of(mesh.vertices, mesh.cells), SurfaceTree(outer.vertices, outer.faces)
    strut = thinnest_strut(skeleton, tree, shape, spacing, _ON_OUTER * spacing)
    throat = narrowest_throat(skeleton, tree, shape, spacing, skin)
    return {
        "thinnest_strut_mm": strut.diameter,
        **place_facts("thinnest_strut", strut.place),
        "struts_interrupted": strut.interrupted,
        "narrowest_throat_mm": throat.diameter,
        **place_facts("narrowest_throat", throat.place),
        "channels_interrupted": throat.interrupted,
    }
