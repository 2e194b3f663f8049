"""Stage `arbf_field`: the anisotropic radial-basis-function field of a volume mesh on voxels, with its certificate.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function". `exact` is their
interpolation, for small meshes; `normalised` is local and bounded, and works on real anatomy.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from scaffold_pipeline.artifacts import Certificate, Fact, Floats, Ints, OuterShape, ScalarField, VolumeMesh
from scaffold_pipeline.contract import Millimetres, Params, Unit, stage
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.memory import available_memory
from scaffold_stages._kernels.grids import Bools, grid_over, grown, samples_inside

if TYPE_CHECKING:
    from scaffold_stages._kernels.interpolant import Elements, Solution
    from scaffold_stages._kernels.shepard import Segments
    from scaffold_stages._kernels.skeleton import Skeleton

Basis = Literal["gaussian", "multiquadric", "inverse_multiquadric", "thin_plate_spline"]
Distance = Literal["endpoint", "endpoint-to-segment", "exact"]

MARGIN = 3
"""Samples beyond the outer shape's box: the field is void from two samples outside on, and the clip needs no more."""

_BLOCK, _MOST_ROWS = 0.5, 16
"""Blocks are about half a mean edge wide, so that their lists of segments are short, and at most 16 samples."""

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
"""Edge of the boxes that the certificate sorts segments into, mean edge lengths: 0.5 was fastest of 0.25 to 1."""

_SAMPLES = 33
_USUAL = 2.0


class ArbfFieldParams(Params):
    """Parameters of `arbf_field`."""

    voxel_size: Millimetres = Field(gt=0.0)
    """Distance between samples of the field; a strut or pore should span at least four."""

    interpolation: Literal["normalised", "exact"] = "normalised"
    """`normalised` for real anatomy; `exact` for the published form on small meshes."""

    solid: Literal["edges", "vertices"] | None = None
    """What is +1: mesh edges (default of `normalised`) or vertices alone (the paper, default of `exact`)."""

    c: Annotated[float | None, Unit("local edge lengths, or mm with exact")] = Field(default=None, gt=0.0)
    """Shape parameter of the kernel (1/mm for the Gaussian); 0.01 with `normalised`, 0.1 with `exact`."""

    exponent: Literal[2, 4, 6, 8] | None = None
    """p of the kernel (r^2 + c^2)^(-p/2), `normalised` only; 4."""

    support: Annotated[float | None, Unit("local edge lengths")] = Field(default=None, gt=0.0)
    """Distance at which the kernel has fallen to zero, `normalised` only; 1.0."""

    basis: Basis | None = None
    """Radial basis function, `exact` only; inverse_multiquadric."""

    distance: Distance | None = None
    """Reading of the distance between two segments, `exact` only; endpoint-to-segment."""

    @model_validator(mode="after")
    def _only_what_applies(self) -> ArbfFieldParams:
        foreign = ("basis", "distance") if self.interpolation == "normalised" else ("exponent", "support")
        for name in foreign:
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: has no meaning with interpolation: {self.interpolation}; leave it out")
        if self.c is not None and self.basis == "thin_plate_spline":
            raise ValueError("c: has no meaning with basis: thin_plate_spline; leave it out")
        return self


@stage(writes="field", version=2)
def arbf_field(mesh: VolumeMesh, outer: OuterShape, *, params: ArbfFieldParams) -> ScalarField:
    """Compute the ARBF field of a volume mesh on voxels over the outer shape, and certify its connectivity.

    Samples more than two voxels outside the outer shape are void (-1). Raises `StageError` where the grid or the exact
    system needs more memory than there is, or the support is too small to reach every point.
    """
    from scaffold_stages._kernels.skeleton import skeleton_of

    spacing = params.voxel_size
    _require_memory(outer.bounds, spacing)
    origin, shape = grid_over(outer.bounds, spacing, MARGIN)
    inside = samples_inside(outer.vertices, outer.faces, origin, spacing, shape)
    if not inside.any():
        raise StageError(f"voxel_size {spacing:g} mm: no sample lies inside the outer shape; use a smaller one")
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    compute = _normalised if params.interpolation == "normalised" else _exact
    near = grown(inside, 2)
    values, certificate, facts = compute(skeleton, origin, inside, near, params)
    values[~near] = -1.0
    values.setflags(write=False)  # or the artifact would copy it
    return ScalarField(values, origin, spacing, certificate, facts)


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


