"""Booleans keep volume, pieces and cavities are told apart, and what is refused is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

from scaffold_geometry.surfaces import booleans
from scaffold_geometry.surfaces.float32 import snap_to_float32
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.errors import StageError
from shapes import ball, box, gyroid, inverted, outer_of, require_closed, together, volume_of

OUTER = outer_of(box((0.0, 0.0, 0.0), (6.0, 8.0, 10.0)))


def body(*surfaces: tuple[np.ndarray, np.ndarray]):
    return booleans.to_manifold(*together(*surfaces), "test body")


def porous(iso: float = 0.0):
    field = gyroid(OUTER, 0.5, 5.0)
    return booleans.to_manifold(*extract_iso_surface(field.values, iso, field.origin, field.spacing), "gyroid")


def cube(edge: float, centre: tuple[float, float, float]):
    return box(tuple(np.array(centre) - edge / 2.0), tuple(np.array(centre) + edge / 2.0))


def nothing():
    return np.empty((0, 3)), np.empty((0, 3), np.int64)


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        ((OUTER.vertices, OUTER.faces[1:]), r"not a closed manifold surface \(NotManifold\); repair it first$"),
        (inverted((OUTER.vertices, OUTER.faces)), r"positive volume, got -480 mm\^3; turn its triangles outward$"),
        (nothing(), r"positive volume, got 0 mm\^3"),
        ((np.where(OUTER.vertices > 7.0, np.nan, OUTER.vertices), OUTER.faces), r"\(NonFiniteVertex\)"),
    ],
    ids=["open", "inverted", "empty", "NaN"],
)
def test_what_bounds_no_solid_is_refused_in_one_line(surface: tuple[np.ndarray, np.ndarray], said: str):
    with pytest.raises(StageError, match=said) as failure:
        booleans.to_manifold(*surface, "outer shape")
    assert str(failure.value).startswith("outer shape: ")
    assert "\n" not in str(failure.value)


def test_locked_arrays_become_a_body_and_come_back_as_they_were():
    vertices, faces = booleans.from_manifold(booleans.to_manifold(OUTER.vertices, OUTER.faces, "outer"))
    assert not OUTER.vertices.flags.writeable
    assert (len(vertices), len(faces)) == (8, 12)
    assert volume_of((vertices, faces)) == pytest.approx(480.0, rel=1e-14)


@pytest.mark.parametrize("skin", [0.0, 0.7])
def test_solid_and_pore_space_add_up_to_the_outer_shape(skin: float):
    shape = booleans.to_manifold(OUTER.vertices, OUTER.faces, "outer")
    core = booleans.offset_core(OUTER.vertices, OUTER.faces, skin)
    for iso in (-0.8, 0.0, 0.8):
        solid, void = booleans.clip_to_outer(porous(iso), shape, core)
        assert solid.volume() + void.volume() == pytest.approx(480.0, rel=1e-9)
        assert (solid ^ void).volume() == pytest.approx(0.0, abs=1e-9)


def test_a_core_is_the_shape_less_its_skin():
    core = booleans.offset_core(OUTER.vertices, OUTER.faces, 1.0)
    assert core.volume() == pytest.approx(4.0 * 6.0 * 8.0, rel=0.01)
    assert booleans.offset_core(OUTER.vertices, OUTER.faces, 0.0) is None
    with pytest.raises(StageError, match=r"^skin 3.5 mm: fills the whole outer shape.*; lower skin$"):
        booleans.offset_core(OUTER.vertices, OUTER.faces, 3.5)


def test_shells_are_told_apart_by_the_sign_of_their_volume():
    shells = booleans.split_shells(body(cube(10.0, (0, 0, 0)), inverted(cube(4.0, (0, 0, 0))), cube(2.0, (20, 0, 0))))
    assert sorted(shells.volumes) == pytest.approx([-64.0, 8.0, 1000.0])
    assert shells.volumes[shells.greatest] == pytest.approx(1000.0)
    vertices, faces = shells.mesh_of(shells.volumes < 0.0)
    assert (len(vertices), len(faces)) == (8, 12)
    assert volume_of((vertices, faces)) == pytest.approx(-64.0)


def test_no_body_has_no_shells():
    shells = booleans.split_shells(body(cube(1.0, (0, 0, 0))) - body(cube(2.0, (0, 0, 0))))
    assert len(shells.volumes) == len(shells.faces) == 0


def test_the_main_piece_keeps_its_own_large_closed_pores_only():
    shells = booleans.split_shells(
        body(
            cube(20.0, (0, 0, 0)),
            inverted(cube(6.0, (5, 5, 5))),  # a large closed pore,
            cube(4.0, (5, 5, 5)),  # a piece afloat in it,
            inverted(cube(3.0, (5, 5, 5))),  # and a closed pore of that
            inverted(cube(1.0, (-5, -5, -5))),  # a small closed pore
            cube(8.0, (30, 0, 0)),  # a piece beside
            inverted(cube(5.0, (30, 0, 0))),  # with a closed pore
        )
    )
    kept = booleans.find_main_piece(shells, 2.0)
    assert kept.volume == pytest.approx(8000.0 - 216.0)
    assert kept.closed_pores == 1
    assert sorted(kept.floating) == pytest.approx([64.0, 512.0])
    assert sorted(kept.foreign) == pytest.approx([27.0, 125.0])
    assert kept.filled == pytest.approx([1.0])
    mesh = shells.mesh_of(kept.is_kept)
    require_closed(*mesh)
    assert volume_of(mesh) == pytest.approx(kept.volume)
    assert booleans.find_main_piece(shells, 0.5).closed_pores == 2


def test_a_pore_beside_a_floating_piece_is_not_taken_for_one_of_its_own():
    hollow = together(cube(20.0, (0, 0, 0)), inverted(cube(2.0, (4.0, 4.0, 4.0))))
    ring = body(cube(9.0, (30, 0, 0))) - booleans.to_manifold(*box((28.0, -2.0, -9.0), (32.0, 2.0, 9.0)), "hole")
    # the box of the ring spans its hole, in which the second hollow cube floats
    inner = together(cube(3.0, (30, 0, 0)), inverted(cube(1.0, (30, 0, 0))))
    shells = booleans.split_shells(body(hollow, booleans.from_manifold(ring), inner))
    kept = booleans.find_main_piece(shells, 0.0)
    assert kept.foreign == pytest.approx([1.0])
    assert kept.volume == pytest.approx(8000.0 - 8.0)


def test_pore_volumes_add_up_to_all_pore_space():
    outer = body(cube(30.0, (0, 0, 0)))
    matter = body(
        cube(20.0, (0, 0, 0)),
        inverted(cube(6.0, (5, 5, 5))),
        cube(4.0, (5, 5, 5)),
        inverted(cube(3.0, (5, 5, 5))),
        inverted(cube(1.0, (-5, -5, -5))),
        cube(4.0, (13, 13, 13)),  # touches the outer shape
    )
    solid, void = booleans.clip_to_outer(matter, outer, None)
    kept = booleans.find_main_piece(booleans.split_shells(solid), 2.0)
    pores = booleans.pore_volumes(booleans.split_shells(void), kept, outer.volume())
    assert pores == pytest.approx([27000.0 - 8000.0, 216.0])
    assert pores.sum() + kept.volume == pytest.approx(27000.0, rel=1e-12)


def test_a_solid_without_pores_has_no_pore_volumes():
    outer = body(cube(10.0, (0, 0, 0)))
    solid, void = booleans.clip_to_outer(body(cube(12.0, (0, 0, 0))), outer, None)
    kept = booleans.find_main_piece(booleans.split_shells(solid), 0.0)
    assert len(booleans.pore_volumes(booleans.split_shells(void), kept, outer.volume())) == 0


@pytest.mark.parametrize("offset", [0.0, 1_000.0, 20_000.0])
def test_in_single_precision_no_vertices_fall_together(offset: float):
    solid, _ = booleans.clip_to_outer(porous(), booleans.to_manifold(OUTER.vertices, OUTER.faces, "outer"), None)
    vertices, faces = booleans.from_manifold(solid.translate((offset, -offset, offset / 3.0)))
    rounded = vertices.astype(np.float32)
    is_hard = len(np.unique(rounded, axis=0)) < len(rounded)
    assert is_hard == (offset > 5_000.0)  # where plain rounding pinches the mesh

    single, faces = snap_to_float32(vertices, faces, "solid")[:2]
    assert (single == single.astype(np.float32)).all()
    assert len(np.unique(single, axis=0)) == len(single)
    require_closed(single, faces)
    assert volume_of((single, faces)) == pytest.approx(solid.volume(), rel=1e-3)


def test_a_solid_too_small_for_its_place_is_refused():
    far = body(cube(1e-3, (0, 0, 0))).translate((1e6, 1e6, 1e6))
    with pytest.raises(StageError, match=r"^speck: "):
        snap_to_float32(*booleans.from_manifold(far), "speck")


def test_simplification_takes_coplanar_triangles_out_and_keeps_the_shape():
    fine = body(ball(5.0, divisions=5))
    coarse = booleans.simplify_manifold(fine, 0.05)
    assert coarse.num_tri() < fine.num_tri() / 2
    assert coarse.volume() == pytest.approx(fine.volume(), rel=0.03)


def test_how_far_a_cut_surface_lies_from_the_shape_it_was_cut_to():
    shape, inner = box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), box((1.0, 1.0, 1.0), (3.0, 3.0, 9.0))
    outer = booleans.to_manifold(*shape, "outer")
    cut = outer ^ booleans.to_manifold(*inner, "inner")
    faces = np.ones(len(booleans.from_manifold(cut)[1]), bool)
    assert booleans.distance_from(outer, cut, faces, shape) == 0.0
    moved = shape[0] + np.array([0.0, 0.0, 0.25]), shape[1]
    assert booleans.distance_from(outer, cut, faces, moved) == pytest.approx(0.25)
    assert booleans.distance_from(outer, cut, ~faces, moved) == 0.0
