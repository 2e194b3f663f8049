"""Crumbs and flat triangles go, struts stay; smoothing keeps the volume, simplification its promise."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import igl
import numpy as np
import pytest

from scaffold_geometry.surfaces import triangles
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.artifacts import IsoSurface
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import clean_surface as module
from scaffold_stages.clean_surface import CleanSurfaceParams, clean_surface, smooth_with_meshlab
from shapes import ball, box, gyroid, inverted, outer_of, require_closed, together

FIELD = gyroid(outer_of(box((0.0, 0.0, 0.0), (8.0, 6.0, 7.0))), 0.4, 6.0)


def porous(*surfaces: tuple[np.ndarray, np.ndarray]):
    return IsoSurface(*together(*surfaces), iso=0.25, porosity_requested=0.6, skin=0.5, facts={"rounds": 3})


def scaffold():
    return porous(extract_iso_surface(FIELD.values, 0.1, FIELD.origin, FIELD.spacing))


def cleaned(surface: IsoSurface, **given: float):
    return clean_surface(surface, params=CleanSurfaceParams.model_validate(given))


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
    assert (result.iso, result.porosity_requested, result.skin) == (0.25, 0.6, 0.5)
    assert result.facts == {
        "rounds": 3,
        "floating_pieces_removed": 0,
        "floating_volume_removed_mm3": 0.0,
        "closed_pores_filled": 0,
        "closed_pore_volume_filled_mm3": 0.0,
        "flat_triangles_removed": 0,
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
    with pytest.raises(StageError, match=r"^min_piece 0.3: every one of 4 pieces is smaller, the greatest has 0.25 of"):
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
    shrunk = smooth_with_meshlab(vertices, faces, 30)["vertices"]
    assert abs(porous((shrunk, faces)).volume / porous((vertices, faces)).volume - 1.0) > 1e-3
    assert cleaned(porous((vertices, faces)), smoothing=30).volume == pytest.approx(porous((vertices, faces)).volume)


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
    with pytest.raises(StageError, match=r"without its filter apply_coord.*apt-get install libgl1 libopengl0\)$"):
        smooth_with_meshlab(*box((0, 0, 0), (1, 1, 1)), 1)


def test_a_meshlab_that_cannot_be_loaded_names_the_libraries_too(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    with pytest.raises(StageError, match=r"cannot be loaded \(.*\): install the system's .*libgl1 libopengl0\)$"):
        smooth_with_meshlab(*box((0, 0, 0), (1, 1, 1)), 1)


def test_without_smoothing_meshlab_is_not_needed(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "call_in_child", None)
    assert cleaned(scaffold(), simplify=0.05).volume > 0.0
