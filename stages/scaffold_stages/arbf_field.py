"""Stage `arbf_field`: the anisotropic radial-basis-function field of a volume mesh on voxels, with its certificate.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function". `exact` is their
interpolation, for small meshes; `normalised` is local and bounded, and works on real anatomy.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_pipeline.artifacts import CellMesh, Certificate, Fact, Floats, Ints, OuterShape, ScalarField
from scaffold_pipeline.contract import Follows, InputFile, Millimetres, Params, Unit, stage
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.memory import available_memory
from scaffold_stages._kernels.grids import Bools, grid_over, grown, samples_inside
from scaffold_stages._kernels.point_files import read_points

if TYPE_CHECKING:
    from scaffold_stages._kernels.certificate import FieldAt
    from scaffold_stages._kernels.interpolant import Solution
    from scaffold_stages._kernels.shepard import Bins, Segments
    from scaffold_stages._kernels.skeleton import Skeleton

Basis = Literal["gaussian", "multiquadric", "inverse_multiquadric", "thin_plate_spline"]
SampleCount = Annotated[int, Field(ge=2)]
LayerCount = Annotated[int, Field(ge=1)]
Distance = Literal["endpoint", "endpoint-to-segment", "exact"]

MARGIN = 3
"""Samples beyond the outer shape's box: the field is void from two samples outside on, and the clip needs no more."""

_EXACT_C, _NORMALISED_C = 0.1, 0.01
_EXPONENT, _SUPPORT = 4, 1.0
"""Chosen on three bones with jitter 0.2; windows are those of a heel bone.

c = 0.05: (-0.19, -0.05), 0.02: (-0.76, 0.68), 0.01: (-0.97, 0.96). With 0.02 a strut of the hip bone (1 of 23,632), the
meniscus and the femur left the window at 65 % porosity; below 0.01 nothing is gained that voxels can show.
p = 2: (-0.46, 0.23), 6: (-0.90, 0.86), but it crowds 65 to 80 % porosity into iso-values of 0.85 to 0.99. With c and R
of the mean edge, not the local: (-0.49, 0.41). R of 0.6 to 1.6 moves the window by 0.001 and leaves no sample half
reached; 1.0 takes 0.6 of the time of 1.3 and leaves 6 % more crumbs at 80 %.
"""

_BYTES_PER_VOXEL = 8
"""The field in single precision and three masks, with one to spare."""

MOST_UNKNOWNS = 8000
"""Above this the published form has long lost its field on any mesh, and the solver takes many minutes."""

_BOX = 0.5
"""Edge of the boxes that segments are sorted into, mean edge lengths: 0.5 was fastest of 0.25 to 1."""

_THROATS, _WAISTS = (0.7, 1.0), (0.35, 0.65)
"""Where along a channel, towards its face, and along a strut its thickness is looked at."""

_USUAL = 2.0
"""Greatest |s| of a healthy exact field: small meshes of the paper reach 1.8."""


class GridParams(Params):
    """A regular grid: sample (i, j, k) lies at `origin + spacing * (i, j, k)`."""

    origin: Annotated[tuple[float, float, float], Unit("mm")]
    """Place of the first sample."""

    spacing: Millimetres = Field(gt=0.0)
    """Distance between samples along each axis."""

    shape: tuple[SampleCount, SampleCount, LayerCount]
    """Number of samples along x, y and z; one along z is a section, or the plane of a planar mesh."""


class ArbfFieldParams(Params):
    """Parameters of `arbf_field`."""

    voxel_size: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Distance between samples of the field: a twentieth of the mean edge keeps a bone's struts whole in the file."""

    grid: GridParams | None = None
    """The grid itself, instead of a voxel size."""

    points: Annotated[InputFile | None, Follows("write_field", "points")] = None
    """CSV file of points x, y, z in mm at which the field, not its voxels, is evaluated for `write_field`."""

    interpolation: Literal["normalised", "exact"] = "normalised"
    """`normalised` for real anatomy; `exact` for the published form on small meshes."""

    solid: Literal["edges", "vertices"] | None = None
    """What is +1: mesh edges (default of `normalised`) or vertices alone (the paper, default of `exact`)."""

    c: Annotated[float | None, Unit("local edge lengths, or mm with exact")] = Field(default=None, gt=0.0)
    """Shape parameter of the kernel (1/mm for the Gaussian); 0.01 with `normalised`, 0.1 with `exact`."""

    exponent: Literal[2, 4, 6, 8] | None = None
    """p of the kernel (r^2 + c^2)^(-p/2), `normalised` only; 4."""

    support: Annotated[float | None, Unit("local edge lengths")] = Field(default=None, gt=0.0, le=10.0)
    """Distance at which the kernel has fallen to zero, `normalised` only; 1.0."""

    basis: Basis | None = None
    """Radial basis function, `exact` only; inverse_multiquadric."""

    distance: Distance | None = None
    """Reading of the distance between two segments, `exact` only; endpoint-to-segment."""

    @model_validator(mode="after")
    def _one_grid(self) -> ArbfFieldParams:
        if (self.voxel_size is None) == (self.grid is None):
            raise ValueError("give either voxel_size or grid")
        return self

    @model_validator(mode="after")
    def _only_what_applies(self) -> ArbfFieldParams:
        foreign = ("basis", "distance") if self.interpolation == "normalised" else ("exponent", "support")
        for name in foreign:
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: has no meaning with interpolation: {self.interpolation}; leave it out")
        if self.c is not None and self.basis == "thin_plate_spline":
            raise ValueError("c: has no meaning with basis: thin_plate_spline; leave it out")
        least, most = (0.0, 1.0) if self.interpolation == "normalised" else (1e-9, 1e6)  # beyond, digits are lost
        if self.c is not None and not least <= self.c <= most:
            raise ValueError(
                f"c: must be {least:g} to {most:g} with interpolation: {self.interpolation}, got {self.c:g}"
            )
        return self


