"""Checks of the mesh in a file, before the file gets its name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaffold_geometry.arrays import Ints
from scaffold_geometry.files.solids.model import Mesh
from scaffold_geometry.surfaces.triangles import face_pieces, piece_volumes
from scaffold_pipeline.artifacts import Solid, SurfaceMesh
from scaffold_pipeline.errors import StageError

VOLUME_TOLERANCE = 1e-4
"""Greatest relative difference of the volume in a file from that of the solid."""

_REMEDY = (
    "write what intersect_outer makes, which is closed and exact in float32; where the shape lies far from the "
    "origin, move it nearer"
)


@dataclass(frozen=True)
class ExpectedSolid:
    """The properties that a file must have, from the solid in memory; the volume in mm^3."""

    triangles: int
    volume: float
    pieces: int
    closed_pores: int


def expect_solid(solid: Solid) -> ExpectedSolid:
    """Return the properties of the solid, with the closed pores in its facts, or else counted."""
    volumes = piece_volumes(solid.vertices, solid.faces, face_pieces(solid.faces))
    counted = solid.facts.get("closed_pores")
    closed_pores = counted if isinstance(counted, int) else int((volumes < 0.0).sum())
    return ExpectedSolid(len(solid.faces), solid.volume, int((volumes > 0.0).sum()), closed_pores)


@dataclass
class FileVerifier:
    """Checks the meshes read from files against the mesh `written` to all, and against the expected solid.

    A mesh equal to it to the bit has the same geometry, so geometry is checked in the first reading only.
    """

    written: Mesh
    expected: ExpectedSolid
    _volume: float | None = None

    def volume_of(self, mesh: Mesh, reader: str) -> float:
        """Return the volume of a mesh read by `reader`, mm^3; raises `StageError` if a check fails."""
        if self._volume is not None and mesh.equals(self.written):
            return self._volume
        try:
            volume = require_printable(mesh, self.expected)
            _require_same(mesh, self.written)
        except StageError as error:
            raise StageError(f"read by {reader}: {error}") from error
        self._volume = volume
        return volume


def require_printable(mesh: Mesh, expected: ExpectedSolid) -> float:
    """Check a mesh and return its volume, mm^3.

    Raises `StageError` if it is not closed, manifold, outward and free of self-intersections, or is not as expected.
    Its vertices must be distinct, as readers that merge vertices would otherwise get a different mesh.
    """
    if len(mesh.faces) != expected.triangles:
        raise StageError(f"must have {expected.triangles} triangles, but {len(mesh.faces)} were read back")
    surface = SurfaceMesh(mesh.vertices.astype(np.float64), mesh.faces)
    _require_closed(surface.faces, len(surface.vertices))
    _require_manifold(surface)
    _require_no_self_intersections(surface)
    _require_shells(surface, expected)
    volume = surface.volume
    if not abs(volume - expected.volume) <= VOLUME_TOLERANCE * expected.volume:
        raise StageError(
            f"must keep the solid's volume to {VOLUME_TOLERANCE:g}, but it is {volume:.9g} mm^3 "
            f"instead of {expected.volume:.9g}; {_REMEDY}"
        )
    return volume


def _require_same(mesh: Mesh, written: Mesh) -> None:
    """Require that the mesh read is the mesh written, to the bit."""
    if mesh.equals(written):
        return
    if mesh.vertices.shape != written.vertices.shape or not np.array_equal(mesh.faces, written.faces):
        raise StageError("must have the solid's triangles in their order, but others were read back")
    moved = np.abs(mesh.vertices.astype(np.float64) - written.vertices)
    raise StageError(
        f"must have the solid's coordinates to the bit, but {int(moved.any(axis=1).sum())} of {len(moved)} vertices "
        f"differ, by up to {moved.max():.3g} mm"
    )


def _require_closed(faces: Ints, count: int) -> None:
    """Require that each edge has two triangles, with opposite directions."""
    starts, ends = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    if collapsed := int((starts == ends).sum()):
        raise StageError(f"must have no collapsed edge, but {collapsed} are shorter than float32 holds; {_REMEDY}")
    forward, backward = np.sort(starts * count + ends), np.sort(ends * count + starts)
    if twice := int((forward[1:] == forward[:-1]).sum()):
        raise StageError(
            f"must be manifold, but {twice} edges have more than two triangles or two of the same direction; {_REMEDY}"
        )
    if not np.array_equal(forward, backward):
        single = len(np.setdiff1d(forward, backward, assume_unique=True))
        raise StageError(f"must be closed, but {single} edges have one triangle only; {_REMEDY}")


def _require_manifold(surface: SurfaceMesh) -> None:
    """Require that manifold3d accepts the surface unchanged, without splitting vertices where pieces touch."""
    import manifold3d

    mesh = manifold3d.Mesh64(np.array(surface.vertices), surface.faces.astype(np.uint64))
    manifold = manifold3d.Manifold(mesh)
    if manifold.status() != manifold3d.Error.NoError:
        raise StageError(f"must be manifold, but manifold3d says {manifold.status().name}; {_REMEDY}")
    if (touching := manifold.num_vert() - len(surface.vertices)) > 0:
        raise StageError(f"must be manifold, but surfaces touch at {touching} vertices; {_REMEDY}")


def _require_shells(surface: SurfaceMesh, expected: ExpectedSolid) -> None:
    """Require that pieces are in void and closed pores in solid, with the expected numbers of both.

    The surface has no self-intersections, so one point of a shell is enough to locate it.
    """
    from scaffold_geometry.surfaces.nesting import misplaced_shells

    shells = face_pieces(surface.faces)
    volumes = piece_volumes(surface.vertices, surface.faces, shells)
    if wrong := int(misplaced_shells(surface.vertices, surface.faces, shells, volumes).sum()):
        raise StageError(
            f"must be outward, but {wrong} of {len(volumes)} shells are inverted or inside another's solid; {_REMEDY}"
        )
    pieces, closed_pores = int((volumes > 0.0).sum()), int((volumes < 0.0).sum())
    if (pieces, closed_pores) != (expected.pieces, expected.closed_pores):
        raise StageError(
            f"must have the solid's pieces and closed pores, {expected.pieces} and {expected.closed_pores}, "
            f"but has {pieces} and {closed_pores}; {_REMEDY}"
        )


def _require_no_self_intersections(surface: SurfaceMesh) -> None:
    """Require that no two triangles meet beyond the vertices and edge that they share."""
    from scaffold_geometry.surfaces.self_intersections import degenerate_faces, self_intersecting_faces

    if flat := int(degenerate_faces(surface.vertices, surface.faces).sum()):
        raise StageError(f"must have no triangle without area, but {flat} have none; {_REMEDY}")
    crossing = np.flatnonzero(self_intersecting_faces(surface.vertices, surface.faces))
    if len(crossing):
        place = surface.vertices[surface.faces[crossing[0]]].mean(axis=0)
        raise StageError(
            f"must not intersect itself, but {len(crossing)} triangles cross or touch another, the first at "
            f"({place[0]:.4f}, {place[1]:.4f}, {place[2]:.4f}) mm; {_REMEDY}"
        )
