"""Booleans of closed meshes on arrays: the one place that knows manifold3d.

A fault of a manifold is a value that travels on as an empty solid; here it is an error at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import StageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Body = Any
"""A `manifold3d.Manifold`, which has no type information."""

_ROUNDS = 8
"""Rounding to single precision and collapsing what that made coincide has always settled within three rounds."""


@dataclass(frozen=True, eq=False)
class Shells:
    """The connected closed surfaces of a body: pieces enclose matter, cavities enclose void; greatest first."""

    pieces: tuple[Body, ...]
    cavities: tuple[Body, ...]


def to_body(vertices: Floats, faces: Ints, about: str) -> Body:
    """Return the body within a closed, outward surface; raises `StageError` naming `about` where it is none."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C"))
    body = manifold3d.Manifold(mesh)
    _require_sound(body, about)
    return body


def from_body(body: Body) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of a body."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], np.float64), np.array(mesh.tri_verts, np.int64)


def shells_of(body: Body) -> Shells:
    """Split a body into its pieces and cavities."""
    parts = sorted(((part.volume(), number, part) for number, part in enumerate(body.decompose())), key=lambda p: p[:2])
    pieces = tuple(part for volume, _, part in reversed(parts) if volume > 0.0)
    cavities = tuple(part for volume, _, part in parts if volume < 0.0)
    return Shells(pieces, cavities)


def clipped(porous: Body, outer: Body, inner: Body | None) -> tuple[Body, Body]:
    """Return solid and pore space within `outer`; what lies outside `inner` (a core, or None for all) is solid."""
    void = (inner if inner is not None else outer) - porous
    return (outer - void if inner is not None else outer ^ porous), void


def joined(bodies: tuple[Body, ...]) -> Body:
    """Return disjoint bodies and cavities as one body."""
    import manifold3d

    return manifold3d.Manifold.compose(list(bodies))


def simplified(body: Body, tolerance: float) -> Body:
    """Return the body with fewer triangles, none of its surface moved by more than about `tolerance` mm."""
    return body.simplify(tolerance)


def in_single_precision(body: Body, about: str) -> tuple[Floats, Ints]:
    """Return vertices and faces whose coordinates single precision holds exactly and apart.

    A solid rounded to float32 in a file has pinched or opened where vertices fall together. The constructor of a
    single-precision mesh collapses these; collapsing moves others, so it is repeated until all stay apart.
    """
    import manifold3d

    for _ in range(_ROUNDS):
        mesh = body.to_mesh64()
        rounded = np.ascontiguousarray(mesh.vert_properties[:, :3], np.float32)
        if len(np.unique(rounded, axis=0)) == len(rounded) and np.array_equal(rounded, mesh.vert_properties[:, :3]):
            return rounded.astype(np.float64), np.array(mesh.tri_verts, np.int64)
        body = manifold3d.Manifold(manifold3d.Mesh(rounded, np.array(mesh.tri_verts, np.uint32)))
        _require_sound(body, about)
    raise StageError(f"{about}: does not stay manifold in single precision; move it nearer to the origin")


def _require_sound(body: Body, about: str) -> None:
    status = body.status().name
    if status != "NoError":
        raise StageError(f"{about}: is not a closed manifold surface ({status}); repair it first")
    if body.is_empty() or body.volume() <= 0.0:
        raise StageError(f"{about}: must enclose a positive volume, got {body.volume():.6g} mm^3; turn its normals out")
