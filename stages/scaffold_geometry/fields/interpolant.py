"""The anisotropic radial basis interpolant: s(x) = sum_i w_i phi(d(x, element_i)), s = u_i on each element.

Elements are points and, where the field is anisotropic, segments (channels), in this order: vertices, face
centres, cell centres, channels. Liu, Guo, Yu, "Porous Structure Design in Tissue Engineering Using Anisotropic
Radial Basis Function". With segments the matrix A_ij = phi(d_ij) is symmetric but *indefinite*: no Cholesky, no
conjugate gradients. A small residual does not show that the field is usable; the number of negative eigenvalues
does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Bools, Floats
from scaffold_geometry.fields.interpolant_sums import fill_points, fill_rows
from scaffold_geometry.fields.radial_bases import BASES, radial_basis, scale_of, shift_of
from scaffold_geometry.fields.segment_distances import (
    DISTANCE_DEFINITIONS,
    frames_of,
    squared_point_point,
    squared_point_segment,
    squared_segment_segment,
)
from scaffold_geometry.jit import kernel, parallel_kernel, prange, spread

if TYPE_CHECKING:
    from scaffold_geometry.fields.skeleton import Skeleton


_MATRICES_AT_ONCE = 3  # the system, the eigensolver's copy of it and the eigenvectors
_VECTORS_AT_ONCE = 50  # LAPACK's workspace
_MARGIN = 10.0  # LAPACK's estimate of the condition number is rarely too small by more than a factor of three


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements on which a field is prescribed: `points` (p, 3), segments from `starts` to `ends` (h, 3), mm."""

    points: Floats
    starts: Floats
    ends: Floats

    @property
    def unknowns(self) -> int:
        """The number of elements: the points, then the segments."""
        return len(self.points) + len(self.starts)


@dataclass(frozen=True, eq=False)
class Solution:
    """The weights of a system, (n,), and measures of their quality.

    `rank` counts the eigenvalues above n eps max|eigenvalue|, the usual rule (numpy's `matrix_rank`); if it is less
    than `unknowns`, there is no interpolant and the weights are the least-squares solution of least norm.
    `expected_negative_eigenvalues` is None if no rule is known. `condition` is LAPACK's estimate in the
    1-norm. `residual` is max|A w - u|.
    """

    weights: Floats
    unknowns: int
    rank: int
    negative_eigenvalues: int
    expected_negative_eigenvalues: int | None
    condition: float
    residual: float

    @property
    def is_full_rank(self) -> bool:
        """Whether the field has the prescribed values on all elements."""
        return self.rank == self.unknowns

    @property
    def has_expected_inertia(self) -> bool:
        """Whether the number of negative eigenvalues is that of a regular system, if this is known."""
        return self.expected_negative_eigenvalues in {None, self.negative_eigenvalues}


def elements_of(skeleton: Skeleton) -> Elements:
    """Return the elements of the paper: vertices, unique face centres, cell centres, then channels."""
    points = np.concatenate([skeleton.vertices, skeleton.face_centres, skeleton.cell_centres])
    return Elements(points, skeleton.channel_starts, skeleton.channel_ends)


def points_of(skeleton: Skeleton) -> Elements:
    """Return the elements of the isotropic field: those of the paper without the channels."""
    return replace(elements_of(skeleton), starts=np.empty((0, 3)), ends=np.empty((0, 3)))


def values_of(skeleton: Skeleton) -> Floats:
    """Return the values of the paper, (n,), in the order of `elements_of`: +1 on vertices, -1 elsewhere."""
    values = np.full(elements_of(skeleton).unknowns, -1.0)
    values[: len(skeleton.vertices)] = 1.0
    return values


def add_edges(skeleton: Skeleton, elements: Elements, values: Floats) -> tuple[Elements, Floats]:
    """Return the elements and values with the mesh edges appended at +1; not in the paper."""
    struts = skeleton.vertices[skeleton.edges]
    starts, ends = np.concatenate([elements.starts, struts[:, 0]]), np.concatenate([elements.ends, struts[:, 1]])
    return Elements(elements.points, starts, ends), np.concatenate([values, np.ones(len(struts))])


