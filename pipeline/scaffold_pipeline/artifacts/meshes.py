"""The values that stages hand to each other: frozen, checked once when made, their arrays locked.

Lengths are mm, axes are those of the input file. A mesh's triangles are counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.artifacts.cells import CELL_TYPES, cell_measures, edges_of_cells, mesh_faults
from scaffold_pipeline.errors import StageError

Fact: TypeAlias = str | int | float | bool | list[str] | None
"""What a summary, a record or `metrics.json` may hold under one key."""

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Artifact:
    """Base of what a slot can hold. Fields are arrays, facts, artifacts, or tuples of facts or artifacts."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def summary(self) -> dict[str, Fact]:
        """Return the facts of this value that belong into a report."""
        return {}

    def own_array(self, name: str, dtype: type, shape: tuple[int | None, ...]) -> None:
        """Replace field `name` by a contiguous array of `dtype`, after checking its shape and finiteness."""
        given = np.asarray(getattr(self, name))
        fits = [want in {None, got} for want, got in zip(shape, given.shape, strict=False)]
        if given.ndim != len(shape) or not all(fits):
            wanted = tuple("n" if want is None else want for want in shape)
            raise StageError(f"{type(self).__name__}.{name}: must have shape {wanted}, got {given.shape}")
        if given.dtype.kind not in "biuf" or (np.dtype(dtype).kind == "i" and given.dtype.kind == "f"):
            raise StageError(f"{type(self).__name__}.{name}: must hold {dtype.__name__}, got {given.dtype}")
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite and is refused next
            owned: NDArray[Any] = np.array(given, dtype=dtype, order="C", copy=True if given.flags.writeable else None)
        if owned.dtype.kind == "f" and not np.isfinite(owned).all():
            bad = int(np.count_nonzero(~np.isfinite(owned)))
            raise StageError(f"{type(self).__name__}.{name}: must be finite, but {bad} values are NaN or infinite")
        object.__setattr__(self, name, owned)


