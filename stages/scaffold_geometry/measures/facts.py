"""The measures of a solid as facts with flat names; lengths in mm, other units in the name."""

from __future__ import annotations

import math
from dataclasses import replace

from scaffold_geometry.arrays import Ints
from scaffold_geometry.measures.declarations import AREAS, to_place
from scaffold_geometry.voxels.image import VoxelImage
from scaffold_pipeline.artifacts import Fact, Metric, SurfaceMesh

PER_MM = "mm\u207b\u00b9"

_TOPOLOGY = "vertices, edges and faces: exact"

CONNECTIVITY_METRICS = (
    Metric(
        "loops",
        "",
        "Loops",
        "Number of independent loops (first Betti number).",
        "Connectivity",
        symbol="Conn",
        method=_TOPOLOGY,
    ),
    Metric(
        "euler_number",
        "",
        "Euler number",
        "Pieces minus loops plus closed pores.",
        "",
        symbol="Euler",
        method=_TOPOLOGY,
    ),
    Metric(
        "connectivity_density_per_mm3",
        "mm\u207b\u00b3",
        "Connectivity density",
        "Loops in each mm\u00b3; Conn.D.",
        "Connectivity",
        symbol="Conn.D",
        method=_TOPOLOGY,
    ),
)
"""The metrics of `connectivity_facts`."""

_FABRIC = "mean intercept length of the pores' walls, from the triangles: 0.003"

ANISOTROPY_DIRECTION = Metric(
    "anisotropy_direction",
    "",
    "Direction of anisotropy",
    "Main direction of the struts: x, y and z of a unit vector.",
    "Connectivity",
    method=_FABRIC,
)

SURFACE_METRICS = (
    Metric(
        "pore_surface_mm2",
        "mm\u00b2",
        "Area of the pores",
        "Surface towards the pores, without the cut at the outer shape.",
        "Surface",
        method=AREAS,
    ),
    Metric(
        "surface_per_solid_per_mm",
        PER_MM,
        "Surface per solid volume",
        "BS/BV.",
        "Surface",
        symbol="BS/BV",
        method=AREAS,
    ),
    Metric(
        "surface_per_total_per_mm",
        PER_MM,
        "Surface per total volume",
        "BS/TV.",
        "Surface",
        symbol="BS/TV",
        method=AREAS,
    ),
    Metric(
        "pore_surface_per_total_per_mm",
        PER_MM,
        "Area of the pores per total volume",
        "Without the cut at the outer shape.",
        "",
        method=AREAS,
    ),
    Metric(
        "anisotropy_degree",
        "",
        "Degree of anisotropy",
        "0 if isotropic, towards 1 if the struts have one direction; DA.",
        "Connectivity",
        symbol="DA",
        method=_FABRIC,
    ),
    Metric(
        "anisotropy_ratio",
        "",
        "Ratio of anisotropy",
        "The longest over the shortest mean intercept length.",
        "",
        method=_FABRIC,
    ),
    ANISOTROPY_DIRECTION,
    replace(ANISOTROPY_DIRECTION, key="anisotropy_axis", instead="anisotropy_direction"),
    Metric(
        "intercept_length_{which}",
        "mm",
        "Mean intercept length, {which}",
        "Mean length of a line within a strut, along the axis where it is {which}.",
        "",
        symbol="MIL",
        method=_FABRIC,
    ),
)
"""The metrics of `surface_facts`."""

_LAPLACE = (
    "Laplace's equation in the largest box in the outer shape, finite volumes; `*_error` is the voxels' error, to a "
    "factor of two"
)