def estimate_memory(unknowns: int) -> int:
    """Return the greatest number of bytes that `assemble` and `solve` need for this number of unknowns."""
    return (_MATRICES_AT_ONCE * unknowns + _VECTORS_AT_ONCE) * unknowns * np.dtype(np.float64).itemsize


def expected_negative_eigenvalues(basis: str, points: int, segments: int) -> int | None:
    """Return the number of negative eigenvalues of a regular system of elements; None if no rule is known.

    Inverse multiquadric: one per segment. Points only, all distinct: the Gaussian and the inverse multiquadric are
    positive definite, the multiquadric has one positive eigenvalue (Micchelli, "Interpolation of scattered data:
    distance matrices and conditionally positive definite functions", Constr. Approx. 2 (1986)).
    """
    if basis == "inverse_multiquadric":
        return segments
    return None if segments else {"gaussian": 0, "multiquadric": points - 1}.get(basis)


def assemble(elements: Elements, basis: str, distance_definition: str, c: float) -> Floats:
    """Return the symmetric matrix A_ij = phi(d_ij), (n, n), n = `elements.unknowns`.

    `basis` is a name of `BASES`, `distance_definition` one of `DISTANCE_DEFINITIONS` and `c` the shape parameter, a
    length in mm (1/mm for the Gaussian).
    """
    matrix = np.empty((elements.unknowns, elements.unknowns))
    _fill(*_coordinates(elements), BASES[basis], DISTANCE_DEFINITIONS[distance_definition], c, matrix)
    return matrix


def evaluate(xs: Floats, ys: Floats, zs: Floats, elements: Elements, weights: Floats, basis: str, c: float) -> Floats:
    """Return s, (n,), at the points with the coordinates `xs`, `ys`, `zs` (n,) each, mm."""
    values = np.empty(len(xs))
    fill_points(np.stack([xs, ys, zs]), *_summands(elements, weights, basis, c), values)
    return values


def evaluate_on_grid(
    axes: tuple[Floats, Floats, Floats], near: Bools,
    elements: Elements, weights: Floats, basis: str, c: float, values: NDArray[np.floating],
) -> None:  # fmt: skip
    """Write s into `values` (nx, ny, nz), single or double precision, where `near` is true; `axes` are x, y, z, mm."""
    xs, ys, zs = (np.array(axis, np.float64) for axis in axes)
    rows = np.flatnonzero(near.any(axis=2))
    fill_rows(spread(rows), xs, ys, zs, near, *_summands(elements, weights, basis, c), values)


def _summands(
    elements: Elements, weights: Floats, basis: str, c: float
) -> tuple[Floats, Floats, Floats, int, float, float]:
    """Return the arguments of the summation kernels: points, frames, scaled weights, basis, shift and c."""
    number = BASES[basis]
    points, frames = np.array(elements.points.T, order="C"), frames_of(elements.starts, elements.ends)
    return points, frames, weights / scale_of(number), number, shift_of(number, c), c


def _coordinates(elements: Elements) -> tuple[Floats, Floats, Floats]:
    """Return points, starts and ends as (3, n) each: contiguous x, y and z can be read as vectors.

    They are copies because numba compiles a kernel once more for a read-only array.
    """
    points, starts, ends = (
        np.array(corners.T, order="C") for corners in (elements.points, elements.starts, elements.ends)
    )
    return points, starts, ends


