"""Meshes and fields to and from trimesh and pyvista, and how artifacts show themselves in a notebook."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista
import trimesh

import scaffold_pipeline as sp
from scaffold_pipeline.artifacts import Certificate


def mixed():
    """Return one cell of each solid kind, side by side."""
    cube = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
    apex, wedge, tip = [[0.5, 0.5, 2.0]], [[0, 0.5, -1], [1, 0.5, -1]], [[3, 0, 0], [4, 0, 0], [3, 1, 0], [3, 0, 1]]
    return sp.VolumeMesh(
        np.array([*cube, *apex, *wedge, *tip], float),
        tetrahedra=[[11, 12, 13, 14]],
        pyramids=[[4, 5, 6, 7, 8]],
        wedges=[[0, 9, 3, 1, 10, 2]],
        hexahedra=[[0, 1, 2, 3, 4, 5, 6, 7]],
    )


def test_a_surface_goes_to_trimesh_and_back_unchanged():
    outer = sp.stages.make_shape(shape="ball", facet=4.0)
    mesh = outer.to_trimesh()
    assert mesh.is_watertight
    assert mesh.units == "mm"
    assert mesh.volume == pytest.approx(outer.volume)
    mesh.vertices += 1.0  # it is the user's own
    assert np.array_equal(sp.OuterShape.from_trimesh(outer.to_trimesh()).vertices, outer.vertices)
    assert np.array_equal(sp.OuterShape.from_trimesh(outer.to_trimesh()).faces, outer.faces)


def test_a_surface_that_may_be_in_metres_is_warned_of_unless_it_says_its_unit():
    ball = trimesh.creation.icosphere(1, 0.03)
    with pytest.warns(sp.PipelineWarning, match=r"longest side is 0.06 mm: .* call mesh.apply_scale\(1000\)"):
        sp.OuterShape.from_trimesh(ball)
    with pytest.warns(sp.PipelineWarning, match=r"longest side is 0.06 mm: .* call mesh.scale\(1000, inplace=True\)"):
        sp.OuterShape.from_pyvista(pyvista.Sphere(radius=0.03))
    ball.units = "mm"
    sp.OuterShape.from_trimesh(ball)


def test_a_surface_goes_to_pyvista_and_back_unchanged():
    outer = sp.stages.make_shape(shape="ball", facet=4.0)
    mesh = outer.to_pyvista()
    assert mesh.volume == pytest.approx(outer.volume)
    back = sp.OuterShape.from_pyvista(mesh)
    assert np.array_equal(back.vertices, outer.vertices)
    assert np.array_equal(back.faces, outer.faces)
    assert sp.OuterShape.from_pyvista(pyvista.Cube(clean=True)).volume == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sp.OuterShape.from_trimesh("heel.stl"), "from_trimesh: must be a trimesh.Trimesh, got builtins.str"),
        (
            lambda: sp.OuterShape.from_trimesh(trimesh.creation.box().scene()),
            r"got trimesh.Scene; join its parts with mesh.to_mesh\(\)",
        ),
        (
            lambda: sp.OuterShape.from_pyvista(mixed().to_pyvista()),
            r"must be a pyvista.PolyData, got pyvista.UnstructuredGrid; take mesh.extract_surface\(\)",
        ),
        (lambda: sp.SurfaceMesh.from_pyvista(pyvista.Line()), "must hold faces and nothing else, but it has 1 lines"),
        (lambda: sp.SurfaceMesh.from_pyvista(pyvista.Sphere().strip()), r"strips; take mesh.triangulate\(\)"),
        (lambda: sp.SurfaceMesh.from_pyvista(pyvista.PolyData()), "but it has no faces"),
        (
            lambda: sp.VolumeMesh.from_pyvista(pyvista.Cube()),
            "must be a pyvista.UnstructuredGrid, got pyvista.PolyData$",
        ),
        (
            lambda: sp.VolumeMesh.from_pyvista(pyvista.ImageData(dimensions=(2, 2, 2))),
            r"take mesh.cast_to_unstructured_grid\(\)",
        ),
        (
            lambda: sp.VolumeMesh.from_pyvista(pyvista.ImageData(dimensions=(2, 2, 2)).cast_to_unstructured_grid()),
            "it has cells of type VOXEL",
        ),
        (lambda: sp.VolumeMesh.from_pyvista(pyvista.UnstructuredGrid()), "must have at least one cell"),
    ],
)
def test_what_cannot_be_converted_says_so_and_the_way_in(make, message):
    with pytest.raises(sp.StageError, match=message):
        make()


def test_a_mesh_that_is_not_in_mm_is_refused():
    mesh = trimesh.creation.box()
    mesh.units = "inch"
    with pytest.raises(sp.StageError, match=r"must be in mm, got 'inch'; call mesh.convert_units\('mm'\) first"):
        sp.OuterShape.from_trimesh(mesh)
    mesh.convert_units("mm")
    assert sp.OuterShape.from_trimesh(mesh).volume == pytest.approx(25.4**3)


def test_an_open_or_inside_out_outer_shape_is_refused_with_the_remedy():
    box = trimesh.creation.box()
    with pytest.raises(sp.StageError, match=r"must be closed and .* but 3 of 33 triangle sides have no neighbour"):
        sp.OuterShape(box.vertices, box.faces[1:])
    with pytest.raises(sp.StageError, match=r"face inward: turn them, as in faces\[:, ::-1\]"):
        sp.OuterShape(box.vertices, box.faces[:, ::-1])
    one_turned = np.concatenate([box.faces[:1, ::-1], box.faces[1:]])
    with pytest.raises(sp.StageError, match="must be closed"):
        sp.OuterShape(box.vertices, one_turned)
    with pytest.raises(sp.StageError, match=r"OuterShape.vertices: must be finite, but 1 values are NaN"):
        sp.OuterShape(np.where(np.arange(24).reshape(8, 3) == 5, np.nan, box.vertices), box.faces)


def test_boxes_that_touch_along_an_edge_are_closed():
    one, other = trimesh.creation.box(), trimesh.creation.box()
    other.apply_translation((1.0, 1.0, 0.0))
    both = trimesh.util.concatenate([one, other])
    both.merge_vertices()
    assert len(both.vertices) == 14
    assert sp.OuterShape.from_trimesh(both).volume == pytest.approx(2.0)


def test_cells_of_all_kinds_go_to_pyvista_and_back():
    mesh = mixed()
    grid = mesh.to_pyvista()
    volumes = grid.compute_cell_sizes()["Volume"]
    assert (volumes > 0.0).all()
    assert volumes.sum() == pytest.approx(mesh.volume)
    back = sp.VolumeMesh.from_pyvista(grid)
    assert {kind: cells.tolist() for kind, cells in back.cells.items()} == {
        kind: cells.tolist() for kind, cells in mesh.cells.items()
    }


def test_points_and_faces_beside_solid_cells_are_left_out():
    points = np.array([[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    grid = pyvista.UnstructuredGrid(
        {number: np.array(cells) for number, cells in ((1, [[0]]), (5, [[1, 2, 3]]), (10, [[1, 2, 3, 4]]))}, points
    )
    mesh = sp.VolumeMesh.from_pyvista(grid)
    assert mesh.vertices.shape == (4, 3)
    assert mesh.tetrahedra.tolist() == [[0, 1, 2, 3]]


def test_a_planar_mesh_goes_to_pyvista_and_back():
    mesh = sp.stages.make_planar_mesh(shape="quadrangles", counts=(2, 2), edge=3.0)
    back = sp.PlanarMesh.from_pyvista(mesh.to_pyvista())
    assert back.area == pytest.approx(mesh.area)
    assert back.cells.keys() == mesh.cells.keys()


def test_a_field_keeps_its_places_in_pyvista():
    values = np.arange(24.0).reshape(2, 3, 4)
    image = sp.ScalarField(values, (1.0, 2.0, 3.0), 0.5).to_pyvista()
    at = image.find_closest_point((1.5, 2.5, 4.0))
    assert image.point_data["field"][at] == values[1, 1, 2]
    assert image.bounds == pytest.approx((1.0, 1.5, 2.0, 3.0, 3.0, 4.5))


def test_artifacts_show_their_facts_with_all_texts_escaped():
    outer = sp.stages.make_shape(shape="box", facet=20.0)
    shown = outer._repr_html_()
    assert "<strong>OuterShape</strong>" in shown
    assert "<th>triangles</th>" in shown
    metrics = sp.Metrics({"<b>": "<i>", "porosity": 0.123456, "open": True}, ("manifold: <u>no</u>",))
    shown = metrics._repr_html_()
    assert "quality: <strong>FAILED</strong>" in shown
    assert "0.1235" in shown
    assert "<td>yes</td>" in shown
    assert not [tag for tag in ("<b>", "<i>", "<u>") if tag in shown]
    assert "quality: <strong>pass</strong>" in sp.Metrics({})._repr_html_()
    assert "and 10 more" in sp.Metrics({str(number): number for number in range(50)})._repr_html_()
    assert Certificate([0.0], [1.0])._repr_html_() == "<div><strong>Certificate</strong></div>"
