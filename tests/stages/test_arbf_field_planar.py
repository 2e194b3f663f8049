"""The field of planar meshes: one layer of samples, against oracles, and what a plane has to do with a body."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from geometry.fields.oracle import Elements, Floats, between, phi, to_segment
from geometry.fields.shepard_oracle import Net, shepard
from scaffold_pipeline.artifacts import CellMesh, OuterShape, PlanarMesh, ScalarField, VolumeMesh
from scaffold_pipeline.errors import StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from scaffold_stages.isosurface import IsosurfaceParams, isosurface
from scaffold_stages.jitter import jitter
from scaffold_stages.write_field import WriteFieldParams, write_field
from shapes import box, tetrahedra

Z = 4.0
SQUARE = PlanarMesh(np.array([(-1, -1, Z), (1, -1, Z), (1, 1, Z), (-1, 1, Z)]), quadrangles=np.array([(0, 1, 2, 3)]))
GRID = {"origin": (-1.0, -1.0, Z), "spacing": 1 / 16, "shape": (33, 33, 1)}


def four_squares() -> PlanarMesh:
    lattice = np.array([(x, y, Z) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    return PlanarMesh(lattice, quadrangles=np.array([0, 1, 3, 4])[:, None] + [0, 1, 4, 3])


def crooked() -> PlanarMesh:
    """A quadrangle with triangles on two of its sides and a hollow quadrangle on a third."""
    places = [(0, 0), (2, 0.1), (2.2, 1.9), (0, 2), (3, 1), (1, 3), (1, -0.8), (-0.2, -2), (2.1, -1.9)]
    corners = np.array([(x, y, Z) for x, y in places])
    return PlanarMesh(corners, np.array([(1, 4, 2), (3, 2, 5), (0, 6, 1)]), np.array([(0, 1, 2, 3), (0, 7, 8, 6)]))


def field_of(mesh: CellMesh, outer: OuterShape | None = None, **given: object) -> ScalarField:
    return arbf_field(mesh, outer, params=ArbfFieldParams.model_validate(given))


def places(field: ScalarField) -> Floats:
    """Where the samples lie, (n, 3) mm."""
    nodes = np.stack(np.meshgrid(*map(np.arange, field.values.shape), indexing="ij"), -1).reshape(-1, 3)
    return field.origin + field.spacing * nodes


def walk(mesh: PlanarMesh) -> tuple[list[tuple[int, int]], list[tuple[Floats, Floats, list[int]]]]:
    """The edges of a mesh, each once, and its channels with the tile that each is of: tile by tile."""
    edges, channels = [], []
    for tile in chain(mesh.triangles.tolist(), mesh.quadrangles.tolist()):
        for a, b in zip(tile, tile[1:] + tile[:1], strict=True):
            edges += [(a, b)] if (a, b) not in edges and (b, a) not in edges else []
            channels.append((mesh.vertices[tile].mean(axis=0), mesh.vertices[[a, b]].mean(axis=0), tile))
    return edges, channels


def exact_oracle(mesh: PlanarMesh, c: float, points: Floats) -> Floats:
    edges, channels = walk(mesh)
    middles = [mesh.vertices[list(edge)].mean(axis=0) for edge in edges]
    centres = np.unique([start for start, _, _ in channels], axis=0)
    dots = np.vstack([mesh.vertices, middles, centres])
    starts, ends = (np.vstack([dots, [channel[end] for channel in channels]]) for end in (0, 1))
    values = np.where(np.arange(len(starts)) < len(mesh.vertices), 1.0, -1.0)
    elements = Elements(starts, ends, values, len(channels))
    weights = np.linalg.solve(phi("inverse_multiquadric", between(elements, "endpoint-to-segment"), c), values)
    return phi("inverse_multiquadric", to_segment(points[:, None], starts, ends), c) @ weights


def net_of(mesh: PlanarMesh) -> Net:
    edges, channels = walk(mesh)
    lengths = {edge: float(np.linalg.norm(np.subtract(*mesh.vertices[list(edge)]))) for edge in edges}
    size = [np.mean([lengths[edge] for edge in edges if vertex in edge]) for vertex in range(len(mesh.vertices))]
    rows = [(*mesh.vertices[list(edge)], 1.0, (size[edge[0]] + size[edge[1]]) / 2) for edge in edges]
    rows += [(start, end, -1.0, np.mean([size[corner] for corner in tile])) for start, end, tile in channels]
    return Net(*(np.array(column) for column in zip(*rows, strict=True)))


@pytest.mark.parametrize("make", [lambda: SQUARE, four_squares, crooked])
def test_the_exact_field_equals_the_oracle(make):
    mesh = make()
    field = field_of(mesh, voxel_size=0.11, interpolation="exact")
    edges, channels = walk(mesh)
    tile_count = len(mesh.triangles) + len(mesh.quadrangles)
    assert field.facts["unknowns"] == len(mesh.vertices) + len(edges) + tile_count + len(channels)
    assert field.facts["negative_eigenvalues"] == len(channels)
    inner, values = places(field), field.values.ravel()
    inner, values = inner[values > -1.0], values[values > -1.0]  # two pixels outside it is void by order
    assert len(values) > 300
    np.testing.assert_allclose(values, exact_oracle(mesh, 0.1, inner), rtol=0, atol=1e-6)


@pytest.mark.parametrize("make", [lambda: SQUARE, four_squares, crooked])
def test_the_normalised_field_equals_the_oracle(make):
    mesh = make()
    field = field_of(mesh, voxel_size=0.07)
    assert np.abs(field.values).max() <= 1.0
    inner, values = places(field), field.values.ravel()
    inner, values = inner[values > -1.0], values[values > -1.0]
    assert len(values) > 300
    np.testing.assert_allclose(values, shepard(net_of(mesh), inner, 0.01, 4, 1.0), rtol=0, atol=1e-5)


def test_the_exact_field_of_a_square_has_its_symmetries(tmp_path: Path):
    some = np.random.default_rng(2).uniform(-1.0, 1.0, (40, 2))
    images = [some * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))]
    images += [image[:, ::-1] for image in images]
    path = tmp_path / "points.csv"
    np.savetxt(path, np.insert(np.concatenate(images), 2, Z, axis=1), delimiter=",")
    field = field_of(SQUARE, grid=GRID, interpolation="exact", points=path)
    for image in field.point_values.reshape(8, 40):
        np.testing.assert_allclose(image, field.point_values[:40], rtol=0, atol=1e-9)
    plane = field.values[:, :, 0]
    for image in (plane[::-1], plane[:, ::-1], plane.T):
        np.testing.assert_allclose(image, plane, rtol=0, atol=1e-6)
    assert plane[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(1.0)
    assert plane[16, [0, 16, 32]] == pytest.approx(-1.0)
    assert plane[16].max() < -0.95  # two channels, from edge to edge


def test_the_normalised_field_is_solid_on_edges_and_void_on_channels_but_where_they_meet():
    plane = field_of(four_squares(), grid=GRID).values[:, :, 0]
    assert plane.min() >= -1.0
    assert plane.max() <= 1.0
    off_middle = np.abs(np.abs(np.arange(33) - 16) - 8) > 2  # of an edge, where the channels of its tiles end
    assert plane[:, [0, 16, 32]][off_middle].min() > 0.99
    assert plane[[0, 16, 32]][:, off_middle].min() > 0.99
    along = np.abs((np.arange(33) + 8) % 16 - 8) > 2  # a channel, but for its end on an edge
    assert plane[8, along].max() < -0.99
    assert plane[along, 24].max() < -0.99
    assert plane[8, [0, 16, 32]] == pytest.approx([0.0, -1 / 3, 0.0], abs=1e-4)  # one strut against one, two channels


def test_solid_vertices_leave_the_edges_to_the_channels():
    field = field_of(four_squares(), grid=GRID, solid="vertices")
    plane = field.values[:, :, 0]
    assert plane[::16, ::16] == pytest.approx(1.0, abs=1e-4)
    assert plane[8] == pytest.approx(-1.0, abs=1e-4)
    assert field.certificate is not None
    assert field.certificate.channel_max == pytest.approx(-1.0, abs=1e-4)


def test_no_iso_opens_all_channels_of_a_plane_and_keeps_all_its_struts():
    certificate = field_of(four_squares(), voxel_size=0.1).certificate
    assert certificate is not None
    assert certificate.channel_max == pytest.approx(0.0, abs=1e-4)
    assert certificate.strut_min == pytest.approx(-1 / 3, abs=1e-4)
    assert certificate.at(-0.5)["struts_broken"] == certificate.at(0.5)["channels_closed"] == 0


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e6)])
def test_neither_unit_nor_place_changes_a_planar_field(scale: float, offset: float):
    mesh = crooked()
    moved = PlanarMesh(scale * mesh.vertices + offset, mesh.triangles, mesh.quadrangles)
    one, other = field_of(mesh, voxel_size=0.093), field_of(moved, voxel_size=0.093 * scale)
    is_known = (one.values > -1.0) & (other.values > -1.0)  # a pixel on the rim may count as outside in one of them
    assert is_known.mean() > 0.5
    np.testing.assert_allclose(other.values[is_known], one.values[is_known], rtol=0, atol=1e-5)


def test_a_voxel_size_makes_one_layer_in_the_plane():
    field = field_of(SQUARE, voxel_size=0.1)
    assert field.values.shape == (27, 27, 1)
    assert field.origin == pytest.approx([-1.3, -1.3, Z])
    assert field.summary()["grid"] == "27 x 27 x 1"


@pytest.mark.parametrize(("z", "layers"), [(Z + 0.01, 1), (0.0, 1), (Z, 2), (Z - 0.5, 17)])
def test_a_grid_off_the_plane_or_of_several_layers_is_an_error(z: float, layers: int):
    with pytest.raises(StageError, match=rf"in its plane, z = 4 mm, got {layers} from .* end origin with 4 and shape"):
        field_of(SQUARE, grid={**GRID, "origin": (-1.0, -1.0, z), "shape": (33, 33, layers)})


def test_an_outer_shape_cuts_a_planar_field_where_the_plane_meets_it():
    half = OuterShape(*box((-1.0, -1.0, 0.0), (0.0, 1.0, 9.0)))
    with pytest.warns(UserWarning, match="does not cover"):
        field = field_of(SQUARE, half, grid={**GRID, "origin": (-0.9, -0.9, Z)})
    assert (field.values[18:] == -1.0).all()
    assert field.values[:14].max() > 0.9


def test_a_support_that_leaves_pixels_of_a_tile_to_one_sign_is_an_error():
    with pytest.raises(StageError, match=r"^support: \d+ of \d+ samples .* raise support"):
        field_of(SQUARE, voxel_size=0.1, support=0.1)


def test_a_planar_field_is_written_and_read_by_others(tmp_path: Path):
    import pyvista

    field = field_of(four_squares(), grid=GRID)
    write_field(field, params=WriteFieldParams(), out=tmp_path)
    image = pyvista.read(tmp_path / "field.vti")
    assert image.dimensions == (33, 33, 1)
    assert image.origin == (-1.0, -1.0, Z)
    np.testing.assert_array_equal(image.point_data["s"].reshape((33, 33, 1), order="F"), field.values)
    np.testing.assert_array_equal(np.load(tmp_path / "field.npy"), field.values)
    assert b"sizes: 33 33 1\n" in (tmp_path / "field.nrrd").read_bytes()


def test_a_planar_mesh_does_not_fit_where_a_body_is_read():
    reads = {
        name: stage_from_function(name, stage).reads["mesh"].type
        for name, stage in (("jitter", jitter), ("arbf_field", arbf_field))
    }
    assert not issubclass(PlanarMesh, reads["jitter"])
    assert issubclass(PlanarMesh, reads["arbf_field"])
    assert issubclass(VolumeMesh, reads["arbf_field"])


def test_a_mesh_of_solid_cells_needs_its_outer_shape():
    with pytest.raises(StageError, match="outer: is required unless the mesh is planar"):
        field_of(tetrahedra((1, 1, 1)), voxel_size=0.2)


def test_a_section_through_a_solid_mesh_is_a_layer_of_its_field_and_bounds_no_solid():
    mesh, outer = tetrahedra((1, 1, 1)), OuterShape(*box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    grid = {"origin": (-0.25, -0.25, -0.25), "spacing": 1 / 16, "shape": (25, 25, 25)}
    whole = field_of(mesh, outer, grid=grid)
    with pytest.warns(UserWarning, match="does not cover"):
        section = field_of(mesh, outer, grid={**grid, "origin": (-0.25, -0.25, 0.3125), "shape": (25, 25, 1)})
    np.testing.assert_allclose(section.values[:, :, 0], whole.values[:, :, 9], rtol=0, atol=1e-5)
    with pytest.raises(StageError, match="the field is one layer of samples, which bounds no solid"):
        isosurface(section, outer, params=IsosurfaceParams(iso=0.0))