TRANSPORT_METRICS = (
    Metric(
        "tortuosity_{axis}",
        "",
        "Tortuosity along {axis}",
        "Porosity over relative diffusivity (tortuosity factor); 1 for straight channels.",
        "Transport",
        method=_LAPLACE,
    ),
    Metric(
        "relative_diffusivity_{axis}",
        "",
        "Diffusivity along {axis}",
        "Effective diffusivity through the pores, relative to the free fluid.",
        "Transport",
        method=_LAPLACE,
    ),
    Metric(
        "relative_diffusivity_{axis}_error",
        "",
        "Diffusivity along {axis}, error",
        "Estimated error due to the voxels.",
        "",
        method=_LAPLACE,
    ),
    Metric("diffusion_box_low", "mm", "Box of the diffusion, least corner", "The largest in the outer shape.", ""),
    Metric("diffusion_box_high", "mm", "Box of the diffusion, greatest corner", "The largest in the outer shape.", ""),
    Metric("diffusion_box", "mm", "Box of the diffusion", "From corner to corner.", "", instead="diffusion_box_low"),
    Metric("diffusion_box_share", "", "Share of the diffusion's box", "Of the outer shape's volume.", ""),
    Metric("diffusion_voxel_size", "mm", "Voxel size of the diffusion", "Edge of the cells computed with.", ""),
)
"""The metrics of `transport_facts`."""


def connectivity_facts(faces: Ints, pieces: int, cavities: int, total_volume: float) -> dict[str, Fact]:
    """Return loops, Euler number and Conn.D of a closed manifold of so many pieces and cavities."""
    from scaffold_geometry.measures.connectivity import connectivity

    found = connectivity(faces, pieces, cavities)
    return {
        "loops": found.loops,
        "euler_number": found.euler_number,
        "connectivity_density_per_mm3": found.density(total_volume),
    }


def surface_facts(solid: SurfaceMesh, outer: SurfaceMesh, on_outer: float) -> dict[str, Fact]:
    """Return surface areas and their directions: BS/BV, BS/TV, mean intercept lengths, anisotropy.

    Faces within `on_outer` mm of the outer shape are those of the clip, or of a skin.
    """
    from scaffold_geometry.measures.anisotropy import anisotropy
    from scaffold_geometry.measures.surface import faces_of_pores, surface_measures

    body = (solid.vertices, solid.faces)
    is_of_pores = faces_of_pores(body, (outer.vertices, outer.faces), on_outer)
    found = surface_measures(body, (solid.volume, outer.volume), is_of_pores)
    fabric = anisotropy(solid.vertices, solid.faces[is_of_pores], solid.volume)
    return {
        "pore_surface_mm2": found.pore_surface_area_mm2,
        "surface_per_solid_per_mm": found.bs_per_bv,
        "surface_per_total_per_mm": found.bs_per_tv,
        "pore_surface_per_total_per_mm": found.pore_surface_per_tv,
        "anisotropy_degree": fabric.degree if fabric else None,
        "anisotropy_ratio": _finite(fabric.ratio) if fabric else None,
        "anisotropy_direction": fabric.axes[0].tolist() if fabric else None,
        "anisotropy_axis": to_place(fabric.axes[0]) if fabric else None,
        "intercept_length_longest": _finite(float(fabric.lengths[0])) if fabric else None,
        "intercept_length_shortest": _finite(float(fabric.lengths[2])) if fabric else None,
    }


def transport_facts(image: VoxelImage) -> dict[str, Fact]:
    """Return effective diffusivity and tortuosity along each axis, through the largest box in the outer shape."""
    from scaffold_geometry.measures.transport import transport

    found = transport(image)
    if found is None:
        return {"diffusion_box_low": None, "diffusion_box_high": None, "diffusion_box": None}
    low, high = found.bounds
    values: dict[str, Fact] = {
        "diffusion_box_low": low.tolist(),
        "diffusion_box_high": high.tolist(),
        "diffusion_box": f"{to_place(low)} to {to_place(high)}",
        "diffusion_box_share": found.box_share,
        "diffusion_voxel_size": found.voxel_size,
    }
    for axis, along in zip("xyz", (found.x, found.y, found.z), strict=True):
        values[f"relative_diffusivity_{axis}"] = along.relative_diffusivity
        values[f"relative_diffusivity_{axis}_error"] = along.voxel_error
        values[f"tortuosity_{axis}"] = along.tortuosity
    return values


def _finite(length: float) -> float | None:
    return length if math.isfinite(length) else None
