"""Stage `measure_field`: count pieces, open channels and whole struts of a field at an iso-value, on its voxels.

For comparing fields that may give no solid: `measure` checks files, this stage never fails for a bad field.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Bools
from scaffold_geometry.measures.declarations import COMPUTED, PORES, POROSITY
from scaffold_geometry.surfaces import shells
from scaffold_geometry.voxels.grids import samples_inside
from scaffold_pipeline.artifacts import (
    CERTIFICATE_METRICS,
    UNDER_RESOLVED,
    Certificate,
    Fact,
    Metric,
    Metrics,
    OuterShape,
    ScalarField,
)
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import Params, Share, Unit, stage

METRICS = (
    *POROSITY,
    *CERTIFICATE_METRICS,
    *PORES,
    *shells.METRICS,
    Metric("channels_open_fraction", "", "Channels open", "Share of all channels, by the certificate.", "Connectivity"),
    Metric("struts_whole_fraction", "", "Struts whole", "Share of all struts, by the certificate.", "Struts"),
    Metric("least_value", "", "Least field value", "Of the samples inside the outer shape.", ""),
    Metric("greatest_value", "", "Greatest field value", "Of the samples inside the outer shape.", ""),
    UNDER_RESOLVED,
    *COMPUTED,
)
"""The metrics of `measure_field`, except those of the stage that makes the field."""


class MeasureFieldParams(Params):
    """Parameters of `measure_field`."""

    iso: Annotated[float | None, Unit("field value")] = None
    """Solid is where the field is above it."""

    porosity: Share | None = Field(default=None, gt=0.0, lt=1.0)
    """Share of the samples inside the outer shape that are void, instead of an iso-value."""

    @model_validator(mode="after")
    def _one_aim(self) -> MeasureFieldParams:
        if (self.iso is None) == (self.porosity is None):
            raise ValueError("give either iso or porosity")
        return self


@stage(writes="metrics", version=3, metrics=METRICS)
def measure_field(field: ScalarField, outer: OuterShape, *, params: MeasureFieldParams) -> Metrics:
    """Count solid and void pieces, open channels and whole struts of a field at an iso-value, on its voxels.

    Pieces are connected over the faces of voxels, within the outer shape. A field without solid or without pores has
    zero pieces of it, which is a result, not an error. No quality gate is applied.
    """
    inside = samples_inside(outer.vertices, outer.faces, field.origin, field.spacing, field.values.shape)
    if not inside.any():
        raise StageError("outer: no sample of the field lies inside it; compute the field over this outer shape")
    samples = field.values[inside]
    iso = _iso_at(samples, params.porosity) if params.iso is None else params.iso
    solid = inside & (field.values > iso)
    values: dict[str, Fact] = {
        "iso": iso,
        "porosity_requested": params.porosity,
        "porosity": 1.0 - float(solid.sum()) / len(samples),
        "least_value": float(samples.min()),
        "greatest_value": float(samples.max()),
        **_pieces("solid", solid),
        **_pieces("pore", inside & ~solid),
        **(_skeleton_facts(field.certificate, iso) if field.certificate else {}),
        **field.facts,
        "voxels": int(field.values.size),
        "voxel_size": field.spacing,
    }
    return Metrics(values, has_gates=False)


def _iso_at(samples: NDArray[np.float32], porosity: float | None) -> float:
    """Return the iso-value below which this share of the samples lies."""
    return float(np.quantile(samples, porosity or 0.0))


def _pieces(name: str, voxels: Bools) -> dict[str, Fact]:
    """Return the number of connected pieces of `voxels` and the share of the largest, None where there is none."""
    from scipy.ndimage import label

    labels, count = label(voxels)
    sizes = np.bincount(labels.ravel())[1:]
    return {
        f"{name}_pieces": int(count),
        f"{name}_largest_fraction": float(sizes.max() / sizes.sum()) if count else None,
    }


def _skeleton_facts(certificate: Certificate, iso: float) -> dict[str, Fact]:
    """Return the certificate's counts at `iso`, and the shares of channels open and struts whole."""
    return {
        **certificate.at(iso),
        "channels_open_fraction": float((certificate.channel_maxima < iso).mean()),
        "struts_whole_fraction": float((certificate.strut_minima > iso).mean()),
    }
