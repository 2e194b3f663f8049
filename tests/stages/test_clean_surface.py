"""Crumbs, flat triangles and doubles go, struts stay; smoothing keeps volume and place, simplification its promise."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import igl
import numpy as np
import pytest

from scaffold_geometry.surfaces import smoothing as module
from scaffold_geometry.surfaces import triangles
from scaffold_geometry.surfaces.meshlab import smooth_with_meshlab, weld_with_meshlab
from scaffold_geometry.surfaces.self_intersections import self_intersecting_faces
from scaffold_geometry.surfaces.smoothing import hold_smoothing
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.artifacts import IsoSurface
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.clean_surface import CleanSurfaceParams, clean_surface
from shapes import ball, box, gyroid, inverted, outer_of, require_closed, together

FIELD = gyroid(outer_of(box((0.0, 0.0, 0.0), (8.0, 6.0, 7.0))), 0.4, 6.0)


def porous(*surfaces: tuple[np.ndarray, np.ndarray]):
    return IsoSurface(*together(*surfaces), iso=0.25, porosity_requested=0.6, skin=0.5, facts={"rounds": 3})


def scaffold():
    surface = porous(extract_iso_surface(FIELD.values, 0.1, FIELD.origin, FIELD.spacing))
    return replace(surface, spacing=FIELD.spacing)


def cleaned(surface: IsoSurface, **given: float):
    """Clean without smoothing, unless it is given: it would round the corners of boxes."""
    return clean_surface(surface, params=CleanSurfaceParams.model_validate({"smoothing": 0, **given}))


def roughness(surface: IsoSurface):
    """Return the mean angle between neighbouring triangles, in radians."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one, other = triangles._neighbours(surface.faces)
    return np.arccos(np.clip((normals[one // 3] * normals[other // 3]).sum(axis=1), -1.0, 1.0)).mean()


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("clean_surface", clean_surface)
    assert (declared.writes, list(declared.reads)) == ("porous", ["porous"])


def test_a_sound_surface_is_returned_as_it_is():
    surface = scaffold()
    result = cleaned(surface)
    assert np.array_equal(result.vertices, surface.vertices)
    assert np.array_equal(result.faces, surface.faces)
    assert (result.iso, result.porosity_requested, result.skin, result.spacing) == (0.25, 0.6, 0.5, FIELD.spacing)
    assert result.facts == {
        "rounds": 3,
        "floating_pieces_removed": 0,
        "floating_volume_removed_mm3": 0.0,
        "closed_pores_filled": 0,
        "closed_pore_volume_filled_mm3": 0.0,
        "flat_triangles_removed": 0,
        "duplicate_vertices_merged": 0,
        "duplicate_triangles_removed": 0,
        "non_manifold_edges_split": 0,
        "non_manifold_vertices_split": 0,
    }


def test_crumbs_and_small_closed_pores_go_and_are_counted_and_large_ones_stay():
    surface = porous(
        box((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)),
        box((20.0, 0.0, 0.0), (21.0, 1.0, 2.0)),
        box((20.0, 5.0, 0.0), (21.0, 6.0, 1.0)),
        box((20.0, 10.0, 0.0), (25.0, 15.0, 5.0)),
        inverted(box((1.0, 1.0, 1.0), (2.0, 2.0, 2.0))),
        inverted(box((4.0, 4.0, 4.0), (8.0, 8.0, 8.0))),
        box((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)),
    )
    result = cleaned(surface, min_piece=0.01)
    assert result.facts["floating_pieces_removed"] == 3
    assert result.facts["floating_volume_removed_mm3"] == pytest.approx(2.0 + 1.0 + 1.0)
    assert result.facts["closed_pores_filled"] == 1
    assert result.facts["closed_pore_volume_filled_mm3"] == pytest.approx(1.0)
    assert result.volume == pytest.approx(1000.0 + 125.0 - 64.0)
    assert len(result.vertices) == 3 * 8  # those of what went are gone too
    assert cleaned(surface, min_piece=0.0).volume == pytest.approx(surface.volume)


def test_a_share_that_no_piece_has_is_refused_with_the_greatest():
    surface = porous(*(box((20.0 * i, 0.0, 0.0), (20.0 * i + 1.0, 1.0, 1.0)) for i in range(4)))
    with pytest.raises(StageError, match=r"^min_piece 0.3: every one of 4 pieces is smaller, the largest has 0.25 of"):
        cleaned(surface, min_piece=0.3)


def with_a_flat_triangle():
    """A box whose edge 0-1 is split by a vertex on it: one triangle there has no area."""
    vertices, faces = box((0.0, 0.0, 0.0), (4.0, 5.0, 6.0))
    hit = next(i for i, face in enumerate(faces) if {0, 1} <= set(face.tolist()))
    tail = next(k for k in range(3) if {faces[hit][k], faces[hit][(k + 1) % 3]} == {0, 1})
    a, b, c = np.roll(faces[hit], -tail)
    middle = len(vertices)
    vertices = np.vstack([vertices, (vertices[a] + vertices[b]) / 2.0])
    return vertices, np.vstack([np.delete(faces, hit, axis=0), [a, middle, c], [middle, b, c], [a, b, middle]])


def test_a_flat_triangle_is_collapsed_and_leaves_no_hole():
    vertices, faces = with_a_flat_triangle()
    is_flat = triangles.flat_faces(vertices, faces)
    require_closed(vertices, faces)
    assert is_flat.sum() == 1
    with pytest.raises(AssertionError):
        require_closed(vertices, faces[~is_flat])  # to take it out would open the surface

    result = cleaned(porous((vertices, faces)))
    require_closed(result.vertices, result.faces)
    assert not triangles.flat_faces(result.vertices, result.faces).any()
    assert result.volume == pytest.approx(120.0, rel=1e-12)
    assert result.facts["flat_triangles_removed"] >= 1


@pytest.mark.parametrize("break_it", ["open", "inverted"])
def test_a_surface_that_bounds_no_solid_is_refused_in_one_line(break_it: str):
    surface = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    bad = inverted(surface) if break_it == "inverted" else (surface[0], surface[1][1:])
    with pytest.raises(StageError) as failure:
        cleaned(porous(bad))
    assert "\n" not in str(failure.value)


def test_smoothing_smooths_keeps_the_volume_and_stays_closed():
    surface = scaffold()
    noise = 0.02 * np.random.default_rng(1).normal(size=surface.vertices.shape)
    rough = porous((surface.vertices + noise, surface.faces))
    result = cleaned(rough, smoothing=10)
    require_closed(result.vertices, result.faces)
    assert result.volume == pytest.approx(rough.volume, rel=1e-4)
    assert np.array_equal(result.faces, rough.faces)
    assert roughness(result) < 0.5 * roughness(rough)


def test_smoothing_alone_would_lose_volume():
    vertices, faces = ball(5.0, divisions=2)
    shrunk = smooth_with_meshlab(vertices, faces, 30)
    assert abs(porous((shrunk, faces)).volume / porous((vertices, faces)).volume - 1.0) > 1e-3
    assert cleaned(porous((vertices, faces)), smoothing=30).volume == pytest.approx(porous((vertices, faces)).volume)


def slivers(surface: IsoSurface):
    """Return the share of triangles lower than a tenth of their longest edge."""
    corners = surface.vertices[surface.faces]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    return (2.0 * triangles.face_areas(surface.vertices, surface.faces) < 0.1 * longest**2).mean()


def test_by_default_slivers_go_and_no_vertex_moves_further_than_half_a_voxel():
    surface = scaffold()
    result = clean_surface(surface, params=CleanSurfaceParams())
    require_closed(result.vertices, result.faces)
    assert slivers(surface) > 0.02
    assert slivers(result) < slivers(surface) / 20.0
    assert result.volume == pytest.approx(surface.volume, rel=1e-5)
    moves = np.linalg.norm(result.vertices - surface.vertices, axis=1)
    assert result.facts["smoothing_distance_mm"] == pytest.approx(moves.max())
    assert result.facts["smoothing_distance_voxels"] == pytest.approx(moves.max() / FIELD.spacing)
    assert 0.0 < result.facts["smoothing_offset_rms_mm"] < 0.1 * FIELD.spacing < moves.max() < 0.5001 * FIELD.spacing


@pytest.mark.parametrize("most", [0.02, 0.1])
def test_smoothing_goes_no_further_than_asked_at_the_same_volume(most: float):
    surface = scaffold()
    free = cleaned(surface, smoothing=20, most_moved=10.0)
    result = cleaned(surface, smoothing=20, most_moved=most)
    assert free.facts["smoothing_distance_voxels"] > 2.0 * most
    assert np.linalg.norm(result.vertices - surface.vertices, axis=1).max() <= most * FIELD.spacing * (1.0 + 1e-9)
    assert result.volume == pytest.approx(surface.volume, rel=1e-4)


def test_a_surface_of_no_voxels_is_smoothed_without_a_limit_in_voxels():
    result = cleaned(replace(scaffold(), spacing=None), smoothing=3)
    assert result.facts["smoothing_distance_voxels"] is None
    assert result.facts["smoothing_distance_mm"] > 0.0


def two_plates():
    """Two plates 0.1 apart, and the same with the middle of the lower one's top lifted through the upper one."""
    lower, upper = (box((0.0, 0.0, z), (4.0, 4.0, z + 1.0)) for z in (0.0, 1.1))
    vertices, faces = together(*(igl.upsample(*plate, 2) for plate in (lower, upper)))
    lifted = vertices.copy()
    lifted[(np.abs(vertices - [2.0, 2.0, 1.0]) < 1e-9).all(axis=1), 2] += 0.3
    return vertices, lifted, faces


def test_where_smoothing_would_make_walls_cross_their_vertices_are_put_back():
    vertices, lifted, faces = two_plates()
    assert not self_intersecting_faces(vertices, faces).any()
    assert self_intersecting_faces(lifted, faces).any()
    held = hold_smoothing(vertices, lifted, faces, np.inf)
    assert not self_intersecting_faces(held.vertices, faces).any()
    assert 0 < held.put_back < len(vertices)


def test_where_putting_back_does_not_help_nothing_is_smoothed_with_a_warning(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "_ROUNDS", 0)
    surface = scaffold()
    with pytest.warns(
        PipelineWarning, match=r"^smoothing: left out, as the surface would cross itself; lower smoothing"
    ):
        result = cleaned(surface, smoothing=3)
    assert np.array_equal(result.vertices, surface.vertices)


def test_triangles_that_share_no_vertex_are_joined_at_their_places():
    vertices, faces = box((0.0, 0.0, 0.0), (4.0, 5.0, 6.0))
    soup = vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)
    result = cleaned(porous(soup))
    require_closed(result.vertices, result.faces)
    assert (len(result.vertices), result.volume) == (8, pytest.approx(120.0))
    assert result.facts["duplicate_vertices_merged"] == 36 - 8


def test_a_triangle_that_is_there_twice_goes_and_a_vertex_of_none_is_no_duplicate():
    vertices, faces = box((0.0, 0.0, 0.0), (4.0, 5.0, 6.0))
    doubled = np.vstack([vertices, vertices[:1]]), np.vstack([faces, faces[:2]])
    assert triangles.edge_faults(doubled[1]).non_manifold > 0
    result = cleaned(porous(doubled))
    require_closed(result.vertices, result.faces)
    assert (len(result.vertices), len(result.faces)) == (8, 12)
    assert result.facts["duplicate_triangles_removed"] == 2
    assert result.facts["duplicate_vertices_merged"] == 0


@pytest.mark.parametrize("shared", ["edge", "corner"])
def test_bodies_that_touch_are_split_where_they_do(shared: str):
    start = 0.0 if shared == "edge" else 6.0
    first, second = box((0.0, 0.0, 0.0), (4.0, 5.0, 6.0)), box((4.0, 5.0, start), (8.0, 10.0, start + 6.0))
    vertices, faces = triangles.merge_coincident(*together(first, second))
    assert triangles.edge_faults(faces).non_manifold == (1 if shared == "edge" else 0)
    assert triangles.touching_vertices(faces) == (0 if shared == "edge" else 1)
    welded = weld_with_meshlab(vertices, faces)
    assert triangles.edge_faults(welded.faces) == (0, 0, 0)
    assert triangles.touching_vertices(welded.faces) == 0
    assert (welded.non_manifold_edges, welded.non_manifold_vertices) == ((1, 0) if shared == "edge" else (0, 1))
    assert cleaned(porous((vertices, faces))).volume == pytest.approx(240.0)


def test_meshlab_would_open_the_surface_at_a_flat_triangle():
    import pymeshlab

    vertices, faces = with_a_flat_triangle()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
    meshes.apply_filter("meshing_remove_null_faces")
    assert triangles.edge_faults(meshes.current_mesh().face_matrix().astype(np.int64)).boundary == 3


@pytest.mark.parametrize("error", [0.01, 0.05, 0.2])
def test_simplification_moves_the_surface_no_further_than_asked(error: float):
    surface = scaffold()
    result = cleaned(surface, simplify=error)
    require_closed(result.vertices, result.faces)
    there, _, _ = igl.point_mesh_squared_distance(surface.vertices, result.vertices, result.faces)
    back, _, _ = igl.point_mesh_squared_distance(result.vertices, surface.vertices, surface.faces)
    apart = np.sqrt(max(there.max(), back.max()))
    assert 0.0 < apart <= error
    assert apart <= result.facts["simplification_error"] <= error
    assert result.facts["triangles_merged"] == len(surface.faces) - len(result.faces) > 0


def test_a_larger_error_leaves_fewer_triangles():
    counts = [len(cleaned(scaffold(), simplify=error).faces) for error in (0.01, 0.05, 0.2)]
    assert counts == sorted(counts, reverse=True)
    assert counts[2] < 0.8 * counts[0]


def test_without_its_filters_meshlab_is_missing_system_libraries(monkeypatch: pytest.MonkeyPatch):
    few = SimpleNamespace(filter_list=lambda: ["meshing_invert_face_orientation"])
    monkeypatch.setitem(sys.modules, "pymeshlab", few)
    with pytest.raises(StageError, match=r"has no filter apply_coord.*apt-get install libgl1 libopengl0\)$"):
        smooth_with_meshlab(*box((0, 0, 0), (1, 1, 1)), 1)


def test_a_meshlab_that_cannot_be_loaded_names_the_libraries_too(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    with pytest.raises(StageError, match=r"cannot be loaded \(.*\): install the system's .*libgl1 libopengl0\)$"):
        smooth_with_meshlab(*box((0, 0, 0), (1, 1, 1)), 1)
