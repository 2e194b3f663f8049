"""Stage `rbf_field`: the isotropic radial-basis-function field of a mesh, from points only, with its certificate.

Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function", compare their
field with it: +1 on vertices, -1 on face centres and cell centres, and no channels, so that pores are connected only by
chance.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, model_validator

from scaffold_geometry.fields import interpolation
from scaffold_geometry.fields.interpolation import DEFAULT_C, LEAST_C, MOST_C, Basis, Method, interpolate
from scaffold_geometry.fields.mesh_field import MeshField, sample_mesh_field
from scaffold_geometry.fields.sampling import SamplingParams
from scaffold_pipeline.artifacts import CellMesh, OuterShape, ScalarField
from scaffold_pipeline.stages.contract import Unit, stage

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton


class RbfFieldParams(SamplingParams):
    """Parameters of `rbf_field`."""

    basis: Basis = "inverse_multiquadric"
    """Radial basis function."""

    c: Annotated[float | None, Unit("mm")] = Field(default=None, ge=LEAST_C, le=MOST_C)
    """Shape parameter of the basis function (1/mm for the Gaussian); by default 0.1."""

    @model_validator(mode="after")
    def _only_what_applies(self) -> RbfFieldParams:
        if self.c is not None and self.basis == "thin_plate_spline":
            raise ValueError("c: does not apply to basis: thin_plate_spline; leave it out")
        return self


@stage(writes="field", version=2, metrics=interpolation.METRICS)
def rbf_field(mesh: CellMesh, outer: OuterShape | None = None, *, params: RbfFieldParams) -> ScalarField:
    """Compute the isotropic RBF field of a mesh from points only, with a connectivity certificate, for comparison.

    Samples more than two voxels outside the outer shape are void (-1). A planar mesh needs no outer shape; its samples
    are one layer in its plane. Raises `StageError` if the grid or the system needs more memory than is free.
    """
    return sample_mesh_field(mesh, outer, params, partial(_on_points, params=params))


def _on_points(skeleton: Skeleton, params: RbfFieldParams) -> MeshField:
    from scaffold_geometry.fields.interpolant import points_of, values_of

    elements = points_of(skeleton)
    method = Method("rbf", "arbf_field", params.basis, DEFAULT_C if params.c is None else params.c)
    return interpolate(elements, values_of(skeleton)[: elements.unknowns], method)
