"""Meshes of cells: solid cells, whose edges become struts, and tiles of a plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from scaffold_pipeline.artifacts.cells import CELL_TYPES, cell_measures, edges_of_cells, mesh_faults
from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats, Ints, require_indices
from scaffold_pipeline.errors import StageError

if TYPE_CHECKING:
    import pyvista


class CellMesh(Artifact):
    """Cells of one or more kinds over shared vertices: the base of `VolumeMesh` and `PlanarMesh`.

    `vertices` (n, 3) mm; one array of corner indices for each cell kind, in VTK's order. Every cell has distinct
    corners and a positive volume or area, every face at most one cell on each side, every vertex at least one cell.
    `facts` are measured by the stage that makes the mesh.
    """

    IS_PLANAR: ClassVar[bool]
    vertices: Floats
    facts: Mapping[str, Fact]

    def __post_init__(self) -> None:
        owner = type(self).__name__
        self.own_array("vertices", np.float64, (None, 3))
        for name, kind in self._kinds().items():
            self.own_array(name, np.int64, (None, CELL_TYPES[kind].corners))
            require_indices(owner, name, getattr(self, name), len(self.vertices))
        for fault in mesh_faults(self.vertices, self.cells):
            raise StageError(f"{owner}{fault}")
        super().__post_init__()

    @classmethod
    def _kinds(cls) -> dict[str, str]:
        """Return the kind of cell that each field holds."""
        return {kind.plural: kind.name for kind in CELL_TYPES.values() if kind.is_planar == cls.IS_PLANAR}

    @classmethod
    def from_pyvista(cls, grid: pyvista.UnstructuredGrid) -> Self:
        """Return the mesh of a `pyvista.UnstructuredGrid`; its coordinates are taken as mm.

        Parameters
        ----------
        grid : pyvista.UnstructuredGrid
            Cells of the kinds that this class has. Points and edges are left out, and faces from a mesh of solid cells.

        Raises
        ------
        StageError
            It is not such a grid, has cells of other kinds, or breaks a rule of this class.
        """
        from scaffold_pipeline.artifacts.conversions import cells_from_pyvista

        vertices, cells = cells_from_pyvista(grid, is_planar=cls.IS_PLANAR)
        return cls(**{"vertices": vertices, **cells})

    def to_pyvista(self) -> pyvista.UnstructuredGrid:
        """Return a `pyvista.UnstructuredGrid` in mm with the same vertices and cells, writable."""
        from scaffold_pipeline.artifacts.conversions import cells_to_pyvista

        return cells_to_pyvista(self)

    @property
    def cells(self) -> dict[str, Ints]:
        """Corner indices of each cell kind that the mesh has, keyed by the names of `CELL_TYPES`."""
        return {kind: getattr(self, name) for name, kind in self._kinds().items() if len(getattr(self, name))}

    @property
    def edges(self) -> Ints:
        """All edges, each once, (k, 2), smaller index first, sorted."""
        return edges_of_cells(self.cells)

    def _sum(self) -> float:
        """Return the volume, mm^3, or area, mm^2, of all cells."""
        return sum(float(cell_measures(self.vertices, cells, kind).sum()) for kind, cells in self.cells.items())

    def summary(self) -> dict[str, Fact]:
        """Return counts, volume or area, the spread of edge lengths and the facts."""
        ends = self.vertices[self.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        low, high = np.percentile(lengths, [5, 95])
        return {
            "vertices": len(self.vertices),
            "cells": sum(len(cells) for cells in self.cells.values()),
            "area_mm2" if self.IS_PLANAR else "volume_mm3": self._sum(),
            "edge_length_mean": float(lengths.mean()),
            "edge_length_p5": float(low),
            "edge_length_p95": float(high),
            **self.facts,
        }


@dataclass(frozen=True, eq=False)
class VolumeMesh(CellMesh):
    """A mesh of solid cells in mm, one array for each kind; edges become struts, cells become pores.

    Parameters
    ----------
    vertices : array (n, 3) float64
        Coordinates, mm; each vertex belongs to a cell.
    tetrahedra, pyramids, wedges, hexahedra : array (m, 4), (m, 5), (m, 6), (m, 8) int64, optional
        Indices of the corners of each cell in VTK's order, so that its volume is positive.
    facts : mapping, optional
        Measured by the stage that makes it.

    Raises
    ------
    StageError
        An array has another shape or type, a cell is inverted or flat, or two cells overlap at a face.

    Examples
    --------
    >>> mesh = VolumeMesh([[0, 0, 0], [6, 0, 0], [0, 6, 0], [0, 0, 6]], tetrahedra=[[0, 1, 2, 3]])
    >>> mesh.volume, len(mesh.edges)
    (36.0, 6)
    """

    IS_PLANAR = False

    vertices: Floats
    tetrahedra: Ints = field(default_factory=lambda: np.empty((0, 4), np.int64))
    pyramids: Ints = field(default_factory=lambda: np.empty((0, 5), np.int64))
    wedges: Ints = field(default_factory=lambda: np.empty((0, 6), np.int64))
    hexahedra: Ints = field(default_factory=lambda: np.empty((0, 8), np.int64))
    facts: Mapping[str, Fact] = field(default_factory=dict)

    @property
    def volume(self) -> float:
        """Volume of all cells, mm^3."""
        return self._sum()


@dataclass(frozen=True, eq=False)
class PlanarMesh(CellMesh):
    """A mesh of tiles in a plane z = const, mm.

    Parameters
    ----------
    vertices : array (n, 3) float64
        Coordinates, mm, all of one z; each vertex belongs to a tile.
    triangles, quadrangles : array (m, 3), (m, 4) int64, optional
        Indices of the corners of each tile, counter-clockwise seen from +z.
    facts : mapping, optional
        Measured by the stage that makes it.

    Raises
    ------
    StageError
        An array has another shape or type, a tile is turned over or flat, or two tiles overlap at an edge.

    Examples
    --------
    >>> PlanarMesh([[0, 0, 1], [4, 0, 1], [0, 4, 1]], triangles=[[0, 1, 2]]).area
    8.0
    """

    IS_PLANAR = True

    vertices: Floats
    triangles: Ints = field(default_factory=lambda: np.empty((0, 3), np.int64))
    quadrangles: Ints = field(default_factory=lambda: np.empty((0, 4), np.int64))
    facts: Mapping[str, Fact] = field(default_factory=dict)

    @property
    def area(self) -> float:
        """Area of all cells, mm^2."""
        return self._sum()

    @property
    def z(self) -> float:
        """The plane's z, mm."""
        return float(self.vertices[0, 2])
