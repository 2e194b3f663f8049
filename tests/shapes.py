"""Shapes that the tests make themselves: closed surfaces, regular meshes and fields of known form."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.surfaces import booleans, triangles
from scaffold_geometry.volumes import lattices
from scaffold_pipeline.artifacts import OuterShape, PlanarMesh, ScalarField, VolumeMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Surface = tuple[Floats, Ints]
Point = tuple[float, float, float]

_CUBE = np.array(list(product((0, 1), repeat=3)))
_CUBE_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def box(low: Point, high: Point) -> Surface:
    """Return a box of 12 triangles."""
    corners = np.array([low, high], float)
    return np.take_along_axis(corners, _CUBE, axis=0), _CUBE_FACES.astype(np.int64)


def ball(radius: float, centre: Point = (0.0, 0.0, 0.0), divisions: int = 4) -> Surface:
    """Return an octahedron, its faces quartered `divisions` times and pushed out to a sphere: 8 x 4^n triangles."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)])
    for _ in range(divisions):
        corners = vertices[faces]
        middles = (corners + np.roll(corners, -1, axis=1)) / 2.0
        middles /= np.linalg.norm(middles, axis=2, keepdims=True)
        (a, b, c), (ab, bc, ca) = np.moveaxis(corners, 1, 0), np.moveaxis(middles, 1, 0)
        soup = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        vertices, faces = triangles.merge_coincident(soup, np.arange(len(soup)).reshape(-1, 3))
    return np.asarray(centre) + radius * vertices, faces


def together(*surfaces: Surface) -> Surface:
    """Return several surfaces as one mesh."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    faces = [faces + start for (_, faces), start in zip(surfaces, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in surfaces]), np.concatenate(faces)


def inverted(surface: Surface) -> Surface:
    """Return the surface with its normals turned."""
    return surface[0], surface[1][:, ::-1]


def outer_of(surface: Surface) -> OuterShape:
    return OuterShape(*surface)


def tetrahedra(counts: tuple[int, int, int], edge: float = 1.0, origin: Point = (0.0, 0.0, 0.0)) -> VolumeMesh:
    """Fill a box of cubes with Kuhn's six tetrahedra to the cube."""
    lattice, cells = lattices.on_lattice(lattices.block(counts), lattices.TETRAHEDRA)
    return VolumeMesh(origin + edge * lattice, tetrahedra=cells)


def hexahedra(counts: tuple[int, int, int], edge: float = 1.0) -> VolumeMesh:
    """Fill a box with cubes."""
    lattice, cells = lattices.on_lattice(lattices.block(counts), lattices.HEXAHEDRON)
    return VolumeMesh(edge * lattice, hexahedra=cells)


def squares(counts: tuple[int, int], edge: float = 1.0, z: float = 0.0) -> PlanarMesh:
    """Fill a rectangle centred over the origin with squares."""
    ring = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    corners = np.array([np.array(cell) + ring for cell in product(*map(range, counts))])
    lattice, tiles = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    places = edge * (lattice - np.array(counts) / 2.0)
    return PlanarMesh(np.insert(places, 2, z, axis=1), quadrangles=tiles.reshape(-1, 4).astype(np.int64))


def planar_field(
    values: Callable[[Floats, Floats], Floats], half: float, spacing: float, z: float = 0.0
) -> ScalarField:
    """Return a field over a square of 2 x `half` around the origin, and three samples around it."""
    count = int(np.ceil(half / spacing)) + 3
    along = spacing * np.arange(-count, count + 1)
    x, y = np.meshgrid(along, along, indexing="ij")
    return ScalarField(values(x, y).astype(np.float32)[:, :, None], np.array([along[0], along[0], z]), spacing)


def samples_over(low: Point, high: Point, spacing: float, margin: int = 3) -> tuple[Floats, Floats]:
    """Return the origin (3,) and the samples (nx, ny, nz, 3) of a grid over a box and `margin` samples around it."""
    counts = np.ceil((np.array(high) - low) / spacing).astype(int) + 1 + 2 * margin
    origin = np.array(low) - margin * spacing
    return origin, origin + spacing * np.moveaxis(np.indices(counts), 0, -1)


def gyroid(outer: OuterShape, spacing: float, period: float) -> ScalarField:
    """Return Schoen's gyroid over an outer shape, some -1.5 to 1.5: half pores at 0, in one piece from -1.3 to 1.3."""
    low, high = outer.bounds
    origin, places = samples_over(tuple(low), tuple(high), spacing)
    x, y, z = np.moveaxis(2.0 * np.pi / period * places, -1, 0)
    values = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    return ScalarField(values.astype(np.float32), origin, spacing)


def require_closed(vertices: Floats, faces: Ints) -> None:
    """Assert that a surface is a closed oriented manifold, also when merged by its single-precision positions."""
    assert len(faces)
    assert not any(triangles.edge_faults(faces))
    assert triangles.touching_vertices(faces) == 0
    _, merged = triangles.merge_coincident(vertices.astype(np.float32).astype(float), faces)
    assert not any(triangles.edge_faults(merged))
    assert triangles.touching_vertices(merged) == 0


def volume_of(surface: Surface) -> float:
    a, b, c = np.moveaxis((surface[0] - surface[0].mean(axis=0))[surface[1]], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def prism(profile: list[tuple[float, float]], depth: float) -> Surface:
    """Return a prism over a convex `profile` in x and z, counter-clockwise as seen from -y, from y = 0 to `depth`."""
    count = len(profile)
    ends = [[(x, y, z) for x, z in profile] for y in (0.0, depth)]
    fan = np.array([(0, i, i + 1) for i in range(1, count - 1)])
    a = np.arange(count)
    b = np.roll(a, -1)
    sides = np.concatenate([np.stack([a, a + count, b], axis=1), np.stack([b, a + count, b + count], axis=1)])
    return np.array(ends).reshape(-1, 3), np.concatenate([fan, fan[:, ::-1] + count, sides])


def cone(radius: float, height: float, segments: int = 64) -> Surface:
    """Return a cone that stands on its tip at the origin, its lid at z = `height`."""
    turns = 2.0 * np.pi / segments * np.arange(segments)
    rim = np.stack([radius * np.cos(turns), radius * np.sin(turns), np.full(segments, height)], axis=1)
    a, tip, lid = np.arange(segments), np.full(segments, segments), np.full(segments, segments + 1)
    b = np.roll(a, -1)
    faces = np.concatenate([np.stack([b, a, tip], axis=1), np.stack([a, b, lid], axis=1)])
    return np.concatenate([rim, [(0.0, 0.0, 0.0), (0.0, 0.0, height)]]), faces


def fused(*surfaces: Surface) -> Surface:
    """Return the union of closed surfaces as one."""
    return booleans.from_manifold(sum((_body(part) for part in surfaces[1:]), _body(surfaces[0])))


def without(whole: Surface, *parts: Surface) -> Surface:
    """Return a closed surface less others."""
    body = _body(whole)
    for part in parts:
        body -= _body(part)
    return booleans.from_manifold(body)


def turned_about_x(surface: Surface, degrees: float) -> Surface:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return surface[0] @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]).T, surface[1]


def _body(surface: Surface) -> booleans.Manifold:
    return booleans.to_manifold(*surface, "part")


def self_intersections_by_cgal(vertices: np.ndarray, faces: np.ndarray) -> list[int]:
    """Return the faces that cross or touch others, as CGAL's exact predicates find them; not those there twice."""
    from igl.copyleft import cgal

    pairs = cgal.remesh_self_intersections(
        np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.int64), detect_only=True
    )[2]
    return np.unique(pairs).tolist()
