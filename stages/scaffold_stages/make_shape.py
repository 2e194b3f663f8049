"""Stage `make_shape`: an outer shape from a formula, for trials without a file.

Shapes stand on z = 0, centred at x = y = 0. The femur is a signed distance function made of Inigo Quilez's primitives
and quadratic smooth minimum (iquilezles.org/articles/distfunctions and /smin), in the size of an adult: z up along the
shaft, x medial, y anterior.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.polyhedra import icosahedron
from scaffold_pipeline.artifacts import OuterShape
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import Millimetres, Params, Unit, stage

if TYPE_CHECKING:
    from collections.abc import Callable

Mesh: TypeAlias = tuple[Floats, Ints]
Size: TypeAlias = tuple[float, float, float]

_FINEST = 300
"""Greatest number of facets along the longest side: with more, the samples of a femur take gigabytes."""
_COARSEST = {"box": 1, "ball": 3, "cylinder": 2, "femur": 20}
"""Least number of facets along the shortest side, or the femur's height, that represents the shape."""

_LIFE_HEIGHT = 151.0
_LIFE_BOX = np.array([[-36.0, -34.0, -8.0], [76.0, 40.0, 160.0]])
"""mm: height and sampling box of the life-size femur."""
_EDGE_PER_SPACING = 0.91
"""Mean edge of the smoothed femur over the spacing of its samples (measured: 0.90 to 0.92)."""
_ROUNDS = 10
"""Rounds of smoothing: the least angles of triangles rise from 4 to 20 degrees; more rounds change little."""


