"""Planar shapes: rings in a plane z = const, and the contour of a planar field.

Seen from +z the shape is to the left of every ring: outer rings are counter-clockwise, holes clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats, Ints
from scaffold_pipeline.errors import StageError


@dataclass(frozen=True, eq=False)
class Polygons(Artifact):
    """Rings that do not cross: `points` (n, 2) mm, ring after ring, and `counts` (k,), the number of points of each."""

    points: Floats
    counts: Ints

    def __post_init__(self) -> None:
        self.own_array("points", np.float64, (None, 2))
        self.own_array("counts", np.int64, (None,))
        if (self.counts < 3).any() or self.counts.sum() != len(self.points):  # a triangle has three
            raise StageError(
                f"Polygons.counts: must be 3 or more for each ring and {len(self.points)} in all, "
                f"got {self.counts.min(initial=0)} or more and {self.counts.sum()} in all"
            )
        super().__post_init__()

    @classmethod
    def of(cls, rings: list[Floats]) -> Polygons:
        """Return the polygons of `rings`, each (k, 2) mm; the first point is not repeated at the end."""
        counts = np.array([len(ring) for ring in rings], np.int64)
        return cls(np.concatenate([np.empty((0, 2)), *rings]), counts)

    @property
    def rings(self) -> list[Floats]:
        """Each ring, (k, 2) mm."""
        return np.split(self.points, np.cumsum(self.counts)[:-1]) if len(self.counts) else []

    @property
    def areas(self) -> Floats:
        """Area within each ring, (k,) mm^2: positive for an outer ring, negative for a hole."""
        return np.array([_area(ring) for ring in self.rings])

    @property
    def area(self) -> float:
        """Area of the shape, mm^2."""
        return float(self.areas.sum())


def _area(ring: Floats) -> float:
    """Return the signed area within a ring, relative to its first point, which avoids cancellation."""
    x, y = (ring - ring[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0


@dataclass(frozen=True, eq=False)
class Contour(Artifact):
    """The solid part of a planar field, {s > iso}, within the outline of its mesh.

    Parameters
    ----------
    solid, outline : Polygons
        Rings of points, mm, with the shape to their left.
    z : float
        The plane's z, mm.
    iso : float
        The field's value on the boundary: the solid is where the field is above it.
    porosity_requested : float, optional
        The porosity, from 0 to 1, that `iso` was solved for.

    Raises
    ------
    StageError
        The solid or the outline encloses no area.

    Examples
    --------
    >>> square = Polygons.of([np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])])
    >>> corner = Polygons.of([np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])])
    >>> Contour(corner, square, z=0.0, iso=0.1).porosity
    0.75
    """

    solid: Polygons
    outline: Polygons
    z: float
    iso: float
    porosity_requested: float | None = None

    def __post_init__(self) -> None:
        if not self.outline.area > 0.0 or not self.solid.area > 0.0:
            raise StageError(
                f"Contour: must enclose an area within an outline, got {self.solid.area:.6g} mm^2 within "
                f"{self.outline.area:.6g}; choose a lower porosity or iso"
            )
        super().__post_init__()

    @property
    def porosity(self) -> float:
        """Area of the pores over the outline's area."""
        return 1.0 - self.solid.area / self.outline.area

    @property
    def pieces(self) -> int:
        """Number of pieces of solid."""
        return int((self.solid.areas > 0.0).sum())

    @property
    def holes(self) -> int:
        """Number of holes: pores that do not reach the outline."""
        return int((self.solid.areas < 0.0).sum())

    def summary(self) -> dict[str, Fact]:
        """Return area, porosity, pieces and holes, and the iso-value."""
        return {
            "area_mm2": self.solid.area,
            "outline_area_mm2": self.outline.area,
            "porosity": self.porosity,
            "porosity_requested": self.porosity_requested,
            "iso": self.iso,
            "pieces": self.pieces,
            "holes": self.holes,
            "points": len(self.solid.points),
        }
