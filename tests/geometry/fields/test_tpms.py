"""Each surface by its space group, its topology and the room that it divides; none by copied samples."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.arrays import Floats
from scaffold_geometry.fields.tpms import SURFACES, levels_at, sheet_of
from scaffold_geometry.voxels.iso_surface import extract_iso_surface

PI = np.pi
PLACES = np.random.default_rng(1).uniform(-2.0 * PI, 2.0 * PI, (3, 500))
MANY = 2.0 * PI * np.modf(np.outer([0.819172513, 0.671043607, 0.549700478], np.arange(100_000)))[0]
"""Even all over a cell, though no grid: Kronecker's sequence of the root of a^4 = a + 1."""


def moved(name: str, *steps: float) -> Floats:
    return SURFACES[name](*(PLACES + np.array(steps)[:, None]))


def same(one: Floats, other: Floats) -> None:
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SURFACES)
def test_the_period_is_one_cell_along_each_axis_and_no_less(name: str):
    for axis in range(3):
        step = 2.0 * PI * (np.arange(3) == axis)
        same(moved(name, *step), moved(name, 0, 0, 0))
        for part in (2, 3, 4):
            assert np.abs(moved(name, *step / part) - moved(name, 0, 0, 0)).max() > 0.5


@pytest.mark.parametrize(
    ("name", "step", "sign"),
    [
        ("schwarz_p", (PI, PI, PI), -1),  # the two labyrinths are one, moved
        ("schwarz_d", (PI, PI, 0), 1),  # face-centred
        ("schwarz_d", (PI, 0, 0), -1),
        ("gyroid", (PI, PI, PI), 1),  # body-centred
        ("iwp", (PI, PI, PI), 1),
    ],
)
def test_a_step_within_the_cell_repeats_the_surface_or_swaps_its_sides(
    name: str, step: tuple[float, float, float], sign: int
):
    same(moved(name, *step), sign * moved(name, 0, 0, 0))


@pytest.mark.parametrize(
    ("name", "screw"),
    [
        ("schwarz_p", (0, 0, 0)),
        ("schwarz_d", (0, PI / 2, 3 * PI / 2)),
        ("gyroid", (PI / 2, 3 * PI / 2, PI / 2)),
        ("iwp", (0, 0, 0)),
    ],
)
def test_each_is_cubic_by_threefold_axes_and_fourfold_axes_or_screws(name: str, screw: tuple[float, float, float]):
    f, (x, y, z) = SURFACES[name], PLACES
    same(f(y, z, x), f(x, y, z))
    same(f(-y + screw[0], x + screw[1], z + screw[2]), f(x, y, z))


@pytest.mark.parametrize(("name", "sign"), [("schwarz_p", 1), ("schwarz_d", -1), ("gyroid", -1), ("iwp", 1)])
def test_inversion_keeps_the_sides_or_swaps_them(name: str, sign: int):
    same(SURFACES[name](*-PLACES), sign * SURFACES[name](*PLACES))


def test_the_gyroid_alone_has_no_mirror():
    x, y, z = PLACES
    is_mirrored = {name: np.allclose(f(y, x, z), f(x, y, z)) for name, f in SURFACES.items()}
    assert is_mirrored == {"schwarz_p": True, "schwarz_d": True, "gyroid": False, "iwp": True}


@pytest.mark.parametrize(
    ("name", "euler"),
    [
        ("schwarz_p", -4),  # genus 3 in a primitive cell, and the cubic one is primitive
        ("schwarz_d", -16),  # genus 3 in each of four
        ("gyroid", -8),  # genus 3 in each of two
        ("iwp", -12),  # genus 4 in each of two
    ],
)
def test_one_cell_of_the_surface_has_the_genus_of_the_minimal_surface(name: str, euler: int):
    """By Gauss and Bonnet: the angles that lack at the vertices within one cell of a larger surface are 2 pi Euler."""
    count = 24
    step = 2.0 * PI / count
    axis = step * np.arange(3 * count)
    values = SURFACES[name](axis[:, None, None], axis[:, None], axis)
    vertices, faces = extract_iso_surface(values.astype(np.float32), 0.0, np.zeros(3), step)
    low = 2.0 * PI + 0.3 * step
    in_cell = ((vertices >= low) & (vertices < low + 2.0 * PI)).all(axis=1)
    corners = vertices[faces]
    angles = np.zeros(len(vertices))
    for corner in range(3):
        a, b = (corners[:, corner - other] - corners[:, corner] for other in (1, 2))
        np.add.at(angles, faces[:, corner], np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
    assert (2.0 * PI - angles)[in_cell].sum() / (2.0 * PI) == pytest.approx(euler, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "below", "tolerance"),
    [("schwarz_p", 0.5, 1e-3), ("schwarz_d", 0.5, 1e-3), ("gyroid", 0.5, 1e-3), ("iwp", 0.464, 6e-3)],
)
def test_the_surface_halves_the_cell_but_for_iwp_which_leaves_the_wrapped_package_its_smaller_part(
    name: str, below: float, tolerance: float
):
    """I-WP's minimal surface encloses 0.536 on its I side; the nodal one lies half a percent off it."""
    assert (SURFACES[name](*MANY) <= 0.0).mean() == pytest.approx(below, abs=tolerance)


@pytest.mark.parametrize("name", SURFACES)
def test_the_side_above_zero_is_the_net_that_the_docstring_names(name: str):
    """From one node of it to the next, along a straight edge, the field stays above 0; both are alike."""
    f = SURFACES[name]
    paths = {
        "schwarz_p": ((0, 0, 0), (2 * PI, 0, 0)),
        "schwarz_d": ((PI / 4, PI / 4, PI / 4), (3 * PI / 4, -PI / 4, -PI / 4)),
        "gyroid": ((PI / 4, PI / 4, PI / 4), (3 * PI / 4, PI / 4, -PI / 4)),
        "iwp": ((0, 0, 0), (PI, PI, PI)),
    }
    start, end = (np.array(place, float)[:, None] for place in paths[name])
    along = f(*(start + np.linspace(0.0, 1.0, 51) * (end - start)))
    assert along[0] == pytest.approx(along[-1])
    assert along.min() > 0.5


@pytest.mark.parametrize("name", SURFACES)
def test_a_sheet_is_highest_on_the_surface(name: str):
    f, sheet = SURFACES[name](*PLACES), sheet_of(SURFACES[name])(*PLACES)
    same(sheet, np.minimum(f, -f))


@pytest.mark.parametrize("name", SURFACES)
def test_levels_part_the_cell_in_the_shares_asked_for(name: str):
    shares = np.array([0.05, 0.3, 0.5, 0.7, 0.95])
    for surface in (SURFACES[name], sheet_of(SURFACES[name])):
        levels = levels_at(surface, shares)
        assert (np.diff(levels) > 0.0).all()
        found = (surface(*MANY) <= levels[:, None]).mean(axis=1)
        np.testing.assert_allclose(found, shares, rtol=0, atol=1e-3)
