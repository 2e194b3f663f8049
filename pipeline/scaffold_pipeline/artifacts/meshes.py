"""The base of all values passed between stages, and surfaces: immutable, and checked when they are made.

Lengths are mm, axes are those of the input file. A mesh's triangles are counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from reprlib import Repr
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import StageError

if TYPE_CHECKING:
    import pyvista
    import trimesh

Fact: TypeAlias = str | int | float | bool | list[str] | list[float] | None
"""Types of a value in a summary, a record or `metrics.json`; a position or direction is three numbers."""

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]


class _ShortRepr(Repr):
    """What stands for a field's value: of an array its type and shape, of others the beginning."""

    def repr_ndarray(self, array: NDArray[Any], level: int) -> str:
        """Return the type and shape of an array."""
        del level  # all levels alike
        return f"{array.dtype} {array.shape}"


_SHORT = _ShortRepr()
_SHORT.maxother = 60  # characters: a fact's or an artifact's within another


@dataclass(frozen=True, eq=False, repr=False)
class Artifact:
    """Base of the values of slots. Fields are arrays, facts, artifacts, or tuples of facts or artifacts."""

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Artifact.__repr__  # type: ignore[method-assign]  # or dataclass would print whole arrays

    def __repr__(self) -> str:
        """Return the fields, arrays by type and shape alone: `Solid(vertices=float64 (8, 3), ...)`."""
        told = (f"{entry.name}={_SHORT.repr(getattr(self, entry.name))}" for entry in fields(self) if entry.repr)
        return f"{type(self).__name__}({', '.join(told)})"

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def summary(self) -> dict[str, Fact]:
        """Return the facts of this value for a report."""
        return {}

    def _repr_html_(self) -> str:
        """Return this value's facts as a table for a notebook."""
        from scaffold_pipeline.artifacts.markup import artifact_html

        return artifact_html(self)

    def own_array(self, name: str, dtype: type, shape: tuple[int | None, ...]) -> None:
        """Replace field `name` by a contiguous array of `dtype`, after checking its shape and that it is finite.

        Call it for each array in `__post_init__`, and then call `super().__post_init__()`, which makes the arrays
        read-only. An array that already is read-only and of that type is not copied.

        Parameters
        ----------
        name
            The field; it may hold any value that numpy converts to an array.
        dtype
            The required type: integers are converted to floats, floats not to integers.
        shape
            The required length along each axis; None for any.

        Raises
        ------
        StageError
            The array has another shape or type, or a value that is not finite; the error names the field.

        Examples
        --------
        An artifact of a plug-in, at the top level of a module, where the store finds its class by name:

        >>> @dataclass(frozen=True, eq=False)
        ... class Landmarks(Artifact):
        ...     places: Floats
        ...
        ...     def __post_init__(self) -> None:
        ...         self.own_array("places", np.float64, (None, 3))
        ...         super().__post_init__()
        ...
        ...     def summary(self) -> dict[str, Fact]:
        ...         return {"landmarks": len(self.places)}
        >>> Landmarks([[0, 0, 1], [0, 2, 0]]).summary()
        {'landmarks': 2}
        >>> Landmarks([[0.0, 0.0]])
        Traceback (most recent call last):
        scaffold_pipeline.errors.StageError: Landmarks.places: must have shape ('n', 3), got (1, 2)
        """
        value = getattr(self, name)
        given = np.asarray(value)
        fits = [want in {None, got} for want, got in zip(shape, given.shape, strict=False)]
        if given.ndim != len(shape) or not all(fits):
            wanted = tuple("n" if want is None else want for want in shape)
            what = f"; it is no array but of type {type(value).__name__}" if given.ndim == 0 else ""
            raise StageError(f"{type(self).__name__}.{name}: must have shape {wanted}, got {given.shape}{what}")
        remedy = f"; convert it: array.astype({np.dtype(dtype).name!r})" if given.dtype.kind == "f" else ""
        if given.dtype.kind not in "biuf" or (np.dtype(dtype).kind == "i" and given.dtype.kind == "f"):
            raise StageError(f"{type(self).__name__}.{name}: must hold {dtype.__name__}, got {given.dtype}{remedy}")
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite and is refused next
            owned: NDArray[Any] = np.array(given, dtype=dtype, order="C", copy=True if given.flags.writeable else None)
        if owned.dtype.kind == "f" and not np.isfinite(owned).all():
            bad = np.argwhere(~np.isfinite(owned))
            where = f"{len(bad)} values are NaN or infinite, the first at {bad[0].tolist()}"
            raise StageError(f"{type(self).__name__}.{name}: must be finite, but {where}")
        object.__setattr__(self, name, owned)