class MakeShapeParams(Params):
    """Parameters of `make_shape`."""

    shape: Literal["box", "ball", "cylinder", "femur"] = "femur"
    """Kind of shape; `femur` is the proximal end of a left femur: head, neck, trochanters and shaft."""

    height: Millimetres = Field(default=60.0, gt=0.0)
    """Size along z; the diameter of a ball; for a femur from the cut to the top of the head (life size: 151)."""

    width: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Size of a box along x, or diameter of a cylinder; by default the height."""

    depth: Annotated[float | None, Unit("mm")] = Field(default=None, gt=0.0)
    """Size of a box along y; by default the width."""

    facet: Millimetres = Field(default=2.0, gt=0.0)
    """Target edge length of the triangles."""

    @model_validator(mode="after")
    def _require_a_sensible_size(self) -> MakeShapeParams:
        if self.width is not None and self.shape not in {"box", "cylinder"}:
            raise ValueError(f"width: is not for a {self.shape}, whose size is its height; leave it out")
        if self.depth is not None and self.shape != "box":
            raise ValueError(f"depth: is not for a {self.shape}; leave it out")
        coarsest = min(self.size) / _COARSEST[self.shape]
        finest = max(self.size) / _FINEST
        if not finest <= self.facet <= coarsest:
            raise ValueError(
                f"facet: must be from {finest:.4g} to {coarsest:.4g} mm for a {self.shape} of this size, "
                f"got {self.facet:g}"
            )
        return self

    @property
    def size(self) -> Size:
        """Sizes along x, y and z, mm; for a femur all three are its height."""
        width = self.width or self.height
        return width, self.depth or width, self.height


@stage(writes="outer", version=1)
def make_shape(*, params: MakeShapeParams) -> OuterShape:
    """Make a box, ball, cylinder or femur: a closed, outward surface of even triangles, the same in every run.

    Raises `StageError` if the facets are too coarse for a closed surface.
    """
    make = {"box": _box, "ball": _ball, "cylinder": _cylinder, "femur": _femur}[params.shape]
    vertices, faces = make(params.size, params.facet)
    pieces = triangles.face_pieces(faces).max() + 1
    if any(triangles.edge_faults(faces)) or pieces != 1 or triangles.flat_faces(vertices, faces).any():
        raise StageError(f"a {params.shape} of facets of {params.facet:g} mm does not close; choose a smaller `facet`")
    note = f"{params.shape} of height {params.height:g} mm, {len(faces)} triangles for facets of {params.facet:g} mm"
    return OuterShape(vertices=vertices, faces=faces, notes=(note,))


def _box(size: Size, facet: float) -> Mesh:
    counts = np.ceil(np.array(size) / facet).astype(np.int64)
    corners = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        i, j = (index.ravel() for index in np.indices((counts[u], counts[v])))
        low = np.zeros((len(i), 4, 3), dtype=np.int64)
        low[:, :, u] = i[:, None] + [0, 1, 1, 0]
        low[:, :, v] = j[:, None] + [0, 0, 1, 1]
        high = low + counts * (np.arange(3) == axis)
        corners += [high[:, [0, 1, 2]], high[:, [0, 2, 3]], low[:, [0, 2, 1]], low[:, [0, 3, 2]]]
    lattice = np.concatenate(corners).reshape(-1, 3)
    vertices = (lattice / counts - [0.5, 0.5, 0.0]) * size
    return triangles.merge_coincident(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _ball(size: Size, facet: float) -> Mesh:
    """Subdivide the faces of an icosahedron evenly and project the vertices onto the sphere."""
    radius = size[2] / 2.0
    base, base_faces = icosahedron()
    # An edge of the icosahedron spans arctan(2) of the sphere.
    count = int(np.ceil(radius * np.arctan(2.0) / facet))
    i, j = (index.ravel() for index in np.indices((count, count)))
    up = np.stack([[i, j], [i + 1, j], [i, j + 1]], axis=-1)[..., i + j < count, :]
    down = np.stack([[i + 1, j], [i + 1, j + 1], [i, j + 1]], axis=-1)[..., i + j < count - 1, :]
    steps = np.concatenate([up, down], axis=1).transpose(1, 2, 0)
    shares = np.concatenate([steps, count - steps.sum(axis=2, keepdims=True)], axis=2)
    # Whole-number weights of the base's corners identify the common vertices of neighbouring faces exactly.
    weights = np.zeros((len(base_faces), *shares.shape[:2], len(base)), dtype=np.int64)
    for face, weight in zip(base_faces, weights, strict=True):
        weight[..., face] = shares
    unique, index = np.unique(weights.reshape(-1, len(base)), axis=0, return_inverse=True)
    places = unique @ base
    vertices = radius * places / np.linalg.norm(places, axis=1, keepdims=True) + [0.0, 0.0, radius]
    return vertices, index.reshape(-1, 3).astype(np.int64)


def _cylinder(size: Size, facet: float) -> Mesh:
    radius, height = size[0] / 2.0, size[2]
    count, levels = int(np.ceil(radius / facet)), int(np.ceil(height / facet))
    disc, disc_faces = _disc(radius, count)
    columns = 6 * count
    rim = disc[-columns:]
    low, up = (index.ravel() for index in np.indices((levels, columns)))
    here, there = low * columns + up, low * columns + (up + 1) % columns
    quads = np.stack([here, there, there + columns, here + columns], axis=-1)
    wall = np.concatenate([np.c_[rim, np.full(columns, height * k / levels)] for k in range(levels + 1)])
    vertices = np.concatenate([wall, np.c_[disc, np.zeros(len(disc))], np.c_[disc, np.full(len(disc), height)]])
    bottom, top = disc_faces[:, ::-1] + len(wall), disc_faces + len(wall) + len(disc)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], bottom, top])
    return triangles.merge_coincident(vertices, faces)


def _disc(radius: float, count: int) -> Mesh:
    """Return a disc of `count` rings with 6 k points on ring k: vertices (n, 2), the rim last, and its faces."""
    rings = [np.zeros((1, 2))]
    for ring in range(1, count + 1):
        angle = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        rings.append(radius * ring / count * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def at(ring: int, step: int) -> int:
        return 1 + 3 * ring * (ring - 1) + step % (6 * ring) if ring else 0

    faces = []
    for ring, sector in np.ndindex(count, 6):
        outer, inner = (ring + 1) * sector, ring * sector
        for step in range(ring + 1):
            near = at(ring, inner + step)
            faces.append((at(ring + 1, outer + step), at(ring + 1, outer + step + 1), near))
            if step < ring:
                faces.append((at(ring + 1, outer + step + 1), at(ring, inner + step + 1), near))
    return np.concatenate(rings), np.array(faces, dtype=np.int64)


def _femur(size: Size, facet: float) -> Mesh:
    """Mesh the life-size femur, smooth its triangles on the surface, and scale it."""
    from skimage.measure import marching_cubes

    scale = size[2] / _LIFE_HEIGHT
    spacing = facet / scale / _EDGE_PER_SPACING
    axes = [np.arange(low, high, spacing) for low, high in _LIFE_BOX.T]
    samples = _femur_distance(*np.meshgrid(*axes, indexing="ij", sparse=True))
    # A sample close to the surface makes slivers, one on it open edges.
    near = 0.05 * spacing
    samples = np.where(np.abs(samples) < near, np.copysign(near, samples), samples)
    vertices, faces, _, _ = marching_cubes(
        -samples, 0.0, spacing=(spacing,) * 3, gradient_direction="ascent", method="lorensen"
    )
    vertices, faces = vertices.astype(np.float64) + _LIFE_BOX[0], faces.astype(np.int64)
    return _relax(vertices, faces, _femur_distance) * scale, faces


def _femur_distance(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the signed distance (near the surface) to a life-size left femur, mm, negative inside."""
    p = (x, y, z)
    bone = _round_cone(p, (-1.0, 3.0, -15.0), (0.0, 0.0, 60.0), 13.5, 14.5)
    for part, blend in (
        (_round_cone(p, (0.0, 0.0, 60.0), (-1.0, 0.0, 92.0), 14.5, 19.0), 10.0),  # upper shaft
        (_round_cone(p, (-2.0, 0.0, 96.0), (34.0, 6.0, 121.0), 17.5, 13.5), 14.0),  # neck
        (_ellipsoid(p, (-15.0, -5.0, 107.0), (13.0, 17.0, 23.0)), 12.0),  # greater trochanter
        (_ellipsoid(p, (12.0, -12.0, 70.0), (8.0, 8.0, 12.0)), 9.0),  # lesser trochanter
        (_ellipsoid(p, (44.0, 8.0, 128.0), (23.0, 23.0, 23.0)), 7.0),  # head
    ):
        bone = _smooth_minimum(bone, part, blend)
    return -_smooth_minimum(-bone, z, 10.0)


