"""Booleans of closed meshes on arrays: the one place that knows manifold3d.

A fault of a manifold is a value that travels on as an empty solid; here it is an error at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from scaffold_geometry.arrays import Bools, Floats, Ints
from scaffold_geometry.surfaces.triangles import drop_unreferenced, piece_volumes, winding_number
from scaffold_geometry.voxels.offset import offset_inward
from scaffold_pipeline.errors import StageError

Manifold = Any
"""A `manifold3d.Manifold`, which has no type information."""


@dataclass(frozen=True, eq=False)
class Shells:
    """A closed mesh and its connected shells: one of positive volume bounds a piece, one of negative a cavity.

    `vertices` (n, 3), `faces` (m, 3), `numbers` (m,) the shell of each face, `volumes` (k,) of the shells, mm^3.
    """

    vertices: Floats
    faces: Ints
    numbers: Ints
    volumes: Floats

    @property
    def greatest(self) -> int:
        """The number of the greatest piece."""
        return int(np.argmax(self.volumes))

    def mesh_of(self, is_wanted: Bools) -> tuple[Floats, Ints]:
        """Return vertices and faces of the shells wanted, (k,)."""
        return drop_unreferenced(self.vertices, self.faces[is_wanted[self.numbers]])


@dataclass(frozen=True, eq=False)
class MainPiece:
    """The one piece of a solid that is kept, with the closed pores in it, and what it goes without.

    `is_kept` (k,) tells which shells make it up, `volume` is theirs, mm^3. The other shells, by their volume as it is
    enclosed, mm^3: `floating` pieces; `filled`, closed pores too small to keep; `foreign`, closed pores of what floats.
    """

    is_kept: Bools
    volume: float
    floating: Floats
    filled: Floats
    foreign: Floats

    @property
    def closed_pores(self) -> int:
        """How many cavities the piece keeps."""
        return int(self.is_kept.sum()) - 1


def to_manifold(vertices: Floats, faces: Ints, about: str) -> Manifold:
    """Return the body within a closed, outward surface; raises `StageError` naming `about` where it is none."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C"))
    body = manifold3d.Manifold(mesh)
    _require_sound(body, about)
    return body


def from_manifold(body: Manifold) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of a body."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], np.float64), np.array(mesh.tri_verts, np.int64)


def distance_from(original: Manifold, body: Manifold, is_counted: Bools, surface: tuple[Floats, Ints]) -> float:
    """Return how far what `body` has of an `original` lies from its surface at most, mm, rounded to single precision.

    `is_counted` (m,) tells which faces of `body` are asked about; `surface` is the original's, (n, 3) and (k, 3).
    """
    import igl

    mesh = body.to_mesh64()
    starts: Ints = np.array(mesh.run_index, np.int64) // 3
    is_ours = np.repeat(np.isin(mesh.run_original_id, original.to_mesh64().run_original_id), starts[1:] - starts[:-1])
    corners = np.unique(np.asarray(mesh.tri_verts)[is_ours & is_counted])
    if not len(corners):
        return 0.0
    rounded = np.asarray(mesh.vert_properties)[corners, :3].astype(np.float32).astype(np.float64)
    squared, _, _ = igl.point_mesh_squared_distance(rounded, *surface)
    return float(np.sqrt(squared.max()))


