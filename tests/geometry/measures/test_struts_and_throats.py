"""The thickness of struts and the width of throats, on a block of rooms whose walls and windows are known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_geometry.measures.struts_and_throats import narrowest_throat, thinnest_strut
from scaffold_geometry.measures.surface_tree import SurfaceTree
from scaffold_geometry.surfaces import booleans
from shapes import box, hexahedra

OUTER = box((0.0, 0.0, 0.0), (20.0, 20.0, 20.0))
MESH = hexahedra((2, 2, 2), edge=10.0)
SKELETON = skeleton_of(MESH.vertices, MESH.cells)
SPACING = 0.25


def body(low: tuple[float, float, float], high: tuple[float, float, float]):
    return booleans.to_manifold(*box(low, high), "box")


def rooms():
    """Return 8 rooms of 8 mm behind walls of 2 mm, square windows of 4 mm in the middle of each wall."""
    block = body((0.0, 0.0, 0.0), (20.0, 20.0, 20.0))
    for corner in product((0.0, 10.0), repeat=3):
        x, y, z = corner
        block -= body((x + 1, y + 1, z + 1), (x + 9, y + 9, z + 9))
    for axis, (i, j) in product(range(3), product((3.0, 13.0), repeat=2)):
        low, high = np.insert([i, j], axis, -1.0), np.insert([i + 4.0, j + 4.0], axis, 21.0)
        block -= body(tuple(low), tuple(high))
    return block


def measured(solid: object, skin: float = 0.0):
    surface, outer = SurfaceTree(*booleans.from_manifold(solid)), SurfaceTree(*OUTER)
    strut = thinnest_strut(SKELETON, surface, outer, SPACING, 1e-3)
    return strut, narrowest_throat(SKELETON, surface, outer, SPACING, skin)


def test_the_ball_about_an_axis_touches_the_nearest_wall():
    strut, throat = measured(rooms())
    assert strut.diameter == pytest.approx(2.0 * np.sqrt(2.0))  # an inner edge has four rooms, 1 mm off on two axes
    assert throat.diameter == pytest.approx(4.0)
    assert strut.interrupted == throat.interrupted == 0


def test_the_thinnest_place_is_told_with_the_ball_that_still_fits_beside_a_nick():
    """The ball about the axis touches the nick at 0.7 mm; the greatest, 0.5 mm off, touches two rooms besides."""
    strut, _ = measured(rooms() - body((10.5, 10.5, 4.5), (12.0, 12.0, 5.5)))
    assert strut.diameter == pytest.approx(np.sqrt(5.0), abs=0.01)
    assert sorted(strut.place[:2]) == pytest.approx([9.5, 10.0], abs=0.02)
    assert abs(strut.place[2] - 5.0) <= 0.5
    assert strut.interrupted == 0


def test_a_strut_that_is_cut_through_is_interrupted_and_not_the_thinnest():
    strut, throat = measured(rooms() - body((8.0, 8.0, 4.5), (12.0, 12.0, 5.5)))
    assert strut.interrupted == 1
    assert strut.diameter == pytest.approx(2.0 * np.sqrt(2.0))
    assert throat.interrupted == 0


@pytest.mark.parametrize("width", [1e-2, 1e-4])
def test_no_break_is_too_short_to_be_seen(width: float):
    strut, _ = measured(rooms() - body((8.0, 8.0, 4.633), (12.0, 12.0, 4.633 + width)))
    assert strut.interrupted == 1


def test_no_film_across_a_channel_is_too_thin_to_be_seen():
    _, throat = measured(rooms() + body((8.633, 2.0, 2.0), (8.6331, 8.0, 8.0)))
    assert throat.interrupted == 1


def test_a_window_that_is_walled_up_interrupts_the_channels_of_both_its_rooms():
    strut, throat = measured(rooms() + body((9.0, 2.0, 2.0), (11.0, 8.0, 8.0)))
    assert throat.interrupted == 2
    assert throat.diameter == pytest.approx(4.0)  # of the channels that are open
    assert strut.interrupted == 0


def test_where_all_struts_are_gone_none_is_the_thinnest():
    speck = SurfaceTree(*box((4.0, 4.0, 4.0), (5.0, 5.0, 5.0)))
    strut = thinnest_strut(SKELETON, speck, SurfaceTree(*OUTER), SPACING, 1e-3)
    assert strut == (6, None, None)  # the inner edges; the others lie on the outer shape


def test_a_strut_beside_its_axis_is_as_thick_as_it_is():
    """Rods of 1 mm whose middle is 0.4 mm off the axis: the ball about the axis has 0.2 mm."""
    rods = body((9.9, 9.9, 0.0), (10.9, 10.9, 20.0))
    for low, high in (((9.9, 0.0, 9.9), (10.9, 20.0, 10.9)), ((0.0, 9.9, 9.9), (20.0, 10.9, 10.9))):
        rods += body(low, high)
    surface = SurfaceTree(*booleans.from_manifold(rods))
    strut = thinnest_strut(SKELETON, surface, SurfaceTree(*OUTER), 1.0, 1e-3)
    assert strut.diameter == pytest.approx(1.0, abs=0.02)
    assert strut.interrupted == 0


def test_a_narrower_window_is_the_narrowest_throat():
    _, throat = measured(rooms() + (body((9.0, 2.0, 2.0), (11.0, 8.0, 8.0)) - body((8.0, 4.5, 4.0), (12.0, 5.5, 6.0))))
    assert throat.diameter == pytest.approx(1.0)


def test_what_the_clip_cuts_says_nothing_of_a_strut():
    """All but the middle of the block away: its edges end at the cut, and the nearest wall of some is the cut."""
    cut = (4.0, 4.0, 4.0), (16.0, 16.0, 16.0)
    surface = SurfaceTree(*booleans.from_manifold(rooms() ^ body(*cut)))
    strut = thinnest_strut(SKELETON, surface, SurfaceTree(*box(*cut)), SPACING, 1e-3)
    assert strut.diameter == pytest.approx(2.0 * np.sqrt(2.0))
    assert strut.interrupted == 0


def test_a_solid_whose_struts_all_lie_on_the_cut_has_none_to_measure():
    one = hexahedra((1, 1, 1), edge=20.0)
    outer = SurfaceTree(*OUTER)
    assert thinnest_strut(skeleton_of(one.vertices, one.cells), outer, outer, SPACING, 1e-3) == (0, None, None)


def test_a_skin_closes_no_channel_that_stays_within():
    outside = body((0.0, 0.0, 0.0), (20.0, 20.0, 20.0)) - body((2.0, 2.0, 2.0), (18.0, 18.0, 18.0))
    _, closed = measured(rooms() + outside)
    assert closed.interrupted == 24  # a window to the outside in three walls of each room
    _, throat = measured(rooms() + outside, skin=2.0)
    assert throat.interrupted == 0
    assert throat.diameter == pytest.approx(4.0)


@pytest.mark.parametrize(("wall", "closed"), [(9.99, 0), (9.8, 4)])
def test_channels_that_end_on_the_inner_wall_of_a_skin_are_open(wall: float, closed: int):
    solid = (rooms() + body((0.0, 0.0, wall), (20.0, 20.0, 12.0))) ^ body((0.0, 0.0, 0.0), (20.0, 20.0, 12.0))
    outer = SurfaceTree(*box((0.0, 0.0, 0.0), (20.0, 20.0, 12.0)))
    throat = narrowest_throat(SKELETON, SurfaceTree(*booleans.from_manifold(solid)), outer, SPACING, 2.0)
    assert throat.interrupted == closed
