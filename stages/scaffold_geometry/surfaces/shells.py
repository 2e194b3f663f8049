"""Facts of a solid from the shells of its surface: whether it is manifold, its pieces and closed pores."""

from __future__ import annotations

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.triangles import edge_faults, face_pieces, piece_volumes, touching_vertices
from scaffold_pipeline.artifacts import Metric

METRICS = (
    Metric("solid_pieces", "", "Pieces of solid", "A printable solid has one; others are loose.", "Struts"),
    Metric("solid_largest_fraction", "", "Largest piece of solid", "Its share of the solid's volume.", "Struts"),
    Metric("closed_pores", "", "Closed pores", "Cavities in the solid without a way out.", "Pores"),
    Metric("is_manifold", "", "Manifold", "Yes if the surface is closed, with two triangles at each edge.", "Surface"),
)
"""The metrics of `shell_facts`."""


def shell_facts(vertices: Floats, faces: Ints) -> dict[str, bool | int | float]:
    """Return whether a surface, (n, 3) and (m, 3), is manifold, and the numbers of its pieces and closed pores."""
    faults = edge_faults(faces)
    volumes = piece_volumes(vertices, faces, face_pieces(faces))
    pieces = volumes[volumes > 0.0]
    return {
        "is_manifold": not any(faults) and touching_vertices(faces) == 0,
        "solid_pieces": len(pieces),
        "solid_largest_fraction": float(pieces.max() / pieces.sum()) if len(pieces) else 0.0,
        "closed_pores": int((volumes < 0.0).sum()),
    }