@stage(writes="field", version=6, libraries=("llvmlite", "numba", "scipy", "vtk"))
def arbf_field(mesh: CellMesh, outer: OuterShape | None = None, *, params: ArbfFieldParams) -> ScalarField:
    """Compute the ARBF field of a mesh on voxels over the outer shape, and certify its connectivity.

    Samples more than two voxels outside the outer shape are void (-1). A planar mesh can do without one; its samples
    are one layer in its plane. Its channels end on its edges: no iso has all channels open and all struts whole.
    Raises `StageError` where the grid or the exact system needs more memory than there is, or the support is too small
    to reach every point.
    """
    from scaffold_stages._kernels.skeleton import skeleton_of, slab_around

    points = np.empty((0, 3)) if params.points is None else read_points(params.points)
    if outer is None and not mesh.IS_PLANAR:
        raise StageError("outer: only a planar mesh can do without an outer shape; add a stage that writes `outer`")
    outer = outer or OuterShape(*slab_around(mesh.vertices, mesh.cells))
    origin, spacing, shape = _grid(outer.bounds, params, mesh)
    inside = samples_inside(outer.vertices, outer.faces, origin, spacing, shape)
    if not inside.any():
        raise StageError(f"voxel_size {spacing:g} mm: no sample lies inside the outer shape; use a smaller one")
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    field = _normalised(skeleton, params) if params.interpolation == "normalised" else _exact(skeleton, params)
    voxels = _Voxels(origin, spacing, inside, near=grown(inside, 2))
    values = field.on_voxels(voxels)
    values[~voxels.near] = -1.0
    values.setflags(write=False)  # or the artifact would copy it
    certificate = _certificate(skeleton, field, spacing)
    if field.solution:
        on_skeleton = max(np.abs(certificate.channel_maxima).max(), np.abs(certificate.strut_minima).max())
        _warn_of_health(field.solution, float(max(on_skeleton, np.abs(values[inside]).max())))
    return ScalarField(values, origin, spacing, certificate, field.facts, points, field.at(points))


def _grid(bounds: Floats, params: ArbfFieldParams, mesh: CellMesh) -> tuple[Floats, float, tuple[int, int, int]]:
    """Return origin, spacing and shape of the grid: the one given, or the one that covers `bounds` (2, 3).

    For a planar mesh it is one layer in its plane.
    """
    z = mesh.vertices[0, 2]
    if mesh.IS_PLANAR:
        bounds = np.insert(bounds[:, :2], 2, z, axis=1)
    if params.grid is None:
        spacing = params.voxel_size or 0.0
        _require_memory(bounds, spacing)
        origin, shape = grid_over(bounds, spacing, MARGIN)
        return (np.append(origin[:2], z), spacing, (*shape[:2], 1)) if mesh.IS_PLANAR else (origin, spacing, shape)
    grid = params.grid
    if mesh.IS_PLANAR and (grid.shape[2] > 1 or abs(grid.origin[2] - z) > 1e-6 * grid.spacing):
        raise StageError(
            f"grid: a planar mesh has one layer of samples, in its plane at z = {z:g} mm, got {grid.shape[2]} from "
            f"{grid.origin[2]:g} mm; end origin with {z:g} and shape with 1"
        )
    last = np.array(grid.origin) + grid.spacing * (np.array(grid.shape) - 1)
    _require_memory(np.array([grid.origin, last]), grid.spacing)
    if (bounds[0] < grid.origin).any() or (bounds[1] > last).any():
        warnings.warn("grid: does not cover the outer shape; the solid ends where the grid does", PipelineWarning, 3)
    return np.array(grid.origin, float), grid.spacing, grid.shape