def split_shells(body: Manifold) -> Shells:
    """Split a body into its shells.

    By labelling, as manifold3d's own decomposition takes the square of their number: 110 s for 176 shells of 2.3
    million triangles, where this takes one.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, faces = from_manifold(body)
    if not len(faces):
        return Shells(vertices, faces, np.empty(0, np.int64), np.empty(0))
    tails, heads = faces[:, :2].ravel(), faces[:, 1:].ravel()
    graph = coo_array((np.ones(len(tails), bool), (tails, heads)), shape=(len(vertices), len(vertices)))
    _, labels = connected_components(graph, directed=False)
    numbers = labels[faces[:, 0]].astype(np.int64)
    return Shells(vertices, faces, numbers, piece_volumes(vertices, faces, numbers))


def find_main_piece(shells: Shells, least_cavity: float) -> MainPiece:
    """Return the piece that encloses most, its cavities below `least_cavity` mm^3 filled; there must be a piece."""
    is_floating = shells.volumes > 0.0
    is_floating[shells.greatest] = False
    is_foreign = _cavities_within(shells, is_floating)
    is_own = (shells.volumes <= 0.0) & ~is_foreign
    is_kept = is_own & (-shells.volumes >= least_cavity)
    is_filled = is_own & ~is_kept
    is_kept[shells.greatest] = True
    enclosed = np.abs(shells.volumes)
    volume = float(shells.volumes[is_kept].sum())
    return MainPiece(is_kept, volume, enclosed[is_floating], enclosed[is_filled], enclosed[is_foreign])


def _cavities_within(shells: Shells, is_holder: Bools) -> Bools:
    """Return which cavities lie within one of the pieces `is_holder`, (k,); shells do not cross."""
    holders, cavities = np.flatnonzero(is_holder), np.flatnonzero(shells.volumes <= 0.0)
    is_within = np.zeros(len(shells.volumes), bool)
    if not (len(holders) and len(cavities)):
        return is_within
    low, high = _boxes(shells)
    for cavity in cavities:
        fits = (low[holders] <= low[cavity]).all(axis=1) & (high[holders] >= high[cavity]).all(axis=1)
        for holder in holders[fits]:
            point = shells.vertices[shells.faces[shells.numbers == cavity][0, 0]]
            winding = winding_number(point, shells.vertices, shells.faces[shells.numbers == holder])
            is_within[cavity] |= winding > 0.5  # 1 inside, 0 outside
    return is_within


def _boxes(shells: Shells) -> tuple[Floats, Floats]:
    """Return the least and the greatest corner of each shell's bounding box, (k, 3) both."""
    order = np.argsort(shells.numbers, kind="stable")
    starts = np.searchsorted(shells.numbers[order], np.arange(len(shells.volumes)))
    corners = shells.vertices[shells.faces[order]]
    return np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)


def pore_volumes(void: Shells, kept: MainPiece, outer_volume: float) -> Floats:
    """Return the volume of each connected pore beside the kept piece, greatest first, mm^3: all of the pore space.

    What was closed in by filled cavities or by pieces left out is no pore of its own; the room of the pieces left out
    goes to the greatest pore.
    """
    volumes = np.sort(void.volumes[void.volumes > 0.0])[::-1]
    for enclosed in (*kept.filled, *kept.foreign):
        volumes = np.delete(volumes, np.argmin(np.abs(volumes - enclosed)))
    if len(volumes):
        volumes[0] += outer_volume - kept.volume - volumes.sum()
    return volumes


def clip_to_outer(porous: Manifold, outer: Manifold, inner: Manifold | None) -> tuple[Manifold, Manifold]:
    """Return solid and pore space within `outer`; what lies outside `inner` (a core, or None for all) is solid."""
    void = (inner if inner is not None else outer) - porous
    return (outer - void if inner is not None else outer ^ porous), void


def offset_core(vertices: Floats, faces: Ints, skin: float) -> Manifold | None:
    """Return what of a closed shape lies deeper than `skin` mm; None for no skin, `StageError` where nothing does."""
    if skin == 0.0:
        return None
    inner_vertices, inner_faces = offset_inward(vertices, faces, skin)
    if not len(inner_faces):
        raise StageError(f"skin {skin:g} mm: the outer shape is nowhere so thick, and no pore would remain; lower skin")
    return to_manifold(inner_vertices, inner_faces, f"inward offset by {skin:g} mm")


def simplify_manifold(body: Manifold, tolerance: float) -> Manifold:
    """Return the body with fewer triangles, none of its surface moved by more than about `tolerance` mm."""
    return body.simplify(tolerance)


def _require_sound(body: Manifold, about: str) -> None:
    status = body.status().name
    if status != "NoError":
        raise StageError(f"{about}: is not a closed manifold surface ({status}); repair it first")
    if body.is_empty() or body.volume() <= 0.0:
        raise StageError(f"{about}: must enclose a positive volume, got {body.volume():.6g} mm^3; turn its normals out")