def _require_indices(owner: str, name: str, indices: Ints, count: int) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise StageError(f"{owner}.{name}: indices must lie in 0..{count - 1}, got {indices.min()}..{indices.max()}")


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Artifact):
    """A triangle mesh: `vertices` (n, 3) mm, `faces` (m, 3) corner indices, normals outward by the right hand."""

    vertices: Floats
    faces: Ints

    def __post_init__(self) -> None:
        self.own_array("vertices", np.float64, (None, 3))
        self.own_array("faces", np.int64, (None, 3))
        _require_indices("SurfaceMesh", "faces", self.faces, len(self.vertices))
        super().__post_init__()

    @property
    def volume(self) -> float:
        """Signed volume, mm^3: positive for a closed surface whose normals point outwards."""
        a, b, c = np.moveaxis(self.vertices[self.faces] - self._origin(), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    @property
    def area(self) -> float:
        """Area, mm^2."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)

    @property
    def bounds(self) -> Floats:
        """Least and greatest corner of the axis-aligned bounding box, (2, 3) mm."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def _origin(self) -> Floats:
        """Return a point amid the vertices: far from the file's origin, sums about it keep their digits."""
        return self.bounds.mean(axis=0) if len(self.vertices) else np.zeros(3)

    def summary(self) -> dict[str, Fact]:
        """Return counts, volume, area and size."""
        size = np.ptp(self.vertices, axis=0) if len(self.vertices) else np.zeros(3)
        return {
            "vertices": len(self.vertices),
            "triangles": len(self.faces),
            "volume_mm3": self.volume,
            "area_mm2": self.area,
            **{f"size_{axis}": float(length) for axis, length in zip("xyz", size, strict=True)},
        }


@dataclass(frozen=True, eq=False)
class OuterShape(SurfaceMesh):
    """The anatomical outer shape: a closed, outward surface.

    `notes` tell in words what was done to make it so, `facts` by number.
    """

    notes: tuple[str, ...] = ()
    facts: Mapping[str, Fact] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.volume <= 0.0:
            raise StageError(f"OuterShape: must enclose a positive volume, got {self.volume:.6g} mm^3")

    def summary(self) -> dict[str, Fact]:
        """Return the surface's facts, the notes and what was done."""
        return {**super().summary(), "notes": "; ".join(self.notes), **self.facts}


class CellMesh(Artifact):
    """Cells of one or more kinds over shared vertices: what a `VolumeMesh` and a `PlanarMesh` have in common.

    `vertices` (n, 3) mm; one array of corner indices for each cell kind, in VTK's order. Every cell has distinct
    corners and a positive volume or area, every face one cell on each side at most, every vertex a cell. `facts` are
    what the maker measured.
    """

    IS_PLANAR: ClassVar[bool]
    vertices: Floats
    facts: Mapping[str, Fact]

    def __post_init__(self) -> None:
        owner = type(self).__name__
        self.own_array("vertices", np.float64, (None, 3))
        for name, kind in self._kinds().items():
            self.own_array(name, np.int64, (None, CELL_TYPES[kind].corners))
            _require_indices(owner, name, getattr(self, name), len(self.vertices))
        for fault in mesh_faults(self.vertices, self.cells):
            raise StageError(f"{owner}{fault}")
        super().__post_init__()

    @classmethod
    def _kinds(cls) -> dict[str, str]:
        """Return the kind of cell that each field holds."""
        return {kind.plural: kind.name for kind in CELL_TYPES.values() if kind.is_planar == cls.IS_PLANAR}

    @property
    def cells(self) -> dict[str, Ints]:
        """The corner indices of each cell kind that the mesh has, keyed by the names of `CELL_TYPES`."""
        return {kind: getattr(self, name) for name, kind in self._kinds().items() if len(getattr(self, name))}

    @property
    def edges(self) -> Ints:
        """Every edge once, (k, 2), smaller index first, sorted."""
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
    """A mesh of solid cells: `tetrahedra` (m, 4), `pyramids` (m, 5), `wedges` (m, 6) and `hexahedra` (m, 8)."""

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
    """A mesh of tiles in a plane z = const, counter-clockwise from +z: `triangles` (m, 3), `quadrangles` (m, 4)."""

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
        """Place of the plane, mm."""
        return float(self.vertices[0, 2])


@dataclass(frozen=True, eq=False)
class IsoSurface(SurfaceMesh):
    """The surface between solid and void, not yet clipped to the outer shape.

    `iso` is the value used; `porosity_requested` the porosity it was solved for, or None; `skin` the shell
    in mm that was counted as solid in solving; `facts` what was done to the surface since; `spacing` the size in mm of
    the field's voxels, or None where the surface comes from no voxels.
    """

    iso: float = 0.0
    porosity_requested: float | None = None
    skin: float = 0.0
    facts: Mapping[str, Fact] = field(default_factory=dict)
    spacing: float | None = None

    def summary(self) -> dict[str, Fact]:
        """Return the surface's facts, the iso-value and what was removed."""
        asked = {"porosity_requested": self.porosity_requested}
        return {**super().summary(), "iso": self.iso, **asked, **self.facts}


@dataclass(frozen=True, eq=False)
class Solid(SurfaceMesh):
    """The printable solid, its coordinates exact in float32 so that no file rounds them further.

    `pore_volumes` (k,) mm^3 is the volume of each connected piece of the pore space within the outer shape,
    greatest first; `facts` what the clip did.
    """

    pore_volumes: Floats = field(default_factory=lambda: np.empty(0))
    facts: Mapping[str, Fact] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.own_array("pore_volumes", np.float64, (None,))
        super().__post_init__()
        if not len(self.faces) or self.volume <= 0.0:
            raise StageError(
                f"Solid: must enclose a positive volume, got {len(self.faces)} triangles of {self.volume:.6g} mm^3; "
                "choose a lower porosity or iso"
            )

    def summary(self) -> dict[str, Fact]:
        """Return the surface's facts and what the clip did."""
        return {**super().summary(), "pore_pieces": len(self.pore_volumes), **self.facts}


@dataclass(frozen=True, eq=False)
class WrittenFiles(Artifact):
    """The files that a stage wrote: what each held when it was read back."""

    facts: Mapping[str, Fact]

    def summary(self) -> dict[str, Fact]:
        """Return the facts of each file."""
        return dict(self.facts)