def _require_memory(bounds: Floats, spacing: float) -> None:
    needed, there = _memory_needed(bounds, spacing), available_memory()
    if needed <= there:
        return
    fitting = spacing
    while _memory_needed(bounds, fitting) > there and fitting < np.ptp(bounds, axis=0).max():
        fitting = float(f"{1.1 * fitting:.2g}")
    raise StageError(
        f"voxel_size {spacing:g} mm: the grid needs {needed / 2**30:.1f} GiB, but {there / 2**30:.1f} GiB are free; "
        f"{fitting:g} mm would fit"
    )


def _memory_needed(bounds: Floats, spacing: float) -> float:
    """Return the bytes that a grid over `bounds` (2, 3) needs; its axes have at most so many samples."""
    counts: list[float] = (np.ptp(bounds, axis=0) / spacing + 2 * MARGIN + 2).tolist()
    return math.prod(counts) * _BYTES_PER_VOXEL


@dataclass(frozen=True, eq=False)
class _Voxels:
    """Samples at `origin + spacing * (i, j, k)` mm: which lie `inside` the outer shape, which within two of it."""

    origin: Floats
    spacing: float
    inside: Bools
    near: Bools


@dataclass(frozen=True, eq=False)
class _Field:
    """A field that is ready to be computed: on voxels, float32, and at points (n, 3) mm, (n,), many in less time."""

    on_voxels: Callable[[_Voxels], NDArray[np.float32]]
    at: FieldAt
    at_many: FieldAt
    facts: dict[str, Fact]
    solution: Solution | None = None


def _normalised(skeleton: Skeleton, params: ArbfFieldParams) -> _Field:
    from scaffold_stages._kernels.shepard import segments_of

    support = params.support or _SUPPORT
    segments = segments_of(
        skeleton,
        c=params.c or _NORMALISED_C,
        support=support,
        exponent=params.exponent or _EXPONENT,
        vertices_only=params.solid == "vertices",
    )
    facts: dict[str, Fact] = {
        "elements": len(segments.reaches),
        "local_support": float(np.sqrt(segments.reaches.max()) * segments.unit),
    }
    at = _at_points(segments)
    return _Field(lambda voxels: _on_tiles(segments, voxels, support), at, partial(at, precision=np.float32), facts)


