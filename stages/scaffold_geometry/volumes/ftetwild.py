"""fTetWild: fill a closed surface with tetrahedra, for a child process.

Hu, Schneider, Wang, Zorin, Panozzo, "Fast tetrahedral meshing in the wild", ACM Transactions on Graphics 39 (2020).
"""

from __future__ import annotations

import numpy as np

from scaffold_geometry.arrays import Floats, Ints
from scaffold_pipeline.artifacts.cells import cell_volumes
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.processes.isolation import Arrays
from scaffold_pipeline.processes.threads import thread_count

ROUNDS, ENERGY = 80, 10.0
"""fTetWild's defaults: rounds of optimisation, and the energy of the worst cell at which it stops."""


def run_ftetwild(
    vertices: Floats, faces: Ints, target: float, envelope: float, rounds: int = ROUNDS, energy: float = ENERGY
) -> Arrays:
    """Return positively oriented tetrahedra of a surface near the origin: `vertices` (n, 3), `cells` (m, 4).

    Runs in a child process: pytetwild crashes or hangs on bad input and writes into the working directory.
    """
    import pytetwild

    points, cells = pytetwild.tetrahedralize(
        vertices,
        faces.astype(np.int32),
        edge_length_abs=target,
        epsilon=envelope / float(np.linalg.norm(np.ptp(vertices, axis=0))),
        num_threads=thread_count(),
        num_opt_iter=rounds,
        stop_energy=energy,
        vtk_ordering=True,
    )
    if not len(cells):
        raise StageError(
            "fTetWild returned no cells: the shape is flat, or thinner than the envelope; use smaller cells"
        )
    cells = np.asarray(cells, np.int64)
    cells = cells[np.abs(cell_volumes(points, cells, "tetrahedron")) > 0.0]
    used, compact = np.unique(cells, return_inverse=True)
    cells = compact.reshape(cells.shape)
    inverted = cell_volumes(points[used], cells, "tetrahedron") < 0.0
    cells[inverted] = cells[inverted][:, [0, 2, 1, 3]]
    return {"vertices": points[used], "cells": cells}
