"""Stage `measure_layers`: the porosity of each layer, to check a porosity gradient."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.voxels.image import PORE, STRUT
from scaffold_geometry.voxels.voxelising import voxelise
from scaffold_pipeline.artifacts import Curve, Metric, Metrics, OuterShape, Solid
from scaffold_pipeline.stages.contract import Millimetres, Params, stage

METRICS = (
    Metric("porosity_along_{axis}_least", "", "Least porosity along {axis}", "Of the densest layer.", section="Pores"),
    Metric("porosity_along_{axis}_greatest", "", "Greatest porosity along {axis}", "Of the openest.", section="Pores"),
)
"""What the numbers are called on the page and by `scaffold-pipeline stages`; `{axis}` stands for x, y or z."""


class MeasureLayersParams(Params):
    """Parameters of `measure_layers`."""

    voxel_size: Millimetres = Field(gt=0.0)
    """Edge of the voxels, and thickness of a layer."""

    axis: Literal["x", "y", "z"] = "z"
    """Axis normal to the layers."""


@stage(writes="layers", version=1, metrics=METRICS)
def measure_layers(solid: Solid, outer: OuterShape, *, params: MeasureLayersParams) -> Metrics:
    """Measure the porosity of each layer of voxels along an axis."""
    axis = "xyz".index(params.axis)
    across = tuple(other for other in range(3) if other != axis)
    image = voxelise((solid.vertices, solid.faces), (outer.vertices, outer.faces), params.voxel_size)
    pores, struts = (image.is_phase(phase).sum(axis=across) for phase in (PORE, STRUT))
    layers = np.flatnonzero(pores + struts)
    porosity = pores[layers] / (pores + struts)[layers]
    places = image.origin[axis] + image.spacing * layers
    name = f"porosity_along_{params.axis}"
    return Metrics(
        {f"{name}_least": float(porosity.min()), f"{name}_greatest": float(porosity.max())},
        has_gates=False,  # the verdict is that of `measure`
        curves=(Curve(name, f"Porosity along {params.axis}", f"{params.axis}, mm", "porosity", places, porosity),),
    )
