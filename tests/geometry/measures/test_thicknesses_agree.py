"""Local thickness, struts along the mesh and walls for the printer say the same of shapes whose thickness is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_geometry.measures.local_thickness import distribution, local_thickness
from scaffold_geometry.measures.printability.rules import PrintRules
from scaffold_geometry.measures.printability.thin_walls import thin_walls
from scaffold_geometry.measures.struts_and_throats import thinnest_strut
from scaffold_geometry.measures.surface_tree import SurfaceTree
from scaffold_geometry.surfaces import booleans
from scaffold_geometry.voxels.image import STRUT
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_geometry.voxels.voxelising import voxelise
from scaffold_pipeline.artifacts import SurfaceMesh
from shapes import ball, box, fused, hexahedra, inverted, samples_over, together

SPACING = 0.1
BOX = box((0.0, 0.0, 0.0), (6.0, 6.0, 6.0))
Surface = tuple[Floats, Ints]


def rods(width: float, off: float = 0.0) -> Surface:
    """Return square rods along the edges of 2 x 2 x 2 cubes of 3 mm, `off` mm beside them, within the box."""
    bodies = []
    for axis, i, j in product(range(3), (0.0, 3.0, 6.0), (0.0, 3.0, 6.0)):
        low = np.insert([i - width / 2.0 + off, j - width / 2.0 + off], axis, -1.0)
        high = np.insert([i + width / 2.0 + off, j + width / 2.0 + off], axis, 8.0)
        bodies.append(box(tuple(low), tuple(high)))
    whole = booleans.to_manifold(*fused(*bodies), "rods") ^ booleans.to_manifold(*BOX, "box")
    return booleans.from_manifold(whole)


def plate(thickness: float) -> Surface:
    return box((0.5, 0.5, 3.0), (5.5, 5.5, 3.0 + thickness))


def shell(thickness: float) -> Surface:
    middle = (3.0, 3.0, 3.0)
    return together(ball(2.5, middle, divisions=5), inverted(ball(2.5 - thickness, middle, divisions=5)))


def gyroid_sheet(thickness: float) -> Surface:
    """Return the sheet about a gyroid of 4 mm: its value by its slope is how far off it is, to 5 % so near."""
    _, places = samples_over((0.0, 0.0, 0.0), (6.0, 6.0, 6.0), 0.06)
    x, y, z = np.moveaxis(2.0 * np.pi / 4.0 * places, -1, 0)
    values = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    slopes = (
        2.0
        * np.pi
        / 4.0
        * np.sqrt(
            (np.cos(x) * np.cos(y) - np.sin(z) * np.sin(x)) ** 2
            + (np.cos(y) * np.cos(z) - np.sin(x) * np.sin(y)) ** 2
            + (np.cos(z) * np.cos(x) - np.sin(y) * np.sin(z)) ** 2
        )
    )
    inside = (thickness / 2.0 - np.abs(values) / slopes).astype(np.float32)
    surface = extract_iso_surface(inside, 0.0, places[0, 0, 0], 0.06)
    return booleans.from_manifold(booleans.to_manifold(*surface, "sheet") ^ booleans.to_manifold(*BOX, "box"))


SHAPES = {
    "plate": (plate, 0.5),
    "shell": (shell, 0.6),
    "ball": (lambda size: ball(size / 2.0, (3.0, 3.0, 3.0)), 4.0),
}


def walls_of(surface: Surface) -> dict[str, float]:
    mesh = SurfaceMesh(*surface)
    return thin_walls(mesh, SurfaceTree(*surface), PrintRules()).values


def local_of(surface: Surface):
    image = voxelise(surface, BOX, SPACING)
    return distribution(image, STRUT, local_thickness(image.is_phase(STRUT), SPACING))


@pytest.mark.parametrize("shape", SHAPES)
def test_local_thickness_and_walls_agree_within_the_voxels_error(shape: str):
    make, thickness = SHAPES[shape]
    found = local_of(make(thickness))
    assert found.median == pytest.approx(thickness, abs=2.0 * SPACING)
    assert walls_of(make(thickness))["thinnest_wall_mm"] == pytest.approx(thickness, abs=0.3 * SPACING)
    assert walls_of(make(thickness))["wall_percentile_5_mm"] == pytest.approx(found.percentiles[0], abs=2.0 * SPACING)


@pytest.mark.parametrize("off", [0.0, 0.2])
@pytest.mark.parametrize("width", [0.5, 0.8])
def test_struts_and_walls_and_local_thickness_agree_on_a_lattice_beside_its_axes_too(width: float, off: float):
    lattice = rods(width, off)
    mesh = hexahedra((2, 2, 2), edge=3.0)
    skeleton = skeleton_of(mesh.vertices, mesh.cells)
    strut = thinnest_strut(skeleton, SurfaceTree(*lattice), SurfaceTree(*BOX), 2.0 * SPACING, 1e-3)
    assert strut.interrupted == 0
    assert strut.diameter == pytest.approx(width, abs=0.3 * SPACING)
    middle = booleans.to_manifold(*lattice, "rods") ^ booleans.to_manifold(
        *box((1.0, 1.0, 1.0), (5.0, 5.0, 5.0)), "box"
    )
    inner = booleans.from_manifold(middle)
    assert walls_of(inner)["thinnest_wall_mm"] == pytest.approx(width, abs=0.3 * SPACING)
    assert local_of(inner).median == pytest.approx(width, abs=1.01 * SPACING)


def test_the_walls_of_a_gyroid_are_as_thick_as_its_sheet_but_where_the_box_shaves_it():
    sheet, thickness = gyroid_sheet(0.6), 0.6
    found, walls = local_of(sheet), walls_of(sheet)
    assert found.median == pytest.approx(thickness, abs=SPACING)
    assert walls["wall_percentile_5_mm"] == pytest.approx(found.percentiles[0], abs=SPACING)
    assert walls["thinnest_wall_mm"] < thickness - SPACING
