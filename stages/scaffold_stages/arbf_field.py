"""Stage `arbf_field`: the anisotropic radial-basis-function (ARBF) field of a mesh on voxels, with its certificate.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function". `exact` is their
interpolation, for small meshes; `normalised` is local and bounded, and works on real anatomy.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats
from scaffold_geometry.fields import interpolation
from scaffold_geometry.fields.interpolation import DEFAULT_C, LEAST_C, MOST_C, Basis, Method, interpolate
from scaffold_geometry.fields.mesh_field import MeshField, sample_mesh_field
from scaffold_geometry.fields.sampling import SamplingParams, Voxels
from scaffold_pipeline.artifacts import CellMesh, Fact, Metric, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Unit, stage

if TYPE_CHECKING:
    from scaffold_geometry.fields.shepard import Bins, Segments
    from scaffold_geometry.fields.skeleton import Skeleton

Distance = Literal["endpoint", "endpoint-to-segment", "exact"]

_NORMALISED_C, _PLANAR_C = 0.002, 0.01
_EXPONENT, _SUPPORT = 4, 1.0
"""Chosen on three bones with jitter 0.2; the windows of iso-values, in brackets, are those of a heel bone.

c = 0.05: (-0.19, -0.05), 0.02: (-0.76, 0.68), 0.01: (-0.97, 0.96). At 65 % porosity, 0.02 broke struts of the hip bone
(1 of 23,632), the meniscus and the femur; 0.01 sometimes breaks a strut of the heel bone beside the channel of a flat
cell, as fTetWild is not deterministic. On such a mesh 0.01 gave (-0.84, 0.78) and 0.002 (-0.999, 0.999), while samples
changed by 0.002 on average and the iso-value by 0.004; smaller c has no further effect, and comes closer to the limits
of single precision.
In a plane channels end on struts, whose width there is about c: 0.002 breaks them in the file, 0.01 does not.
p = 2: (-0.46, 0.23), 6: (-0.90, 0.86), but then 65 to 80 % porosity lies between iso-values of 0.85 and 0.99. With c
and R in mean instead of local edge lengths: (-0.49, 0.41). R from 0.6 to 1.6 changes the window by 0.001 and leaves no
sample out of reach; 1.0 takes 0.6 times as long as 1.3 and leaves 6 % more loose fragments at 80 %.
"""

_MOST_HALF_REACHED = 1e-3
"""Share of the samples inside the shape that may be out of reach of struts or channels, with a warning."""

_BOX = 0.5
"""Edge of the boxes that segments are sorted into, in mean edge lengths: 0.5 was the fastest of 0.25 to 1."""


class ArbfFieldParams(SamplingParams):
    """Parameters of `arbf_field`."""

    interpolation: Literal["normalised", "exact"] = "normalised"
    """`normalised`: for real anatomy; `exact`: the published interpolation, for small meshes."""

    solid: Literal["edges", "vertices"] | None = None
    """Where the field is +1: on mesh edges (default of `normalised`) or on vertices only (the paper, default of
    `exact`)."""

    c: Annotated[float | None, Unit("local edge lengths, or mm with exact")] = Field(default=None, gt=0.0)
    """Shape parameter of the kernel (1/mm for the Gaussian); by default 0.002 (planar meshes 0.01), or 0.1 with
    `exact`."""

    exponent: Literal[2, 4, 6, 8] | None = None
    """Exponent p of the kernel (r^2 + c^2)^(-p/2), `normalised` only; by default 4."""

    support: Annotated[float | None, Unit("local edge lengths")] = Field(default=None, gt=0.0, le=10.0)
    """Radius of the kernel, beyond which it is zero, `normalised` only; by default 1.0."""

    basis: Basis | None = None
    """Radial basis function, `exact` only; by default inverse_multiquadric."""

    distance: Distance | None = None
    """Definition of the distance between two segments, `exact` only; by default endpoint-to-segment."""

    @model_validator(mode="after")
    def _only_what_applies(self) -> ArbfFieldParams:
        foreign = ("basis", "distance") if self.interpolation == "normalised" else ("exponent", "support")
        for name in foreign:
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: does not apply to interpolation: {self.interpolation}; leave it out")
        if self.c is not None and self.basis == "thin_plate_spline":
            raise ValueError("c: does not apply to basis: thin_plate_spline; leave it out")
        least, most = (0.0, 1.0) if self.interpolation == "normalised" else (LEAST_C, MOST_C)
        if self.c is not None and not least <= self.c <= most:
            raise ValueError(
                f"c: must be from {least:g} to {most:g} with interpolation: {self.interpolation}, got {self.c:g}"
            )
        return self


METRICS = (
    *interpolation.METRICS,
    Metric("local_support", "mm", "Support", "How far an element reaches, at most.", ""),
)
"""What the field's facts are."""