def solve(matrix: Floats, values: Floats, expected_negative: int | None = None) -> Solution:
    """Solve A w = u for the symmetric `matrix` (n, n) and `values` (n,); by least squares if A is rank deficient.

    L D L^T with symmetric pivoting (Bunch, Kaufman 1977), which has A's inertia (Sylvester), and one step of
    refinement. If the estimated condition number allows a rank deficiency, the eigenvalues are computed, which is
    several times slower.
    """
    from scipy.linalg import lapack

    count = len(values)
    norm = float(np.abs(matrix).sum(axis=0).max())
    workspace, _ = lapack.dsytrf_lwork(count, lower=1)
    factor, pivots, _ = lapack.dsytrf(matrix.T, lower=1, lwork=int(workspace))
    reciprocal, _ = lapack.dsycon(factor, pivots, norm, lower=1)
    condition = 1.0 / reciprocal if reciprocal > 0.0 else math.inf
    if condition * _MARGIN * count * np.finfo(np.float64).eps >= 1.0:
        del factor
        weights, rank, negative = _least_squares(matrix, values)
    else:
        weights, _ = lapack.dsytrs(factor, pivots, values, lower=1)
        correction, _ = lapack.dsytrs(factor, pivots, values - matrix @ weights, lower=1)
        weights, rank, negative = weights + correction, count, _negative_pivots(factor, pivots)
    residual = float(np.abs(matrix @ weights - values).max())
    return Solution(weights, count, rank, negative, expected_negative, condition, residual)


def _negative_pivots(factor: Floats, pivots: NDArray[np.int32]) -> int:
    """Count the negative eigenvalues of D: one for each 2x2 pivot, which LAPACK marks by two negative indices."""
    single = pivots > 0
    return int((np.diag(factor)[single] < 0.0).sum()) + int((~single).sum()) // 2


def _least_squares(matrix: Floats, values: Floats) -> tuple[Floats, int, int]:
    """Return the least-squares weights of least norm, (n,), the rank and the number of negative eigenvalues."""
    from scipy.linalg import eigh

    eigenvalues, vectors = eigh(matrix, check_finite=False)
    tolerance = len(values) * np.finfo(np.float64).eps * np.abs(eigenvalues).max()
    kept = np.abs(eigenvalues) > tolerance
    inverses = np.divide(1.0, eigenvalues, out=np.zeros_like(eigenvalues), where=kept)
    weights = vectors @ (inverses * (vectors.T @ values))
    weights += vectors @ (inverses * (vectors.T @ (values - matrix @ weights)))
    return weights, int(kept.sum()), int((eigenvalues < -tolerance).sum())


@parallel_kernel
def _fill(
    points: Floats, starts: Floats, ends: Floats, basis: int, distance_definition: int, c: float, matrix: Floats
) -> None:
    """Fill `matrix` (n, n): each pair is computed once, so that the matrix is symmetric to the last bit.

    Row i has n - i pairs: rows i and n - 1 - i are computed together, so that threads get equal work.
    """
    count = len(matrix)
    for i in prange((count + 1) // 2):
        _fill_row(i, points, starts, ends, basis, distance_definition, c, matrix)
        if count - 1 - i > i:
            _fill_row(count - 1 - i, points, starts, ends, basis, distance_definition, c, matrix)


@kernel
def _fill_row(
    i: int, points: Floats, starts: Floats, ends: Floats, basis: int, distance_definition: int, c: float, matrix: Floats
) -> None:
    """Fill row i of `matrix` from its diagonal on, and column i; coordinates are (3, p) and (3, h)."""
    (px, py, pz), (ax, ay, az), (bx, by, bz) = points, starts, ends
    for j in range(i, len(matrix)):
        k, m = i - len(px), j - len(px)
        if i == j:
            squared = 0.0
        elif m < 0:
            squared = squared_point_point(px[i], py[i], pz[i], px[j], py[j], pz[j])
        elif k < 0:
            squared = squared_point_segment(px[i], py[i], pz[i], ax[m], ay[m], az[m], bx[m], by[m], bz[m])
        else:
            squared = squared_segment_segment(
                distance_definition,
                ax[k], ay[k], az[k], bx[k], by[k], bz[k],
                ax[m], ay[m], az[m], bx[m], by[m], bz[m],
            )  # fmt: skip
        matrix[i, j] = matrix[j, i] = radial_basis(basis, squared, c)
