"""Stage `distance_field`: a field from the distances to the struts of a mesh and to the channels between its cells."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from scaffold_geometry.arrays import Floats, Singles
from scaffold_geometry.fields.mesh_field import MeshField, sample_mesh_field
from scaffold_geometry.fields.sampling import SamplingParams, Voxels
from scaffold_pipeline.artifacts import CellMesh, OuterShape, ScalarField
from scaffold_pipeline.stages.contract import stage

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton

TINY = 1e-12
"""Smallest sum of distances, mm: avoids 0/0 where a channel of a planar mesh ends on a strut."""


class DistanceFieldParams(SamplingParams):
    """Parameters of `distance_field`."""

    samples: int = Field(default=33, ge=2)
    """Points on each strut and channel to which distances are measured."""


@stage(writes="field", version=1)
def distance_field(mesh: CellMesh, outer: OuterShape | None = None, *, params: DistanceFieldParams) -> ScalarField:
    """Compute (c - s) / (c + s), s and c the distances to the nearest strut and channel: 1 on struts, -1 on channels.

    At an iso-value of 0 the surface is midway between struts and channels.
    """
    return sample_mesh_field(mesh, outer, params, partial(field_of, samples=params.samples))


def field_of(skeleton: Skeleton, samples: int) -> MeshField:
    """Return the functions that compute the field of a skeleton."""
    from scipy.spatial import cKDTree

    ends = skeleton.vertices[skeleton.edges]
    struts = cKDTree(points_along(ends[:, 0], ends[:, 1], samples))
    channels = cKDTree(points_along(skeleton.channel_starts, skeleton.channel_ends, samples))

    def at(points: Floats) -> Floats:
        to_strut, to_channel = struts.query(points)[0], channels.query(points)[0]
        return np.asarray((to_channel - to_strut) / np.maximum(to_channel + to_strut, TINY))

    def on_voxels(voxels: Voxels) -> Singles:
        values = np.full(voxels.near.shape, -1.0, np.float32)
        values[voxels.near] = at(voxels.origin + voxels.spacing * np.argwhere(voxels.near))
        return values

    return MeshField(on_voxels, at, at, {"segments": len(skeleton.edges) + len(skeleton.channel_starts)})


def points_along(starts: Floats, ends: Floats, samples: int) -> Floats:
    """Return evenly spaced points on segments from `starts` to `ends` (n, 3), (n * samples, 3)."""
    shares = np.linspace(0.0, 1.0, samples)[:, None]
    return (starts[:, None] + shares * (ends - starts)[:, None]).reshape(-1, 3)