@stage(writes="field", version=8, metrics=METRICS)
def arbf_field(
    mesh: CellMesh, outer: OuterShape | None = None, *, params: ArbfFieldParams, executor: Executor | None = None
) -> ScalarField:
    """Compute the ARBF field of a mesh on voxels over the outer shape, with a connectivity certificate.

    Samples more than two voxels outside the outer shape are void (-1). A planar mesh needs no outer shape; its samples
    are one layer in its plane. Its channels end on its edges: no iso-value opens all channels and keeps all struts.
    A `normalised` field is computed in slabs by `executor`, if given: no bit of the result depends on it.
    Raises `StageError` if the grid or the exact system needs more memory than is free, or if more than a thousandth of
    the samples inside are out of reach of struts or of channels.
    """
    usual_c = _PLANAR_C if mesh.IS_PLANAR else _NORMALISED_C
    of_normalised = partial(_normalised_field, c=params.c or usual_c, executor=executor)
    field_of = of_normalised if params.interpolation == "normalised" else _exact
    return sample_mesh_field(mesh, outer, params, partial(field_of, params=params))


def _normalised_field(skeleton: Skeleton, params: ArbfFieldParams, c: float, executor: Executor | None) -> MeshField:
    from scaffold_geometry.fields.shepard import segments_of

    support = params.support or _SUPPORT
    segments = segments_of(
        skeleton,
        c=c,
        support=support,
        exponent=params.exponent or _EXPONENT,
        vertices_only=params.solid == "vertices",
    )
    facts: dict[str, Fact] = {
        "elements": len(segments.reaches),
        "local_support": float(np.sqrt(segments.reaches.max()) * segments.unit),
    }
    at = _at_points(segments)
    return MeshField(
        lambda voxels: _on_voxels(segments, voxels, support, executor), at, partial(at, precision=np.float32), facts
    )


def _on_voxels(segments: Segments, voxels: Voxels, support: float, executor: Executor | None) -> NDArray[np.float32]:
    from scaffold_geometry.fields.slabs import compute_in_slabs, compute_slab

    if executor is None:
        values, half_reached = compute_slab(segments, voxels, _BOX)
    else:
        values, half_reached = compute_in_slabs(segments, voxels, _BOX, executor)
    _require_reached(half_reached, int(voxels.inside.sum()), support)
    return values


def _at_points(segments: Segments) -> Callable[..., Floats]:
    """Return the normalised field as a function of points in mm; points out of reach of all segments are void."""
    from scaffold_geometry.fields.shepard import bin_segments, field_at

    starts, ends = segments.starts, segments.starts + segments.steps
    reach = float(np.sqrt(segments.reaches.max()))
    low, high = np.minimum(starts, ends).min(axis=1) - reach, np.maximum(starts, ends).max(axis=1) + reach
    nx, ny, nz = (int(count) for count in np.maximum(np.ceil((high - low) / _BOX), 1.0))

    @cache
    def bins() -> Bins:  # made at the first call, when the lists for the voxels, as large, are freed
        return bin_segments(segments, low, np.full(3, _BOX), (nx, ny, nz))

    def at(points: Floats, precision: type[np.floating[Any]] = np.float64) -> Floats:
        return field_at(segments, bins(), (points - segments.centre) / segments.unit, precision)

    return at


def _require_reached(half_reached: int, inside: int, support: float) -> None:
    """Require that few samples inside are out of reach: fTetWild's mesh may miss the tip of a thin part."""
    if not half_reached:
        return
    message = (
        f"support: {half_reached} of {inside} samples inside the outer shape are out of reach of struts or of "
        f"channels; raise support (now {support:g} local edge lengths), or check that the mesh fills the outer shape"
    )
    if half_reached > _MOST_HALF_REACHED * inside:
        raise StageError(message)
    warn(f"{message}; samples reached by struts only are solid, all others void")


def _exact(skeleton: Skeleton, params: ArbfFieldParams) -> MeshField:
    from scaffold_geometry.fields import interpolant

    elements, targets = interpolant.elements_of(skeleton), interpolant.values_of(skeleton)
    if params.solid == "edges":
        elements, targets = interpolant.add_edges(skeleton, elements, targets)
    method = Method(
        name="exact",
        remedy="interpolation: normalised",
        basis=params.basis or "inverse_multiquadric",
        c=DEFAULT_C if params.c is None else params.c,
        distance_definition=params.distance or "endpoint-to-segment",
    )
    return interpolate(elements, targets, method)