_Computed = tuple[np.ndarray, Certificate, dict[str, Fact]]


def _normalised(skeleton: Skeleton, origin: Floats, inside: Bools, near: Bools, params: ArbfFieldParams) -> _Computed:
    from scaffold_stages._kernels import shepard

    segments = _segments(skeleton, params)
    first, step = (origin - segments.centre) / segments.unit, params.voxel_size / segments.unit
    rows = int(np.clip(round(_BLOCK / step), 1, _MOST_ROWS))
    samples = (rows, rows, shepard.LANES)
    blocks = tuple(-(-count // rows) for count, rows in zip(inside.shape, samples, strict=True))
    bins = shepard.bin_segments(segments, first - step / 2.0, step * np.array(samples), blocks)
    active = _active_blocks(near, blocks, samples)
    values = np.full(inside.shape, -1.0, np.float32)
    half_reached = shepard.field_on_blocks(segments, bins, first, step, active, inside, values)
    del bins  # the certificate's own need as much memory
    _require_reached(half_reached, params.support or _SUPPORT)
    certificate = _certificate(segments)
    facts: dict[str, Fact] = {
        "elements": len(segments.reaches),
        "local_support": float(np.sqrt(segments.reaches.max()) * segments.unit),
    }
    return values, certificate, facts


def _segments(skeleton: Skeleton, params: ArbfFieldParams) -> Segments:
    """Return struts and channels in mean edge lengths about the mesh's centre: single precision keeps its digits."""
    from scaffold_stages._kernels.shepard import Segments

    ends = skeleton.vertices[skeleton.edges]
    if params.solid == "vertices":
        ends = np.repeat(skeleton.vertices[:, None], 2, axis=1)
    struts_length = skeleton.local_lengths if params.solid == "vertices" else skeleton.edge_lengths
    unit, centre = skeleton.mean_edge_length, (skeleton.vertices.min(axis=0) + skeleton.vertices.max(axis=0)) / 2.0
    starts = np.concatenate([ends[:, 0], skeleton.channel_starts])
    steps = np.concatenate([ends[:, 1], skeleton.channel_ends]) - starts
    local = np.concatenate([struts_length, skeleton.channel_lengths]) / unit
    return Segments(
        starts=np.ascontiguousarray(((starts - centre) / unit).T),
        steps=np.ascontiguousarray((steps / unit).T),
        shapes=((params.c or _NORMALISED_C) * local) ** 2,
        reaches=((params.support or _SUPPORT) * local) ** 2,
        struts=len(ends),
        power=(params.exponent or _EXPONENT) // 2,
        centre=centre,
        unit=unit,
    )


def _active_blocks(near: Bools, blocks: tuple[int, ...], sizes: tuple[int, int, int]) -> Ints:
    """Return the numbers of the blocks that hold a sample of `near`, (nx, ny, nz), last axis fastest."""
    padded = np.pad(near, [(0, n * size - have) for n, size, have in zip(blocks, sizes, near.shape, strict=True)])
    boxes = padded.reshape(blocks[0], sizes[0], blocks[1], sizes[1], blocks[2], sizes[2])
    return np.flatnonzero(boxes.any(axis=(1, 3, 5)))


def _require_reached(half_reached: int, support: float) -> None:
    if half_reached:
        raise StageError(
            f"support: {half_reached} samples inside the outer shape are reached by struts or by channels alone; raise "
            f"support (now {support:g} local edge lengths), or check that the mesh fills the outer shape"
        )


def _certificate(segments: Segments) -> Certificate:
    """Return the extremes of the normalised field along every channel and every strut."""
    from scaffold_stages._kernels.shepard import bin_segments, extremes_along

    starts, ends = segments.starts.T.copy(), (segments.starts + segments.steps).T.copy()
    low, high = np.minimum(starts, ends).min(axis=0), np.maximum(starts, ends).max(axis=0)
    boxes = np.maximum(np.ceil((high - low) / _BOX), 1.0).astype(int)
    bins = bin_segments(segments, low, np.full(3, _BOX), (int(boxes[0]), int(boxes[1]), int(boxes[2])))
    n = segments.struts
    return Certificate(
        channel_maxima=extremes_along(segments, bins, starts[n:], ends[n:], 1),
        strut_minima=extremes_along(segments, bins, starts[:n], ends[:n], -1),
    )


def _exact(skeleton: Skeleton, origin: Floats, inside: Bools, near: Bools, params: ArbfFieldParams) -> _Computed:
    from scaffold_stages._kernels import interpolant

    basis, c = params.basis or "inverse_multiquadric", _EXACT_C if params.c is None else params.c
    elements, targets = _exact_elements(skeleton, params.solid or "vertices")
    _require_exact_memory(elements.unknowns)
    matrix = interpolant.assemble(elements, basis, params.distance or "endpoint-to-segment", c)
    expected = interpolant.expected_negative_eigenvalues(basis, len(elements.starts))
    solution = interpolant.solve(matrix, targets, expected)

    def field_at(points: Floats) -> Floats:
        columns = np.ascontiguousarray(points.T)
        return interpolant.evaluate(columns[0], columns[1], columns[2], elements, solution.weights, basis, c)

    values = np.full(inside.shape, -1.0, np.float32)
    for layer, is_near, x in zip(values, near, np.arange(len(values)), strict=True):
        places = np.insert(np.argwhere(is_near), 0, x, axis=1)
        layer[is_near] = field_at(origin + params.voxel_size * places)
    certificate = _sampled_certificate(skeleton, field_at)
    on_skeleton = max(np.abs(certificate.channel_maxima).max(), np.abs(certificate.strut_minima).max())
    _warn_of_health(solution, float(max(on_skeleton, np.abs(values[inside]).max())))
    facts: dict[str, Fact] = {
        "elements": elements.unknowns,
        "unknowns": solution.unknowns,
        "rank": solution.rank,
        "negative_eigenvalues": solution.negative_eigenvalues,
        "expected_negative_eigenvalues": solution.expected_negative_eigenvalues,
        "condition": solution.condition,
        "residual": solution.residual,
    }
    return values, certificate, facts


def _exact_elements(skeleton: Skeleton, solid: str) -> tuple[Elements, Floats]:
    """Return the paper's elements and values; with `solid: edges` the mesh edges are segments at +1 too."""
    from scaffold_stages._kernels.interpolant import Elements, elements_of, values_of

    elements, values = elements_of(skeleton), values_of(skeleton)
    if solid == "vertices":
        return elements, values
    ends = skeleton.vertices[skeleton.edges]
    starts = np.concatenate([elements.starts, ends[:, 0]])
    widened = Elements(elements.points, starts, np.concatenate([elements.ends, ends[:, 1]]))
    return widened, np.concatenate([values, np.ones(len(ends))])


def _require_exact_memory(unknowns: int) -> None:
    from scaffold_stages._kernels.interpolant import memory_needed

    needed, there = memory_needed(unknowns), available_memory()
    if needed > there or unknowns > MOST_UNKNOWNS:
        raise StageError(
            f"interpolation: exact has {unknowns} unknowns here, which need {needed / 2**30:.1f} GiB "
            f"({there / 2**30:.1f} GiB are free) and must be at most {MOST_UNKNOWNS}; use interpolation: normalised, "
            "or a coarser mesh"
        )


def _sampled_certificate(skeleton: Skeleton, field_at: Callable[[Floats], Floats]) -> Certificate:
    """Return the extremes of a field over evenly spaced samples of every channel and every strut."""

    def along(starts: Floats, ends: Floats) -> Floats:
        shares = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
        points = starts[:, None] + shares * (ends - starts)[:, None]
        return field_at(points.reshape(-1, 3)).reshape(len(starts), _SAMPLES)

    ends = skeleton.vertices[skeleton.edges]
    return Certificate(
        channel_maxima=along(skeleton.channel_starts, skeleton.channel_ends).max(axis=1),
        strut_minima=along(ends[:, 0], ends[:, 1]).min(axis=1),
    )


def _warn_of_health(solution: Solution, greatest: float) -> None:
    """Warn where the exact interpolant is no field to trust; `greatest` is |s| at most.

    A residual check would catch none of this, and the inertia and the skeleton alone miss 4^3 and 5^3 even cubes,
    between whose channels s reaches 3.8 and 13.
    """
    if not solution.is_full_rank:
        warnings.warn(
            f"exact: no interpolant exists (rank {solution.rank} of {solution.unknowns}); this is the least-squares "
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
