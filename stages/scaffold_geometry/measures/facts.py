"""The measures of a solid as facts under flat names; lengths mm, other units in the name."""

from __future__ import annotations

import math

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.voxels.image import VoxelImage
from scaffold_pipeline.artifacts import Fact, SurfaceMesh


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
    """Return how much surface there is, and how it lies: BS/BV, BS/TV, mean intercept lengths, anisotropy.

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
        "anisotropy_axis": to_place(fabric.axes[0]) if fabric else None,
        "intercept_length_longest": _finite(float(fabric.lengths[0])) if fabric else None,
        "intercept_length_shortest": _finite(float(fabric.lengths[2])) if fabric else None,
    }


def transport_facts(image: VoxelImage) -> dict[str, Fact]:
    """Return effective diffusivity and tortuosity along each axis, through the largest box in the outer shape."""
    from scaffold_geometry.measures.transport import transport

    found = transport(image)
    if found is None:
        return {"diffusion_box": None}
    low, high = found.bounds
    values: dict[str, Fact] = {
        "diffusion_box": f"{to_place(low)} to {to_place(high)}",
        "diffusion_box_share": found.box_share,
        "diffusion_voxel_size": found.voxel_size,
    }
    for axis, along in zip("xyz", (found.x, found.y, found.z), strict=True):
        values[f"relative_diffusivity_{axis}"] = along.relative_diffusivity
        values[f"relative_diffusivity_{axis}_error"] = along.voxel_error
        values[f"tortuosity_{axis}"] = along.tortuosity
    return values


def to_place(point: Floats) -> str:
    """Return a place (3,), mm, or a direction as a fact.

    >>> import numpy as np
    >>> to_place(np.array([1.0, 2.34567, -3.0]))
    '1, 2.346, -3'
    """
    return ", ".join(f"{coordinate:.4g}" for coordinate in point)


def _finite(length: float) -> float | None:
    return length if math.isfinite(length) else None
