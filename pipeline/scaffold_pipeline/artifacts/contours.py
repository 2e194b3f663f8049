"""Flat shapes between stages: rings in a plane z = const, and the contour that a planar field gives.

Seen from +z the shape lies to the left of every ring: counter-clockwise around it, clockwise around its holes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_pipeline.artifacts.meshes import Artifact, Fact, Floats, Ints
from scaffold_pipeline.errors import StageError


@dataclass(frozen=True, eq=False)
class Polygons(Artifact):
    """Rings that do not cross: `points` (n, 2) mm, ring after ring, and `counts` (k,), the points of each ring."""

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
        """Return the polygons of `rings`, each (k, 2) mm, its last point not the first again."""
        counts = np.array([len(ring) for ring in rings], np.int64)
        return cls(np.concatenate([np.empty((0, 2)), *rings]), counts)

    @property
    def rings(self) -> list[Floats]:
        """Each ring, (k, 2) mm."""
        return np.split(self.points, np.cumsum(self.counts)[:-1]) if len(self.counts) else []

    @property
    def areas(self) -> Floats:
        """The area within each ring, (k,) mm^2: positive around the shape, negative around a hole."""
        return np.array([_area(ring) for ring in self.rings])

    @property
    def area(self) -> float:
        """Area of the shape, mm^2."""
        return float(self.areas.sum())


def _area(ring: Floats) -> float:
    """Return the signed area within a ring, summed about its first point, far from which digits would be lost."""
    x, y = (ring - ring[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0


@dataclass(frozen=True, eq=False)
class Contour(Artifact):
    """What is solid of a planar field, {s > iso}, within the outline of its mesh.

    Parameters
    ----------
    solid, outline : Polygons
        Rings of points, mm, the shape to their left.
    z : float
        Place of the plane, mm.
    iso : float
        The field's value on the boundary: solid is where it is above.
    porosity_requested : float, optional
        The share of 1 that `iso` was solved for.

    Raises
    ------
    StageError
        One of them encloses no area.

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
        """Share of the outline's area that is pore."""
        return 1.0 - self.solid.area / self.outline.area

    @property
    def pieces(self) -> int:
        """How many pieces of solid there are."""
        return int((self.solid.areas > 0.0).sum())

    @property
    def holes(self) -> int:
        """How many holes they have in all: pores that do not reach the outline."""
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
