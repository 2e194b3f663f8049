"""Booleans of closed meshes on arrays, by manifold3d.

manifold3d returns an empty solid for invalid input; here that is an error.
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
    """A closed mesh and its connected shells: those of positive volume bound pieces, those of negative volume cavities.

    `vertices` (n, 3), `faces` (m, 3), `numbers` (m,) the shell of each face, `volumes` (k,) of the shells, mm^3.
    """

    vertices: Floats
    faces: Ints
    numbers: Ints
    volumes: Floats

    @property
    def greatest(self) -> int:
        """The number of the largest piece."""
        return int(np.argmax(self.volumes))

    def mesh_of(self, is_wanted: Bools) -> tuple[Floats, Ints]:
        """Return vertices and faces of the shells `is_wanted` (k,)."""
        return drop_unreferenced(self.vertices, self.faces[is_wanted[self.numbers]])


@dataclass(frozen=True, eq=False)
class MainPiece:
    """The largest piece of a solid with its closed pores, and the shells that are left out.

    `is_kept` (k,) are its shells, `volume` their volume, mm^3. Enclosed volumes of the other shells, mm^3: `floating`,
    other pieces; `filled`, closed pores too small to keep; `foreign`, closed pores of other pieces.
    """

    is_kept: Bools
    volume: float
    floating: Floats
    filled: Floats
    foreign: Floats

    @property
    def closed_pores(self) -> int:
        """Number of cavities of the piece."""
        return int(self.is_kept.sum()) - 1


def to_manifold(vertices: Floats, faces: Ints, about: str) -> Manifold:
    """Return the manifold of a closed, outward surface; raises `StageError` with the name `about` if it is not one."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C"))
    body = manifold3d.Manifold(mesh)
    _require_sound(body, about)
    return body


def from_manifold(body: Manifold) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of a manifold."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], np.float64), np.array(mesh.tri_verts, np.int64)


def distance_from(original: Manifold, body: Manifold, is_counted: Bools, surface: tuple[Floats, Ints]) -> float:
    """Return the greatest distance of faces of `body` that come from `original` to its surface, mm, in float32.

    `is_counted` (m,) are the faces of `body` to measure; `surface` is the original's, (n, 3) and (k, 3).
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
    """Split a manifold into its shells.

    By labelling: the time of manifold3d's own decomposition grows with the square of their number, 110 s for 176 shells
    of 2.3 million triangles against 1 s.
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
    """Return the largest piece, with its cavities below `least_cavity` mm^3 filled; there must be a piece."""
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
    """Return which cavities are within one of the pieces `is_holder`, (k,); shells do not cross."""
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
    """Return the volume of each connected piece of the pore space, greatest first, mm^3.

    Filled cavities and closed pores of removed pieces are not counted; the volume of removed pieces is added to the
    largest pore.
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
    """Return the part of a closed shape deeper than `skin` mm; None without a skin, `StageError` if there is none."""
    if skin == 0.0:
        return None
    inner_vertices, inner_faces = offset_inward(vertices, faces, skin)
    if not len(inner_faces):
        raise StageError(f"skin {skin:g} mm: fills the whole outer shape, so no pore would remain; lower skin")
    return to_manifold(inner_vertices, inner_faces, f"inward offset by {skin:g} mm")


def simplify_manifold(body: Manifold, tolerance: float) -> Manifold:
    """Return the manifold with fewer triangles, its surface moved by at most about `tolerance` mm."""
    return body.simplify(tolerance)


def _require_sound(body: Manifold, about: str) -> None:
    status = body.status().name
    if status != "NoError":
        raise StageError(f"{about}: is not a closed manifold surface ({status}); repair it first")
    if body.is_empty() or body.volume() <= 0.0:
        raise StageError(
            f"{about}: must enclose a positive volume, got {body.volume():.6g} mm^3; turn its triangles outward"
        )