def _smooth_minimum(a: Floats, b: Floats, blend: float) -> Floats:
    """Return the minimum of a and b, smoothed where they differ by less than `blend` (Quilez, quadratic)."""
    nearness = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.asarray(np.minimum(a, b) - nearness**2 * blend / 4.0)


def _round_cone(p: tuple[Floats, Floats, Floats], a: Size, b: Size, at_a: float, at_b: float) -> Floats:
    """Return the distance to the segment a-b minus a radius that changes from `at_a` to `at_b` along it."""
    axis = np.subtract(b, a)
    from_a = [coordinate - start for coordinate, start in zip(p, a, strict=True)]
    along = sum(offset * step for offset, step in zip(from_a, axis, strict=True)) / (axis @ axis)
    along = np.clip(along, 0.0, 1.0)
    squares = sum((offset - along * step) ** 2 for offset, step in zip(from_a, axis, strict=True))
    return np.asarray(np.sqrt(squares) - (at_a + along * (at_b - at_a)))


def _ellipsoid(p: tuple[Floats, Floats, Floats], centre: Size, radii: Size) -> Floats:
    """Return Quilez's bound on the distance to an ellipsoid; exact for a ball."""
    offsets = [coordinate - middle for coordinate, middle in zip(p, centre, strict=True)]
    share = np.sqrt(sum((offset / radius) ** 2 for offset, radius in zip(offsets, radii, strict=True)))
    slope = np.sqrt(sum((offset / radius**2) ** 2 for offset, radius in zip(offsets, radii, strict=True)))
    return np.asarray(share * (share - 1.0) / np.maximum(slope, 1e-12))


def _relax(vertices: Floats, faces: Ints, distance: Callable[[Floats, Floats, Floats], Floats]) -> Floats:
    """Move each vertex half-way to the mean of its neighbours and back onto the surface, in ten rounds."""
    from scipy.sparse import coo_array

    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_array((np.ones(len(starts)), (starts, ends)), shape=(len(vertices),) * 2).tocsr()
    degree = links.sum(axis=1)[:, None]
    for _ in range(_ROUNDS):
        vertices = _on_surface(0.5 * (vertices + links @ vertices / degree), distance)
    return _on_surface(_on_surface(vertices, distance), distance)


def _on_surface(vertices: Floats, distance: Callable[[Floats, Floats, Floats], Floats]) -> Floats:
    """Take one step of Newton's method along the gradient, found by central differences."""
    step = 1e-4
    gradient = np.stack(
        [
            (distance(*(vertices + shift).T) - distance(*(vertices - shift).T)) / (2.0 * step)
            for shift in step * np.eye(3)
        ],
        axis=1,
    )
    # Blended distances have a gradient below one; with less than a half a step would overshoot.
    steepness = np.maximum((gradient**2).sum(axis=1), 0.25)
    return np.asarray(vertices - (distance(*vertices.T) / steepness)[:, None] * gradient)