def require_indices(owner: str, name: str, indices: Ints, count: int) -> None:
    """Require that `indices` of an artifact's field lie in 0..count - 1; raises `StageError`."""
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise StageError(f"{owner}.{name}: indices must lie in 0..{count - 1}, got {indices.min()}..{indices.max()}")


def _unmatched_sides(faces: Ints, count: int) -> int:
    """Count the half-edges of `faces` (m, 3) without an opposite half-edge: 0 if the surface is closed."""
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    ways, back = np.sort(starts * count + ends), np.sort(ends * count + starts)
    if np.array_equal(ways, back):
        return 0
    return int((~np.isin(ways, back)).sum()) or len(ways) - len(np.intersect1d(ways, back))


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Artifact):
    """A triangle mesh in mm.

    Parameters
    ----------
    vertices : array (n, 3) float64
        Coordinates, mm. The mesh keeps a read-only copy.
    faces : array (m, 3) int64
        Indices of each triangle's corners, counter-clockwise seen from outside.

    Raises
    ------
    StageError
        An array has another shape or type, a coordinate is not finite, or an index is out of range.

    Examples
    --------
    >>> corners = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
    >>> surface = SurfaceMesh(corners, [[0, 1, 2]])
    >>> surface.area
    8.0
    >>> surface.to_trimesh().faces.shape
    (1, 3)
    """

    vertices: Floats
    faces: Ints

    def __post_init__(self) -> None:
        self.own_array("vertices", np.float64, (None, 3))
        self.own_array("faces", np.int64, (None, 3))
        require_indices(type(self).__name__, "faces", self.faces, len(self.vertices))
        super().__post_init__()

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh) -> Self:
        """Return the surface of a `trimesh.Trimesh`; its coordinates are taken as mm.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            If its `units` are set, they must be mm.

        Raises
        ------
        StageError
            It is not a `Trimesh`, is not in mm, or breaks a rule of this class.

        Examples
        --------
        >>> import trimesh
        >>> outer = OuterShape.from_trimesh(trimesh.creation.box((2, 3, 4)))
        >>> round(outer.volume, 9)
        24.0
        """
        from scaffold_pipeline.artifacts.conversions import surface_from_trimesh

        return cls(*surface_from_trimesh(mesh))

    @classmethod
    def from_pyvista(cls, mesh: pyvista.PolyData) -> Self:
        """Return the surface of a `pyvista.PolyData`, polygons cut into triangles; its coordinates are taken as mm.

        Parameters
        ----------
        mesh : pyvista.PolyData
            Faces only, no lines or points.

        Raises
        ------
        StageError
            It is not a `PolyData`, has other cells, or breaks a rule of this class.
        """
        from scaffold_pipeline.artifacts.conversions import surface_from_pyvista

        return cls(*surface_from_pyvista(mesh))

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a `trimesh.Trimesh` in mm with the same vertices and faces, in the same order, writable."""
        from scaffold_pipeline.artifacts.conversions import surface_to_trimesh

        return surface_to_trimesh(self)

    def to_pyvista(self) -> pyvista.PolyData:
        """Return a `pyvista.PolyData` in mm with the same vertices and faces, writable."""
        from scaffold_pipeline.artifacts.conversions import surface_to_pyvista

        return surface_to_pyvista(self)

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
        """Return a point among the vertices, relative to which sums are exact even far from the file's origin."""
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
    """The anatomical outer shape: a closed, outward surface in mm.

    Parameters
    ----------
    vertices : array (n, 3) float64
        Coordinates, mm.
    faces : array (m, 3) int64
        Indices of each triangle's corners, counter-clockwise seen from outside.
    notes : tuple of str, optional
        What was done to the surface of the file, in words.
    facts : mapping, optional
        The same as numbers.

    Raises
    ------
    StageError
        The surface is open, its triangles are not consistently oriented, or they face inward.

    Examples
    --------
    >>> corners = [[0, 0, 0], [6, 0, 0], [0, 6, 0], [0, 0, 6]]
    >>> OuterShape(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).volume
    36.0
    """

    notes: tuple[str, ...] = ()
    facts: Mapping[str, Fact] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        lone = _unmatched_sides(self.faces, len(self.vertices))
        if lone:
            raise StageError(
                f"OuterShape: must be closed and consistently oriented, but {lone} of "
                f"{3 * len(self.faces)} triangle sides have no neighbour; the stage load_surface repairs files"
            )
        if self.volume <= 0.0:
            remedy = "; its triangles face inward: turn them, as in faces[:, ::-1]" if self.volume < 0.0 else ""
            raise StageError(f"OuterShape: must enclose a positive volume, got {self.volume:.6g} mm^3{remedy}")

    def summary(self) -> dict[str, Fact]:
        """Return the surface's facts and notes."""
        return {**super().summary(), "notes": "; ".join(self.notes), **self.facts}


