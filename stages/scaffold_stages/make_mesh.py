"""Stage `make_mesh`: small meshes of Liu, Guo and Yu, and blocks of cells, centred at the origin."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces.polyhedra import icosahedron
from scaffold_geometry.volumes import lattices
from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.stages.contract import Params, Unit, stage

Cells: TypeAlias = tuple[Floats, Ints]
Counts: TypeAlias = tuple[int, int, int]
Count = Annotated[int, Field(ge=1)]

_MOST_CELLS = 1_000_000
"""A larger number is probably a mistake: the cells of a block repeat, so no field needs more."""

_PAPER_EDGES = {"tetrahedron": 2.0 * 2.0**0.5, "icosahedron": 1.0, "hexahedron": 2.0, "cube": 0.5, "rod": 1.0}
"""mm: the paper's coordinates taken as mm; the tetrahedron fits into the hexahedron, [-1, 1]^3."""

_COUNTS: dict[str, Counts] = {"hexahedron": (1, 1, 1), "cube": (2, 2, 2), "rod": (4, 1, 1)}


class MakeMeshParams(Params):
    """Parameters of `make_mesh`."""

    shape: Literal["tetrahedron", "icosahedron", "hexahedron", "cube", "rod", "block"]
    """One regular tetrahedron; an icosahedron of 20 tetrahedra around its centre; one hexahedron; a cube of 8
    hexahedra; a rod of 4 hexahedra along x; or a block of `counts` cubes."""

    edge: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Edge length of a cell, for an icosahedron of the edges to its centre; by default as in the paper: 2.83 for the
    tetrahedron, 2 for the hexahedron, 0.5 for the cube, 1 for all others."""

    cell: Literal["hexahedron", "tetrahedron"] | None = None
    """Cells in each cube of a block: one hexahedron (default), or six tetrahedra around its diagonal."""

    counts: Count | tuple[Count, Count, Count] | None = None
    """Number of cubes of a block along x, y and z, or one number for all three."""

    @model_validator(mode="after")
    def _counts_of_a_block(self) -> MakeMeshParams:
        if self.shape == "block" and self.counts is None:
            raise ValueError("counts: is required for a block; give 4 or [4, 2, 2], for example")
        for name in ("cell", "counts"):
            if self.shape != "block" and getattr(self, name) is not None:
                raise ValueError(f"{name}: is for a block only, not for a {self.shape}; leave it out")
        cells = int(np.prod([float(count) for count in self.cubes])) * (6 if self.cell == "tetrahedron" else 1)
        if cells > _MOST_CELLS:
            raise ValueError(f"counts: must make at most {_MOST_CELLS} cells, got {cells}")
        return self

    @property
    def cubes(self) -> Counts:
        """Number of cubes along x, y and z; 0 for shapes without cubes."""
        if isinstance(self.counts, int):
            return self.counts, self.counts, self.counts
        return self.counts or _COUNTS.get(self.shape, (0, 0, 0))


@stage(writes="mesh", version=1)
def make_mesh(*, params: MakeMeshParams) -> VolumeMesh:
    """Make one of the paper's small meshes, or a block of hexahedra or tetrahedra, centred at the origin.

    `extract_outer` makes its outer shape; with `shape: box`, the bounding box as in the paper's figures.
    Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function".
    """
    edge = params.edge or _PAPER_EDGES.get(params.shape, 1.0)
    if params.shape == "tetrahedron":
        vertices, cells = _tetrahedron()
    elif params.shape == "icosahedron":
        vertices, cells = _icosahedron()
    else:
        vertices, cells = _block(params.cubes, params.cell or "hexahedron")
    if cells.shape[1] == len(lattices.HEXAHEDRON):
        return VolumeMesh(edge * vertices, hexahedra=cells)
    return VolumeMesh(edge * vertices, tetrahedra=cells)


def _tetrahedron() -> Cells:
    """Return the tetrahedron of every second corner of a cube."""
    vertices = np.array([(1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0)])
    return vertices / np.sqrt(8.0), np.array([(0, 1, 2, 3)])


def _icosahedron() -> Cells:
    """Return a tetrahedron from each face to the centre, which has the same distance to all corners."""
    shell, faces = icosahedron()
    vertices = np.concatenate([shell / np.linalg.norm(shell, axis=1, keepdims=True), np.zeros((1, 3))])
    return vertices, np.column_stack([np.full(len(faces), len(shell)), faces])


def _block(counts: Counts, cell: str) -> Cells:
    corners = {"hexahedron": lattices.HEXAHEDRON, "tetrahedron": lattices.TETRAHEDRA}[cell]
    lattice, cells = lattices.on_lattice(lattices.block(counts), corners)
    return lattice - np.array(counts) / 2.0, cells
