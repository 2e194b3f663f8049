"""The field of a mesh, sampled on voxels over an outer shape, with its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.fields.sampling import SamplingParams, Voxels, voxels_over
from scaffold_geometry.files.points import read_points
from scaffold_pipeline.artifacts import CellMesh, Certificate, Fact, OuterShape, ScalarField
from scaffold_pipeline.errors import StageError

if TYPE_CHECKING:
    from scaffold_geometry.fields.certificate import FieldAt
    from scaffold_geometry.fields.skeleton import Skeleton

_THROATS, _WAISTS = (0.7, 1.0), (0.35, 0.65)
"""Places at which the thickness is checked: along a channel, from cell to face, and along a strut; shares of length."""


@dataclass(frozen=True, eq=False)
class MeshField:
    """A field as functions: of voxels (float32) and of points (n, 3) mm with values (n,); `at_many` is the faster one.

    `judge` takes the greatest |s| found, and warns if the field is not reliable.
    """

    on_voxels: Callable[[Voxels], NDArray[np.float32]]
    at: FieldAt
    at_many: FieldAt
    facts: dict[str, Fact]
    judge: Callable[[float], None] | None = None


def sample_mesh_field(
    mesh: CellMesh, outer: OuterShape | None, params: SamplingParams, field_of: Callable[[Skeleton], MeshField]
) -> ScalarField:
    """Return the field that `field_of` makes from the mesh's skeleton, on voxels over the outer shape, certified.

    Samples more than two voxels outside the outer shape are void (-1). A planar mesh needs no outer shape; its samples
    are one layer in its plane.

    Parameters
    ----------
    mesh
        The cells; its `fields.skeleton.Skeleton` has the struts along its edges, and the channels from the centre of
        each cell to those of its faces.
    outer
        The shape that the voxels cover.
    params
        Where the field is sampled: the stage's own parameters, whose class has `SamplingParams` as its base.
    field_of
        Makes the field of the skeleton: above the iso-value, as a rule positive, in struts and below it in pores.

    Returns
    -------
    ScalarField
        Values in float32, with the certificate of which channels are open and which struts whole at each iso-value.

    Raises
    ------
    StageError
        Where a mesh of solid cells has no outer shape, or the voxels need more memory than there is or are too coarse.
    """
    from scaffold_geometry.fields.skeleton import skeleton_of, slab_around

    points = np.empty((0, 3)) if params.points is None else read_points(params.points)
    if outer is None and not mesh.IS_PLANAR:
        raise StageError("outer: is required unless the mesh is planar; add a stage that writes `outer`")
    outer = outer or OuterShape(*slab_around(mesh.vertices, mesh.cells))
    voxels = voxels_over(outer, params, plane=float(mesh.vertices[0, 2]) if mesh.IS_PLANAR else None)
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    field = field_of(skeleton)
    values = field.on_voxels(voxels)
    values[~voxels.near] = -1.0
    values.setflags(write=False)  # the artifact does not copy a read-only array
    certificate = _certificate(skeleton, field, voxels.spacing)
    if field.judge:
        on_skeleton = max(np.abs(certificate.channel_maxima).max(), np.abs(certificate.strut_minima).max())
        field.judge(float(max(on_skeleton, np.abs(values[voxels.inside]).max())))
    return ScalarField(values, voxels.origin, voxels.spacing, certificate, field.facts, points, field.at(points))


def _certificate(skeleton: Skeleton, field: MeshField, spacing: float) -> Certificate:
    """Return the extremes of a field along every channel and strut, and on rings around them of up to one voxel."""
    from scaffold_geometry.fields.certificate import Rings, extremes_of

    ends, radii = skeleton.vertices[skeleton.edges], tuple(spacing * share for share in Certificate.RING_SHARES)
    channels, struts = (skeleton.channel_starts, skeleton.channel_ends), (ends[:, 0], ends[:, 1])
    channel_maxima, channel_rings = extremes_of(field.at_many, *channels, Rings(_THROATS, radii), 1, field.at)
    strut_minima, strut_rings = extremes_of(field.at_many, *struts, Rings(_WAISTS, radii), -1, field.at)
    return Certificate(channel_maxima, strut_minima, channel_rings, strut_rings, voxel_size=spacing)