@dataclass(frozen=True, eq=False)
class IsoSurface(SurfaceMesh):
    """The surface between solid and void, mm, not yet clipped to the outer shape.

    Parameters
    ----------
    vertices, faces : array (n, 3) float64, array (m, 3) int64
        As those of a `SurfaceMesh`.
    iso : float, default 0.0
        The field's value on the surface: the solid is where the field is above it.
    porosity_requested : float, optional
        The porosity, from 0 to 1, that `iso` was solved for.
    skin : float, default 0.0
        Thickness of the shell that was counted as solid in solving for the porosity, mm.
    facts : mapping, optional
        What was done to the surface later.
    spacing : float, optional
        Size of the field's voxels, mm; None for a surface without voxels.
    """

    iso: float = 0.0
    porosity_requested: float | None = None
    skin: float = 0.0
    facts: Mapping[str, Fact] = field(default_factory=dict)
    spacing: float | None = None

    def summary(self) -> dict[str, Fact]:
        """Return the surface's facts, the iso-value and the facts of its cleaning."""
        asked = {"porosity_requested": self.porosity_requested}
        return {**super().summary(), "iso": self.iso, **asked, **self.facts}


@dataclass(frozen=True, eq=False)
class Solid(SurfaceMesh):
    """The printable solid, mm; its coordinates are exact in float32, so that no file rounds them.

    Parameters
    ----------
    vertices, faces : array (n, 3) float64, array (m, 3) int64
        As those of a `SurfaceMesh`.
    pore_volumes : array (k,) float64, optional
        Volume of each connected piece of the pore space within the outer shape, mm^3, greatest first.
    facts : mapping, optional
        Counted by the clip to the outer shape.

    Raises
    ------
    StageError
        It encloses no volume.
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
        """Return the facts of the surface and of the clip."""
        return {**super().summary(), "pore_pieces": len(self.pore_volumes), **self.facts}


@dataclass(frozen=True, eq=False)
class WrittenFiles(Artifact):
    """The files that a stage wrote, with facts of what was read back."""

    facts: Mapping[str, Fact]

    def summary(self) -> dict[str, Fact]:
        """Return the facts of each file."""
        return dict(self.facts)
