"""Every format that is written, read again as a user's file, is the same solid to single precision, in its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.solids.formats import FORMATS
from scaffold_geometry.files.solids.model import Mesh, Model
from scaffold_geometry.surfaces.merge_corners import merge_corners
from scaffold_stages.load_surface import LoadSurfaceParams, load_surface
from shapes import box, cone, without

UNITS = {"stl": "mm", "obj": "mm", "ply": "mm", "3mf": None, "glb": None}


def leaning():
    """Return a body without any symmetry, so that a turn or a mirror image shows: a cone with a bite out of it."""
    vertices, faces = without(cone(9.0, 21.0), box((1.0, 2.0, 11.0), (40.0, 50.0, 60.0)))
    return vertices + np.array([13.0, -47.0, 120.0]), faces


def corners_of(vertices: np.ndarray, faces: np.ndarray):
    """Return the triangles' corners in single precision, each from its least corner on, in rising order."""
    corners = np.asarray(vertices, np.float32)[faces]
    first = [min(range(3), key=lambda k: tuple(corner[k])) for corner in corners]
    turned = np.array([np.roll(corner, -k, axis=0) for corner, k in zip(corners, first, strict=True)])
    return turned[np.lexsort(turned.reshape(-1, 9).T)]


def test_every_format_is_tried():
    assert set(UNITS) == set(FORMATS)


@pytest.mark.parametrize("name", UNITS)
def test_what_is_written_loads_as_the_same_solid(tmp_path: Path, name: str):
    vertices, faces = merge_corners(leaning()[0].astype(np.float32)[leaning()[1]])
    path = tmp_path / f"solid.{name}"
    FORMATS[name].write(path, Model(Mesh(vertices.astype(np.float32), faces), "solid", "#aabbcc", None))
    outer = load_surface(params=LoadSurfaceParams(path=path, units=UNITS[name], repair="none"))
    assert np.array_equal(corners_of(outer.vertices, outer.faces), corners_of(vertices, faces))
