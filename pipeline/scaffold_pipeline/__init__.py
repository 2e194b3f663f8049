"""From an anatomical surface to a printable porous scaffold: `run` a config, or call each of the `stages`.

Lengths are mm, areas mm^2, volumes mm^3, shares are from 0 to 1. Every failure is a `PipelineError` with one line for
each fault.

Examples
--------
>>> import scaffold_pipeline as sp
>>> mesh = sp.stages.make_mesh(shape="block", cell="tetrahedron", counts=2, edge=3.0)
>>> outer = sp.stages.extract_outer(mesh)
>>> moved = sp.stages.jitter(mesh, amount=0.2, seed=7)
>>> moved.vertices.shape, round(outer.volume)
((27, 3), 216)
"""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # type checkers take it for typing's own, whose import would take longer than all else here

if TYPE_CHECKING:
    from typing import Any

    from scaffold_pipeline import stages
    from scaffold_pipeline.api.run import Run, open_run, run
    from scaffold_pipeline.api.study import StudyRun, study
    from scaffold_pipeline.artifacts import (
        Artifact,
        Certificate,
        Contour,
        IsoSurface,
        Metrics,
        OuterShape,
        PlanarMesh,
        ScalarField,
        Solid,
        SurfaceMesh,
        VolumeMesh,
    )
    from scaffold_pipeline.errors import ConfigError, PipelineError, PipelineWarning, StageError

__version__ = "0.1.0"

__all__ = [
    "Artifact",
    "Certificate",
    "ConfigError",
    "Contour",
    "IsoSurface",
    "Metrics",
    "OuterShape",
    "PipelineError",
    "PipelineWarning",
    "PlanarMesh",
    "Run",
    "ScalarField",
    "Solid",
    "StageError",
    "StudyRun",
    "SurfaceMesh",
    "VolumeMesh",
    "open_run",
    "run",
    "stages",
    "study",
]

_HOMES = {
    **dict.fromkeys(("Run", "open_run", "run"), "api.run"),
    **dict.fromkeys(("StudyRun", "study"), "api.study"),
    **dict.fromkeys(("ConfigError", "PipelineError", "PipelineWarning", "StageError"), "errors"),
}
"""Modules of the public names, loaded at the first use of a name; all other names are artifacts."""


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the name stands for
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "stages":
        return import_module(f"{__name__}.stages")
    value = getattr(import_module(f"{__name__}.{_HOMES.get(name, 'artifacts')}"), name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", "artifacts", "errors", "testing"})
