"""Stage `arbf_field`: the anisotropic radial-basis-function field of a volume mesh on voxels, with its certificate.

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
from scaffold_geometry.fields.interpolation import DEFAULT_C, LEAST_C, MOST_C, Basis, Method, interpolate
from scaffold_geometry.fields.mesh_field import MeshField, sample_mesh_field
from scaffold_geometry.fields.sampling import SamplingParams, Voxels
from scaffold_pipeline.artifacts import CellMesh, Fact, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.stages.contract import Unit, stage

if TYPE_CHECKING:
    from scaffold_geometry.fields.shepard import Bins, Segments
    from scaffold_geometry.fields.skeleton import Skeleton

Distance = Literal["endpoint", "endpoint-to-segment", "exact"]

_NORMALISED_C, _PLANAR_C = 0.002, 0.01
_EXPONENT, _SUPPORT = 4, 1.0
"""Chosen on three bones with jitter 0.2; windows are those of a heel bone.

c = 0.05: (-0.19, -0.05), 0.02: (-0.76, 0.68), 0.01: (-0.97, 0.96). With 0.02 a strut of the hip bone (1 of 23,632), the
meniscus and the femur left the window at 65 % porosity; with 0.01 a strut of the heel bone does now and then, as
fTetWild gives another mesh each time: one beside the channel of a flat cell. On a mesh that came near to it 0.01 gave
(-0.84, 0.78) and 0.002 (-0.999, 0.999), while samples moved by 0.002 in the mean and the iso by 0.004; smaller ones
move nothing more, and leave single precision less room.
In a plane channels end on struts, which are as wide there as c is long: 0.002 parts them in the file, 0.01 does not.
p = 2: (-0.46, 0.23), 6: (-0.90, 0.86), but it crowds 65 to 80 % porosity into iso-values of 0.85 to 0.99. With c and R
of the mean edge, not the local: (-0.49, 0.41). R of 0.6 to 1.6 moves the window by 0.001 and leaves no sample half
reached; 1.0 takes 0.6 of the time of 1.3 and leaves 6 % more crumbs at 80 %.
"""

_MOST_HALF_REACHED = 1e-3
"""Share of the samples inside the outer shape that may lack struts or channels in reach, with a warning."""

_BOX = 0.5
"""Edge of the boxes that segments are sorted into, mean edge lengths: 0.5 was fastest of 0.25 to 1."""


class ArbfFieldParams(SamplingParams):
    """Parameters of `arbf_field`."""

    interpolation: Literal["normalised", "exact"] = "normalised"
    """`normalised` for real anatomy; `exact` for the published form on small meshes."""

    solid: Literal["edges", "vertices"] | None = None
    """What is +1: mesh edges (default of `normalised`) or vertices alone (the paper, default of `exact`)."""

    c: Annotated[float | None, Unit("local edge lengths, or mm with exact")] = Field(default=None, gt=0.0)
    """Shape parameter of the kernel (1/mm for the Gaussian); 0.002 (in a plane 0.01), or 0.1 with `exact`."""

    exponent: Literal[2, 4, 6, 8] | None = None
    """p of the kernel (r^2 + c^2)^(-p/2), `normalised` only; 4."""

    support: Annotated[float | None, Unit("local edge lengths")] = Field(default=None, gt=0.0, le=10.0)
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
        least, most = (0.0, 1.0) if self.interpolation == "normalised" else (LEAST_C, MOST_C)
        if self.c is not None and not least <= self.c <= most:
            raise ValueError(
                f"c: must be {least:g} to {most:g} with interpolation: {self.interpolation}, got {self.c:g}"
            )
        return self


@stage(writes="field", version=8, libraries=("llvmlite", "numba", "scipy"))
def arbf_field(
    mesh: CellMesh, outer: OuterShape | None = None, *, params: ArbfFieldParams, executor: Executor | None = None
) -> ScalarField:
    """Compute the ARBF field of a mesh on voxels over the outer shape, and certify its connectivity.

    Samples more than two voxels outside the outer shape are void (-1). A planar mesh can do without one; its samples
    are one layer in its plane. Its channels end on its edges: no iso has all channels open and all struts whole.
    A large `normalised` field is computed in slabs by `executor`, if there is one: no bit of it depends on that.
    Raises `StageError` where the grid or the exact system needs more memory than there is, or struts and channels do
    not both reach all but a thousandth of the samples inside.
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
    from scaffold_geometry.fields.slabs import compute_slab, in_slabs

    if executor is None:
        values, half_reached = compute_slab(segments, voxels, _BOX)
    else:
        values, half_reached = in_slabs(segments, voxels, _BOX, executor)
    _require_reached(half_reached, int(voxels.inside.sum()), support)
    return values


def _at_points(segments: Segments) -> Callable[..., Floats]:
    """Return the normalised field as a function of points in mm; what no segment can reach is void."""
    from scaffold_geometry.fields.shepard import bin_segments, field_at

    starts, ends = segments.starts, segments.starts + segments.steps
    reach = float(np.sqrt(segments.reaches.max()))
    low, high = np.minimum(starts, ends).min(axis=1) - reach, np.maximum(starts, ends).max(axis=1) + reach
    nx, ny, nz = (int(count) for count in np.maximum(np.ceil((high - low) / _BOX), 1.0))

    @cache
    def bins() -> Bins:  # made at the first call: the voxels' own lists need as much memory, and are gone by then
        return bin_segments(segments, low, np.full(3, _BOX), (nx, ny, nz))

    def at(points: Floats, precision: type[np.floating[Any]] = np.float64) -> Floats:
        return field_at(segments, bins(), (points - segments.centre) / segments.unit, precision)

    return at


def _require_reached(half_reached: int, inside: int, support: float) -> None:
    """Require that few samples inside lack one of the kinds: fTetWild's mesh may miss the very tip of a thin part."""
    if not half_reached:
        return
    told = (
        f"support: {half_reached} of {inside} samples inside the outer shape are reached by struts or by channels "
        f"alone; raise support (now {support:g} local edge lengths), or check that the mesh fills the outer shape"
    )
    if half_reached > _MOST_HALF_REACHED * inside:
        raise StageError(told)
    warn(f"{told}; they are solid or void, as what reaches them")


def _exact(skeleton: Skeleton, params: ArbfFieldParams) -> MeshField:
    from scaffold_geometry.fields import interpolant

    elements, targets = interpolant.elements_of(skeleton), interpolant.values_of(skeleton)
    if params.solid == "edges":
        elements, targets = interpolant.with_edges(skeleton, elements, targets)
    method = Method(
        name="exact",
        remedy="interpolation: normalised",
        basis=params.basis or "inverse_multiquadric",
        c=DEFAULT_C if params.c is None else params.c,
        distance_definition=params.distance or "endpoint-to-segment",
    )
    return interpolate(elements, targets, method)
