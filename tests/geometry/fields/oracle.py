"""The exact field of the design notes in plain numpy, by other means than the kernels', and small meshes to try it on.

Every element is a segment here, a point one of no length; distances come by broadcasting and, between segments, by
a search instead of a formula; the system is solved by `numpy.linalg.lstsq`.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import shapes
from scaffold_stages.make_mesh import MakeMeshParams, make_mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# VTK's order of a hexahedron's corners.
HEXAHEDRON = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], dtype=float
)


class Mesh(NamedTuple):
    """`vertices` (n, 3) and `cells`, kind -> (m, corners)."""

    vertices: Floats
    cells: dict[str, Ints]


def hexahedra(counts: tuple[int, int, int], edge: float, origin: tuple[float, float, float]) -> Mesh:
    """Fill a box with equal cubes."""
    mesh = shapes.hexahedra(counts, edge)
    return Mesh(origin + mesh.vertices, mesh.cells)


def made(**given: object) -> Mesh:
    mesh = make_mesh(params=MakeMeshParams.model_validate(given))
    return Mesh(mesh.vertices, mesh.cells)


def one_hexahedron() -> Mesh:
    return made(shape="hexahedron")


def eight_hexahedra() -> Mesh:
    return made(shape="cube")


def four_hexahedra_in_a_row() -> Mesh:
    return made(shape="rod")


def icosahedron() -> Mesh:
    """20 tetrahedra about the centre of an icosahedron of circumradius 1."""
    return made(shape="icosahedron")


def one_tetrahedron() -> Mesh:
    """A regular tetrahedron."""
    return made(shape="tetrahedron")


REFERENCE_MESHES = {
    "one_hexahedron": one_hexahedron,
    "eight_hexahedra": eight_hexahedra,
    "four_hexahedra_in_a_row": four_hexahedra_in_a_row,
    "icosahedron": icosahedron,
}


class Elements(NamedTuple):
    """Segments from `starts` to `ends` (n, 3), the points among them of no length, the last ones the channels."""

    starts: Floats
    ends: Floats
    values: Floats
    channels: int


def faces_of(cell: Ints) -> list[tuple[int, ...]]:
    """A tetrahedron's faces are its triples of corners, a hexahedron's the corners with one coordinate alike."""
    if len(cell) == 4:
        return list(combinations(cell, 3))
    return [tuple(cell[HEXAHEDRON[:, axis] == side]) for axis in range(3) for side in (0, 1)]


def elements_of(mesh: Mesh) -> Elements:
    centres: dict[frozenset[int], Floats] = {}
    cell_centres, channels = [], []
    for cell in (cell for of_kind in mesh.cells.values() for cell in of_kind):
        cell_centres.append(mesh.vertices[cell].mean(axis=0))
        for face in faces_of(cell):
            centre = centres.setdefault(frozenset(face), mesh.vertices[list(face)].mean(axis=0))
            channels.append((cell_centres[-1], centre))
    points = np.vstack([mesh.vertices, list(centres.values()), cell_centres])
    starts, ends = (np.vstack([points, [channel[end] for channel in channels]]) for end in (0, 1))
    values = np.where(np.arange(len(starts)) < len(mesh.vertices), 1.0, -1.0)
    return Elements(starts, ends, values, len(channels))


def to_segment(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """Squared distances of points from segments, all (..., 3) that broadcast."""
    along = ends - starts
    lengths2 = (along**2).sum(axis=-1)
    t = np.einsum("...i,...i", points - starts, along) / np.where(lengths2 == 0, 1, lengths2)
    return ((points - starts - np.clip(t, 0, 1)[..., None] * along) ** 2).sum(axis=-1)


def between(elements: Elements, reading: str) -> Floats:
    """Squared distances of all elements from all, (n, n); the reading matters only where both are segments."""
    a, b = elements.starts[:, None], elements.ends[:, None]
    c, d = elements.starts[None], elements.ends[None]
    by_end = [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)]
    if reading == "endpoint":
        answer = np.min([((p - q) ** 2).sum(axis=-1) for p in (a, b) for q in (c, d)], axis=0)
    elif reading == "endpoint-to-segment":
        answer = np.min(by_end, axis=0)
    else:
        answer = searched(a, b, c, d)
    is_segment = np.arange(len(elements.starts)) >= len(elements.starts) - elements.channels
    return np.where(is_segment[:, None] & is_segment, answer, np.min(by_end, axis=0))


def searched(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """Squared distances of segments ab and cd by a ternary search along ab: the distance from cd is convex there."""
    shape = np.broadcast_shapes(a.shape, c.shape)[:-1]
    low, high = np.zeros(shape), np.ones(shape)
    for _ in range(90):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        is_left = to_segment(a + left[..., None] * (b - a), c, d) < to_segment(a + right[..., None] * (b - a), c, d)
        low, high = np.where(is_left, low, left), np.where(is_left, right, high)
    return to_segment(a + low[..., None] * (b - a), c, d)


def phi(basis: str, squared: Floats, c: float) -> Floats:
    r = np.sqrt(squared)
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            "gaussian": lambda: np.exp(-((c * r) ** 2)),
            "multiquadric": lambda: np.hypot(r, c),
            "inverse_multiquadric": lambda: (squared + c**2) ** -0.5,
            "thin_plate_spline": lambda: np.where(r == 0, 0, r**2 * np.log(r)),
        }[basis]()


class Interpolant(NamedTuple):
    """An oracle's answer: `matrix` (n, n), `weights` (n,), `rank`."""

    elements: Elements
    matrix: Floats
    weights: Floats
    rank: int
    basis: str
    c: float

    def at(self, points: Floats) -> Floats:
        """Return s at points (m, 3)."""
        squared = to_segment(points[:, None], self.elements.starts, self.elements.ends)
        return phi(self.basis, squared, self.c) @ self.weights


def interpolant_of(mesh: Mesh, basis: str, reading: str, c: float) -> Interpolant:
    elements = elements_of(mesh)
    matrix = phi(basis, between(elements, reading), c)
    cutoff = len(matrix) * np.finfo(float).eps
    weights, _, rank, _ = np.linalg.lstsq(matrix, elements.values, rcond=cutoff)
    return Interpolant(elements, matrix, weights, int(rank), basis, c)
