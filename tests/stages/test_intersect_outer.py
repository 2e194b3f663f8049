"""The clip keeps the outer shape's own facets and edges, and leaves one solid that single precision holds."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scaffold_geometry.surfaces import triangles
from scaffold_geometry.voxels.iso_surface import extract_iso_surface
from scaffold_pipeline.artifacts import IsoSurface, OuterShape, Solid
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.intersect_outer import IntersectOuterParams, intersect_outer
from scaffold_stages.make_shape import MakeShapeParams, make_shape
from shapes import ball, box, gyroid, inverted, outer_of, require_closed, samples_over, together

VOXEL = 0.4
BOX = outer_of(box((0.0, 0.0, 0.0), (8.0, 6.0, 7.0)))
BALL = outer_of(ball(5.0, (20.0, -3.0, 40.0)))


def gyroid_surface(outer: OuterShape, iso: float = 0.1):
    field = gyroid(outer, VOXEL, 5.0)
    return IsoSurface(*extract_iso_surface(field.values, iso, field.origin, field.spacing), iso=iso)


def surface_of(*surfaces: tuple[np.ndarray, np.ndarray], skin: float = 0.0, porosity: float | None = None):
    return IsoSurface(*together(*surfaces), iso=0.0, porosity_requested=porosity, skin=skin)


def clipped(porous: IsoSurface, outer: OuterShape = BOX, **given: float):
    return intersect_outer(porous, outer, params=IntersectOuterParams.model_validate(given))


def require_printable(solid: Solid):
    require_closed(solid.vertices, solid.faces)
    assert np.array_equal(solid.vertices, solid.vertices.astype(np.float32))
    assert triangles.face_pieces(solid.faces).max() == 0


def cube(edge: float, centre: tuple[float, float, float]):
    return box(tuple(np.array(centre) - edge / 2.0), tuple(np.array(centre) + edge / 2.0))


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("intersect_outer", intersect_outer)
    assert (declared.writes, list(declared.reads)) == ("solid", ["porous", "outer"])


@pytest.mark.parametrize("outer", [BOX, BALL], ids=["box", "ball"])
def test_every_vertex_of_the_solid_lies_on_the_outer_shape_or_on_the_porous_surface(outer: OuterShape):
    porous = gyroid_surface(outer)
    solid = clipped(porous, outer)
    require_printable(solid)
    to_outer, _, _ = igl.point_mesh_squared_distance(solid.vertices, outer.vertices, outer.faces)
    to_porous, _, _ = igl.point_mesh_squared_distance(solid.vertices, porous.vertices, porous.faces)
    assert np.sqrt(np.minimum(to_outer, to_porous)).max() < 4e-6  # half a step of single precision at 50 mm
    a, b, c = np.moveaxis(solid.vertices[solid.faces], 1, 0)
    from_porous, _, _ = igl.point_mesh_squared_distance((a + b + c) / 3.0, porous.vertices, porous.faces)
    centres = ((a + b + c) / 3.0)[from_porous > 1e-8]
    off, _, _ = igl.point_mesh_squared_distance(centres, outer.vertices, outer.faces)
    assert len(centres) > 100
    assert np.sqrt(off).max() < 4e-6  # what is not of the porous surface lies on the outer shape all over


def test_the_edges_of_a_box_stay_sharp():
    solid = clipped(gyroid_surface(BOX))
    assert np.array_equal(solid.bounds, BOX.bounds)
    assert solid.facts["clip_distance_mm"] < 1e-12
    on_faces = (np.abs(solid.vertices[:, None] - BOX.bounds) == 0.0).any(axis=1)
    assert (on_faces.sum(axis=1) == 1).sum() > 100  # on a face of the box
    assert (on_faces.sum(axis=1) == 2).sum() > 10  # on an edge
    assert on_faces.all(axis=1).any()  # at a corner


def turned(surface: tuple[np.ndarray, np.ndarray]):
    """Turn a surface off the axes, so that no edge lies along the voxels."""
    return surface[0] @ Rotation.from_rotvec((0.3, 0.5, 0.7)).as_matrix(), surface[1]


def on_the_grid(outer: OuterShape) -> OuterShape:
    """Return the shape as voxels show it: what a cut of the field, rather than of its surface, would go by."""
    origin, places = samples_over(*map(tuple, outer.bounds), VOXEL)
    is_inside = igl.fast_winding_number(outer.vertices, outer.faces, places.reshape(-1, 3)) > 0.5
    return OuterShape(*extract_iso_surface(is_inside.reshape(places.shape[:3]).astype(np.float32), 0.5, origin, VOXEL))


def distance_from_the_edges(solid: Solid, porous: IsoSurface, outer: OuterShape) -> float:
    """Return how far the solid lies from the outer shape's sharp edges, where these run through its material."""
    a, b, c = np.moveaxis(outer.vertices[outer.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ends = np.sort(np.stack([outer.faces, np.roll(outer.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, numbers = np.unique(ends, axis=0, return_inverse=True)
    first, second = (np.argsort(numbers.ravel(), kind="stable") // 3).reshape(-1, 2).T
    start, end = np.moveaxis(outer.vertices[edges[np.einsum("ij,ij->i", normals[first], normals[second]) < 0.8]], 1, 0)
    places = np.concatenate([(1.0 - share) * start + share * end for share in np.linspace(0.0, 1.0, 40)])
    places = places[igl.fast_winding_number(porous.vertices, porous.faces, places) > 0.5]
    assert len(places) > 100
    squared, _, _ = igl.point_mesh_squared_distance(places, solid.vertices, solid.faces)
    return float(np.sqrt(squared.max()))


SHARP = {
    "box": outer_of(turned(box((0.0, 0.0, 0.0), (8.0, 6.0, 7.0)))),
    "cylinder": make_shape(params=MakeShapeParams(shape="cylinder", height=8.0, width=8.0)),
}


@pytest.mark.parametrize("name", SHARP)
def test_sharp_edges_are_kept_to_a_thousandth_of_a_voxel(name: str):
    outer = SHARP[name]
    porous = gyroid_surface(outer)
    solid = clipped(porous, outer)
    assert solid.facts["pieces_removed"] == 0
    assert distance_from_the_edges(solid, porous, outer) <= 1e-3 * VOXEL
    assert solid.facts["clip_distance_mm"] <= 1e-3 * VOXEL
    blunt = clipped(porous, on_the_grid(outer))
    assert distance_from_the_edges(blunt, porous, outer) > 0.1 * VOXEL


@pytest.mark.parametrize("skin", [0.0, 0.6])
def test_solid_and_pores_add_up_to_the_outer_shape(skin: float):
    solid = clipped(gyroid_surface(BOX), skin=skin)
    assert solid.volume + solid.pore_volumes.sum() == pytest.approx(BOX.volume, rel=1e-6)
    assert (np.diff(solid.pore_volumes) <= 0.0).all()
    assert (solid.pore_volumes > 0.0).all()


def test_a_skin_closes_the_outside():
    solid = clipped(gyroid_surface(BALL), BALL, skin=0.6)
    require_closed(solid.vertices, solid.faces)
    volumes = triangles.piece_volumes(solid.vertices, solid.faces, triangles.face_pieces(solid.faces))
    assert (volumes > 0.0).sum() == 1
    assert volumes.max() == pytest.approx(BALL.volume, rel=1e-6)  # the outside is the whole outer shape
    inner = solid.vertices[np.linalg.norm(solid.vertices - [20.0, -3.0, 40.0], axis=1) < 4.9]
    to_outer, _, _ = igl.point_mesh_squared_distance(inner, BALL.vertices, BALL.faces)
    assert np.sqrt(to_outer.min()) == pytest.approx(0.6, abs=0.03)
    assert solid.facts["closed_pores"] == len(solid.pore_volumes) == 1


def test_floating_pieces_go_and_are_counted():
    porous = surface_of(cube(5.0, (3.0, 3.0, 3.5)), cube(1.0, (7.0, 3.0, 3.0)), cube(2.0, (8.0, 6.0, 7.0)))
    solid = clipped(porous)
    require_printable(solid)
    assert solid.volume == pytest.approx(125.0, rel=1e-6)
    assert solid.facts["pieces_removed"] == 2
    assert solid.facts["volume_removed_mm3"] == pytest.approx(1.0 + 1.0)
    assert solid.pore_volumes == pytest.approx([336.0 - 125.0])


def test_an_outer_shape_in_two_bodies_is_warned_of_as_one_of_them_is_filled():
    outer = outer_of(together(cube(4.0, (0.0, 0.0, 0.0)), cube(2.0, (9.0, 0.0, 0.0))))
    with pytest.warns(PipelineWarning, match=r"outer shape: is in 2 bodies, .* 11.1% of the volume stays empty"):
        solid = clipped(surface_of(cube(3.0, (0.0, 0.0, 0.0)), cube(1.0, (9.0, 0.0, 0.0))), outer)
    assert solid.volume == pytest.approx(27.0)


def test_small_closed_pores_are_filled_and_counted_and_large_ones_stay():
    block = cube(20.0, (4.0, 3.0, 3.5)), inverted(cube(1.0, (2.0, 2.0, 2.0))), inverted(cube(3.0, (5.5, 3.0, 4.0)))
    solid = clipped(surface_of(*block), min_closed_pore=0.1)
    require_closed(solid.vertices, solid.faces)
    assert solid.volume == pytest.approx(336.0 - 27.0, rel=1e-6)
    assert (solid.facts["closed_pores"], solid.facts["closed_pores_filled"]) == (1, 1)
    assert solid.facts["closed_pore_volume_filled_mm3"] == pytest.approx(1.0)
    assert solid.pore_volumes == pytest.approx([27.0])
    assert clipped(surface_of(*block), min_closed_pore=0.0).pore_volumes == pytest.approx([27.0, 1.0])
    assert len(clipped(surface_of(*block), fill=True).pore_volumes) == 0


def test_another_skin_than_the_porosity_was_solved_for_is_refused():
    porous = surface_of(cube(5.0, (3.0, 3.0, 3.5)), skin=0.5, porosity=0.6)
    with pytest.raises(StageError, match=r"^skin 0.2 mm: the porosity was solved for a skin of 0.5 mm; leave"):
        clipped(porous, skin=0.2)
    assert clipped(surface_of(cube(5.0, (3.0, 3.0, 3.5)), skin=0.5), skin=0.2).volume > 0.0  # none was asked for


def test_a_porous_surface_beside_the_outer_shape_leaves_nothing():
    with pytest.raises(StageError, match=r"^nothing remains inside the outer shape; lower porosity or iso$"):
        clipped(surface_of(cube(5.0, (30.0, 3.0, 3.5))))


def test_a_skin_as_thick_as_the_shape_is_refused():
    with pytest.raises(StageError, match=r"^skin 3.1 mm: fills the whole outer shape"):
        clipped(gyroid_surface(BOX), skin=3.1)


def test_an_open_porous_surface_is_refused_by_its_name():
    vertices, faces = cube(5.0, (3.0, 3.0, 3.5))
    with pytest.raises(StageError, match=r"^porous surface: is not a closed manifold"):
        clipped(surface_of((vertices, faces[1:])))


def test_far_from_the_origin_the_solid_is_still_one_that_a_file_holds():
    outer = outer_of(ball(5.0, (20_000.0, -20_000.0, 7_000.0), 3))
    solid = clipped(gyroid_surface(outer), outer)
    require_printable(solid)
    assert solid.volume == pytest.approx(outer.volume * 0.45, rel=0.1)
    assert 0.0 < solid.facts["clip_distance_mm"] < 2e-3  # a step of single precision, 20 m from the origin
