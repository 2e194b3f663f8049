"""The values that stages hand to each other: meshes, fields, contours, metrics; frozen, checked once, arrays locked."""

from scaffold_pipeline.artifacts.cell_meshes import CellMesh, PlanarMesh, VolumeMesh
from scaffold_pipeline.artifacts.contours import Contour, Polygons
from scaffold_pipeline.artifacts.fields import Certificate, ScalarField
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
    "Artifact",
    "CellMesh",
    "Certificate",
    "Contour",
    "Curve",
    "Fact",
    "Finding",
    "Floats",
    "Histogram",
    "Ints",
    "IsoSurface",
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
