"""What the shells of a surface tell of a solid: whether it is one, in one piece, without closed pores."""

from __future__ import annotations

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.triangles import edge_faults, face_pieces, piece_volumes, touching_vertices
from scaffold_pipeline.artifacts import Metric

METRICS = (
    Metric("solid_pieces", "", "Pieces of solid", "One is what a printer wants; more are loose.", "Struts"),
    Metric("solid_largest_fraction", "", "Largest piece of solid", "Its share of the solid's volume.", "Struts"),
    Metric("closed_pores", "", "Closed pores", "Cavities in the solid that nothing can reach.", "Pores"),
    Metric("is_manifold", "", "Manifold", "Whether the surface is closed, with two triangles at each edge.", "Surface"),
)
"""What `shell_facts` tells."""


def shell_facts(vertices: Floats, faces: Ints) -> dict[str, bool | int | float]:
    """Return of a surface, (n, 3) and (m, 3), whether it is a manifold, and count its pieces and closed pores."""
    faults = edge_faults(faces)
    volumes = piece_volumes(vertices, faces, face_pieces(faces))
    pieces = volumes[volumes > 0.0]
    return {
        "is_manifold": not any(faults) and touching_vertices(faces) == 0,
        "solid_pieces": len(pieces),
        "solid_largest_fraction": float(pieces.max() / pieces.sum()) if len(pieces) else 0.0,
        "closed_pores": int((volumes < 0.0).sum()),
    }
