"""A field with prescribed values on points and segments: a dense linear system, and checks of its solution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats
from scaffold_geometry.fields.mesh_field import MeshField
from scaffold_geometry.fields.sampling import Voxels
from scaffold_pipeline.artifacts import Fact, Metric
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.memory import available_memory

if TYPE_CHECKING:
    from scaffold_geometry.fields.interpolant import Elements, Solution

Basis = Literal["gaussian", "multiquadric", "inverse_multiquadric", "thin_plate_spline"]

DEFAULT_C = 0.1
"""The value in the paper."""

LEAST_C, MOST_C = 1e-9, 1e6
"""Outside of this range digits are lost."""

MOST_UNKNOWNS = 8000
"""Above this number the published form gives no usable field on any mesh, and the solver takes many minutes."""

_USUAL = 2.0
"""Greatest |s| of a usable exact field: small meshes of the paper reach 1.8."""


@dataclass(frozen=True)
class Method:
    """The method of interpolation: the basis and its c, and the definition of the distance between two segments.

    `name` is its name in messages, `remedy` the alternative if it fails.
    """

    name: str
    remedy: str
    basis: Basis
    c: float
    distance_definition: str = "endpoint-to-segment"


def interpolate(elements: Elements, targets: Floats, method: Method) -> MeshField:
    """Return the field with the values `targets` (n,) on the elements; raises `StageError` if n is too large.

    If no such field exists, the least-squares field of least norm is returned, and its `judge` warns.
    """
    from scaffold_geometry.fields import interpolant

    _require_memory(elements.unknowns, method)
    matrix = interpolant.assemble(elements, method.basis, method.distance_definition, method.c)
    expected = interpolant.expected_negative_eigenvalues(method.basis, len(elements.points), len(elements.starts))
    solution = interpolant.solve(matrix, targets, expected)

    def at(points: Floats) -> Floats:
        x, y, z = np.ascontiguousarray(points.T)
        return interpolant.evaluate(x, y, z, elements, solution.weights, method.basis, method.c)

    def on_voxels(voxels: Voxels) -> NDArray[np.float32]:
        values = np.full(voxels.inside.shape, -1.0, np.float32)
        summed = elements, solution.weights, method.basis, method.c
        interpolant.evaluate_on_grid(voxels.axes, voxels.near, *summed, values)
        return values

    return MeshField(on_voxels, at, at, _facts(solution), partial(_warn_of_health, method, solution))


METRICS = (
    Metric("unknowns", "", "Unknowns", "Of the system that the interpolant solves.", ""),
    Metric("rank", "", "Rank", "Of the system's matrix; less than the unknowns where elements coincide.", ""),
    Metric("negative_eigenvalues", "", "Negative eigenvalues", "Of the system's matrix.", ""),
    Metric("expected_negative_eigenvalues", "", "Negative eigenvalues expected", "Of a healthy system's.", ""),
    Metric("condition", "", "Condition number", "Of the system's matrix.", ""),
    Metric("residual", "", "Residual", "Greatest error on the elements.", ""),
)
"""What `interpolate` tells of its system."""


def _facts(solution: Solution) -> dict[str, Fact]:
    return {
        "elements": solution.unknowns,
        "unknowns": solution.unknowns,
        "rank": solution.rank,
        "negative_eigenvalues": solution.negative_eigenvalues,
        "expected_negative_eigenvalues": solution.expected_negative_eigenvalues,
        "condition": solution.condition,
        "residual": solution.residual,
    }


def _require_memory(unknowns: int, method: Method) -> None:
    from scaffold_geometry.fields.interpolant import estimate_memory

    needed, free = estimate_memory(unknowns), available_memory()
    if needed > free or unknowns > MOST_UNKNOWNS:
        raise StageError(
            f"{method.name} has {unknowns} unknowns here, which need {needed / 2**30:.1f} GiB "
            f"({free / 2**30:.1f} GiB are free) and must be at most {MOST_UNKNOWNS}; use {method.remedy}, "
            "or a coarser mesh"
        )


def _warn_of_health(method: Method, solution: Solution, greatest: float) -> None:
    """Warn if the interpolant is not usable; `greatest` is the greatest |s|.

    A check of the residual finds none of these cases. The inertia and the skeleton alone miss regular blocks of 4^3 and
    5^3 cubes, where the exact s reaches 3.8 and 13 between the channels.
    """
    if not solution.is_full_rank:
        is_met = not round(solution.residual, 6)  # rounding leaves 1e-12, a missing interpolant about 0.1
        what = "several interpolants exist, as elements coincide" if is_met else "no interpolant exists"
        warn(
            f"{method.name}: {what} (rank {solution.rank} of {solution.unknowns}); this is the least-squares "
            f"field of least norm, off by up to {solution.residual:.2g} on the elements"
        )
    if not solution.has_expected_inertia:
        warn(
            f"{method.name}: the system has {solution.negative_eigenvalues} negative eigenvalues, a regular one has "
            f"{solution.expected_negative_eigenvalues}; the field is not reliable: use {method.remedy}"
        )
    if greatest > _USUAL:
        warn(
            f"{method.name}: |s| reaches {greatest:.3g}, far from the values given on the skeleton (-1 and 1); use "
            f"{method.remedy}"
        )