def _on_tiles(segments: Segments, voxels: _Voxels, support: float) -> NDArray[np.float32]:
    from scaffold_stages._kernels.shepard import bin_segments
    from scaffold_stages._kernels.shepard_grid import TILE, field_on_tiles

    first, step = (voxels.origin - segments.centre) / segments.unit, voxels.spacing / segments.unit
    samples = TILE * max(round(_BOX / (TILE * step)), 1)
    nx, ny, nz = (-(-count // samples) for count in voxels.inside.shape)
    bins = bin_segments(segments, first - step / 2.0, np.full(3, samples * step), (nx, ny, nz))
    values = np.full(voxels.inside.shape, -1.0, np.float32)
    active = _active_tiles(voxels.near, TILE)
    half_reached = field_on_tiles(segments, bins, first, step, active, voxels.inside, values)
    _require_reached(half_reached, support)
    return values


def _at_points(segments: Segments) -> Callable[..., Floats]:
    """Return the normalised field as a function of points in mm; what no segment can reach is void."""
    from scaffold_stages._kernels.shepard import bin_segments, field_at

    starts, ends = segments.starts, segments.starts + segments.steps
    reach = float(np.sqrt(segments.reaches.max()))
    low, high = np.minimum(starts, ends).min(axis=1) - reach, np.maximum(starts, ends).max(axis=1) + reach
    nx, ny, nz = (int(count) for count in np.maximum(np.ceil((high - low) / _BOX), 1.0))

    @cache
    def bins() -> Bins:  # made at the first call: the voxels' own lists need as much memory, and are gone by then
        return bin_segments(segments, low, np.full(3, _BOX), (nx, ny, nz))

    def at(points: Floats, precision: type[np.floating[Any]] = np.float64) -> Floats:
        places = (points - segments.centre) / segments.unit
        is_near = ((places > low) & (places < high)).all(axis=1)
        values = np.full(len(points), -1.0)
        values[is_near] = field_at(segments, bins(), places[is_near], precision)
        return values

    return at


def _active_tiles(near: Bools, size: int) -> Ints:
    """Return the numbers of the tiles of `size` samples that hold one of `near`, (nx, ny, nz), last axis fastest."""
    for axis, count in enumerate(near.shape):
        near = np.logical_or.reduceat(near, np.arange(0, count, size), axis=axis)
    return np.flatnonzero(near)


def _require_reached(half_reached: int, support: float) -> None:
    if half_reached:
        raise StageError(
            f"support: {half_reached} samples inside the outer shape are reached by struts or by channels alone; raise "
            f"support (now {support:g} local edge lengths), or check that the mesh fills the outer shape"
        )


def _certificate(skeleton: Skeleton, field: _Field, spacing: float) -> Certificate:
    """Return the extremes of a field along every channel and strut, and around them at a voxel and parts of it."""
    from scaffold_stages._kernels.certificate import extremes_along, extremes_around

    ends = skeleton.vertices[skeleton.edges]
    struts, channels = (ends[:, 0], ends[:, 1]), (skeleton.channel_starts, skeleton.channel_ends)
    around = partial(extremes_around, field.at_many)
    radii = [spacing * share for share in Certificate.RING_SHARES]
    return Certificate(
        channel_maxima=extremes_along(field.at_many, *channels, 1, field.at),
        strut_minima=extremes_along(field.at_many, *struts, -1, field.at),
        channel_rings=np.stack([around(*channels, _THROATS, radius, 1) for radius in radii], axis=1),
        strut_rings=np.stack([around(*struts, _WAISTS, radius, -1) for radius in radii], axis=1),
        voxel_size=spacing,
    )


def _exact(skeleton: Skeleton, params: ArbfFieldParams) -> _Field:
    from scaffold_stages._kernels import interpolant

    basis, c = params.basis or "inverse_multiquadric", _EXACT_C if params.c is None else params.c
    elements, targets = interpolant.elements_of(skeleton), interpolant.values_of(skeleton)
    if params.solid == "edges":
        elements, targets = interpolant.with_edges(skeleton, elements, targets)
    _require_exact_memory(elements.unknowns)
    matrix = interpolant.assemble(elements, basis, params.distance or "endpoint-to-segment", c)
    expected = interpolant.expected_negative_eigenvalues(basis, len(elements.starts))
    solution = interpolant.solve(matrix, targets, expected)

    def at(points: Floats) -> Floats:
        x, y, z = np.ascontiguousarray(points.T)
        return interpolant.evaluate(x, y, z, elements, solution.weights, basis, c)

    def on_voxels(voxels: _Voxels) -> NDArray[np.float32]:
        values = np.full(voxels.inside.shape, -1.0, np.float32)
        x, y, z = (voxels.origin[axis] + voxels.spacing * np.arange(values.shape[axis]) for axis in range(3))
        interpolant.evaluate_on_grid((x, y, z), voxels.near, elements, solution.weights, basis, c, values)
        return values

    facts: dict[str, Fact] = {
        "elements": elements.unknowns,
        "unknowns": solution.unknowns,
        "rank": solution.rank,
        "negative_eigenvalues": solution.negative_eigenvalues,
        "expected_negative_eigenvalues": solution.expected_negative_eigenvalues,
        "condition": solution.condition,
        "residual": solution.residual,
    }
    return _Field(on_voxels, at, at, facts, solution)


def _require_exact_memory(unknowns: int) -> None:
    from scaffold_stages._kernels.interpolant import memory_needed

    needed, there = memory_needed(unknowns), available_memory()
    if needed > there or unknowns > MOST_UNKNOWNS:
        raise StageError(
            f"interpolation: exact has {unknowns} unknowns here, which need {needed / 2**30:.1f} GiB "
            f"({there / 2**30:.1f} GiB are free) and must be at most {MOST_UNKNOWNS}; use interpolation: normalised, "
            "or a coarser mesh"
        )


def _warn_of_health(solution: Solution, greatest: float) -> None:
    """Warn where the exact interpolant is no field to trust; `greatest` is |s| at most.

    A residual check would catch none of this, and the inertia and the skeleton alone miss 4^3 and 5^3 even cubes,
    between whose channels s reaches 3.8 and 13.
    """
    if not solution.is_full_rank:
        is_met = not round(solution.residual, 6)  # rounding leaves 1e-12, a missing interpolant some 0.1
        what = "several interpolants exist, as elements coincide" if is_met else "no interpolant exists"
        warnings.warn(
            f"exact: {what} (rank {solution.rank} of {solution.unknowns}); this is the least-squares "
            f"field of least norm, off by up to {solution.residual:.2g} on the elements",
            PipelineWarning,
            stacklevel=2,
        )
    if not solution.has_expected_inertia:
        warnings.warn(
            f"exact: the system has {solution.negative_eigenvalues} negative eigenvalues, a healthy one "
            f"{solution.expected_negative_eigenvalues}; the field is not to be trusted: use interpolation: normalised",
            PipelineWarning,
            stacklevel=2,
        )
    if greatest > _USUAL:
        warnings.warn(
            f"exact: |s| reaches {greatest:.3g}, far from the values given on the skeleton (-1 and 1); use "
            "interpolation: normalised",
            PipelineWarning,
            stacklevel=2,
        )
