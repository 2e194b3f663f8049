"""The normalised field of the design notes in plain numpy, by other means than the kernels', and meshes to try it on.

Faces are spelled out by corner, edges are the pairs of corners that lie on two faces of a cell, the distance to a
segment comes by cases from a cross product, and every segment meets every point.
"""

from __future__ import annotations

from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np

from geometry.fields.oracle import HEXAHEDRON, Floats, Ints, Mesh

FACES = {
    "tetrahedron": ["012", "013", "023", "123"],
    "pyramid": ["0123", "014", "124", "234", "304"],
    "wedge": ["012", "345", "0143", "1254", "2035"],
    "hexahedron": ["0123", "4567", "0154", "1265", "2376", "3047"],
}


class Net(NamedTuple):
    """Segments from `starts` to `ends` (n, 3), struts first, `values` +1 or -1 and `sizes` of the mesh there (n,)."""

    starts: Floats
    ends: Floats
    values: Floats
    sizes: Floats

    @property
    def struts(self) -> int:
        return int((self.values > 0).sum())


def net_of(mesh: Mesh, solid: str = "edges") -> Net:
    """Walk over the cells one by one and collect struts, channels and the edge lengths around each."""
    points = mesh.vertices
    cells = [(kind, cell) for kind in FACES for cell in mesh.cells.get(kind, ())]
    faces = [[frozenset(cell[int(corner)] for corner in face) for face in FACES[kind]] for kind, cell in cells]
    edges = {
        pair
        for (_, cell), of_cell in zip(cells, faces, strict=True)
        for pair in combinations(sorted(int(i) for i in cell), 2)
        if sum(set(pair) <= face for face in of_cell) == 2
    }
    meeting: dict[int, list[float]] = {}
    for pair in edges:
        for end in pair:
            meeting.setdefault(end, []).append(float(np.linalg.norm(points[pair[0]] - points[pair[1]])))
    size = {vertex: np.mean(lengths) for vertex, lengths in meeting.items()}
    struts = sorted(edges) if solid == "edges" else [(i, i) for i in range(len(points))]
    rows = [(points[a], points[b], 1.0, (size[a] + size[b]) / 2) for a, b in struts]
    for (_, cell), of_cell in zip(cells, faces, strict=True):
        centre, around = points[cell].mean(axis=0), np.mean([size[int(i)] for i in cell])
        rows += [(centre, points[list(face)].mean(axis=0), -1.0, around) for face in of_cell]
    return Net(*(np.array(column) for column in zip(*rows, strict=True)))


def distances(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """Distances of points (m, 3) from segments (n, 3), (m, n): to the line where the foot lies between the ends."""
    along = ends - starts
    from_start, from_end = points[:, None] - starts, points[:, None] - ends
    to_ends = np.minimum(np.linalg.norm(from_start, axis=2), np.linalg.norm(from_end, axis=2))
    lengths = np.linalg.norm(along, axis=1)
    to_line = np.linalg.norm(np.cross(from_start, along), axis=2) / np.where(lengths > 0, lengths, 1)
    is_between = ((from_start * along).sum(axis=2) > 0) & ((from_end * along).sum(axis=2) < 0)
    return np.where(is_between, to_line, to_ends)


def weights(net: Net, points: Floats, c: float, exponent: int, support: float) -> Floats:
    """Return every k_i(d_i) at every point, (m, n)."""
    r = distances(points, net.starts, net.ends)
    taper = np.where(r < support * net.sizes, (1 - (r / (support * net.sizes)) ** 2) ** 2, 0)
    return taper / np.hypot(r, c * net.sizes) ** exponent


def shepard(net: Net, points: Floats, c: float, exponent: int, support: float) -> Floats:
    """Return s at `points` (m, 3), (m,)."""
    values = np.full(len(points), -1.0)
    for first in range(0, len(points), 2000):
        k = weights(net, points[first : first + 2000], c, exponent, support)
        total = k.sum(axis=1)
        is_reached = total > 0
        values[first : first + 2000][is_reached] = (k @ net.values)[is_reached] / total[is_reached]
    return values


def extremes(net: Net, c: float, exponent: int, support: float, samples: int) -> tuple[Floats, Floats]:
    """Return the greatest s found on each channel and the least on each strut, at evenly spaced samples."""
    shares = np.linspace(0, 1, samples)[:, None, None]
    points = ((1 - shares) * net.starts + shares * net.ends).reshape(-1, 3)
    values = shepard(net, points, c, exponent, support).reshape(samples, -1)
    return values[:, net.struts :].max(axis=0), values[:, : net.struts].min(axis=0)


def tetrahedra(counts: tuple[int, int, int], edge: float = 1.0) -> Mesh:
    """Fill a box with cubes of six tetrahedra each, after Kuhn."""
    paths = [np.cumsum([np.zeros(3), *np.eye(3)[list(order)]], axis=0) for order in permutations(range(3))]
    corners = np.array([path + cell for cell in product(*map(range, counts)) for path in paths])
    lattice, cells = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return oriented(Mesh(edge * lattice, {"tetrahedron": cells.reshape(-1, 4).astype(np.int64)}))


def oriented(mesh: Mesh) -> Mesh:
    """Give every tetrahedron a positive volume."""
    cells: Ints = mesh.cells["tetrahedron"].copy()
    a, b, c, d = np.moveaxis(mesh.vertices[cells], 1, 0)
    is_inverted = np.linalg.det(np.stack([b - a, c - a, d - a], axis=1)) < 0
    cells[is_inverted] = cells[is_inverted][:, [1, 0, 2, 3]]
    return Mesh(mesh.vertices, {"tetrahedron": cells})


def jittered(mesh: Mesh, amount: float = 0.15) -> Mesh:
    steps = np.random.default_rng(5).uniform(-amount, amount, mesh.vertices.shape)
    return Mesh(mesh.vertices + steps, mesh.cells)


def graded() -> Mesh:
    """Seven layers of cells, each 1.5 times as wide as the one before: sizes differ more than tenfold."""
    mesh = tetrahedra((7, 1, 1))
    scale = 1.5 ** mesh.vertices[:, :1]
    return Mesh(np.hstack([2 * scale, scale * (mesh.vertices[:, 1:] - 0.5)]), mesh.cells)


def mixed() -> Mesh:
    """All four kinds: a hexahedron, a pyramid on its top, a wedge at its side and a tetrahedron under the wedge."""
    roof, ridge, tip = (0.4, 0.5, 1.8), [(1.9, 0.1, 0.0), (1.8, 0.0, 1.1)], (1.3, 0.4, -0.7)
    vertices = np.array([*HEXAHEDRON, roof, *ridge, tip])
    cells = {
        "tetrahedron": [(9, 1, 2, 11)],
        "pyramid": [(4, 5, 6, 7, 8)],
        "wedge": [(1, 9, 2, 5, 10, 6)],
        "hexahedron": [tuple(range(8))],
    }
    return Mesh(vertices, {kind: np.array(corners) for kind, corners in cells.items()})
