"""Which triangles of a surface pass through or lie upon others: by exact arithmetic, so that none is a false alarm."""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_pipeline.processes.isolation import Arrays


def find_self_intersections(vertices: Floats, faces: Ints) -> Arrays:
    """Return the `faces` (k,) that meet another elsewhere than in shared corners and edges; for a child process.

    CGAL's exact predicates by way of libigl: Q. Zhou, E. Grinspun, D. Zorin, A. Jacobson, "Mesh arrangements for solid
    geometry", ACM Transactions on Graphics 35 (2016). 130,000 triangles take 0.3 s.
    """
    from igl.copyleft import cgal

    found = cgal.remesh_self_intersections(
        np.ascontiguousarray(vertices), np.ascontiguousarray(faces), detect_only=True
    )
    return {"faces": np.unique(np.asarray(found[2], np.int64))}
