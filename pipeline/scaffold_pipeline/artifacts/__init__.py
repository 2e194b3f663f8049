"""Values passed between stages: meshes, fields, contours, metrics; immutable and checked when they are made."""

from scaffold_pipeline.artifacts.cell_meshes import CellMesh, PlanarMesh, VolumeMesh
from scaffold_pipeline.artifacts.contours import Contour, Polygons
from scaffold_pipeline.artifacts.declarations import Declared, Drawing, Gate, Metric
from scaffold_pipeline.artifacts.fields import CERTIFICATE_METRICS, UNDER_RESOLVED, Certificate, ScalarField
from scaffold_pipeline.artifacts.meshes import (
    Artifact,
    Fact,
    Floats,
    Ints,
    IsoSurface,
    OuterShape,
    Solid,
    SurfaceMesh,
    WrittenFiles,
)
from scaffold_pipeline.artifacts.metrics import Curve, Finding, Histogram, Metrics

__all__ = [
    "CERTIFICATE_METRICS",
    "UNDER_RESOLVED",
    "Artifact",
    "CellMesh",
    "Certificate",
    "Contour",
    "Curve",
    "Declared",
    "Drawing",
    "Fact",
    "Finding",
    "Floats",
    "Gate",
    "Histogram",
    "Ints",
    "IsoSurface",
    "Metric",
    "Metrics",
    "OuterShape",
    "PlanarMesh",
    "Polygons",
    "ScalarField",
    "Solid",
    "SurfaceMesh",
    "VolumeMesh",
    "WrittenFiles",
]
