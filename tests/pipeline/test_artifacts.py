from __future__ import annotations

import numpy as np
import pytest

from scaffold_pipeline.artifacts import (
    Certificate,
    IsoSurface,
    Metrics,
    OuterShape,
    PlanarMesh,
    ScalarField,
    Solid,
    SurfaceMesh,
    VolumeMesh,
    WrittenFiles,
)
from scaffold_pipeline.errors import StageError

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def test_an_artifact_owns_and_locks_its_arrays():
    vertices = CORNERS.copy()
    mesh = SurfaceMesh(vertices, OUTWARD)
    vertices[0] = 9.0
    assert mesh.vertices[0].tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1.0


def test_a_locked_array_is_taken_as_it_is():
    first = SurfaceMesh(CORNERS, OUTWARD)
    assert SurfaceMesh(first.vertices, first.faces).vertices is first.vertices


@pytest.mark.parametrize(
    "vertices", [CORNERS.astype(np.float32), CORNERS.astype(np.int16), np.asfortranarray(CORNERS), CORNERS[::-1][::-1]]
)
def test_a_locked_array_of_another_type_or_order_is_converted(vertices: np.ndarray):
    vertices.setflags(write=False)
    faces = OUTWARD.astype(np.uint32)
    faces.setflags(write=False)
    mesh = SurfaceMesh(vertices, faces)
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    assert mesh.vertices.flags.c_contiguous
    assert mesh.volume == pytest.approx(1.0 / 6.0)


@pytest.mark.parametrize(
    ("vertices", "faces", "rule"),
    [
        (CORNERS[:, :2], OUTWARD, r"SurfaceMesh.vertices: must have shape \('n', 3\), got \(4, 2\)"),
        (CORNERS.ravel(), OUTWARD, r"SurfaceMesh.vertices: must have shape \('n', 3\), got \(12,\)"),
        (CORNERS, OUTWARD[None], r"SurfaceMesh.faces: must have shape \('n', 3\), got \(1, 4, 3\)"),
        (CORNERS, OUTWARD.astype(float), "SurfaceMesh.faces: must hold int64, got float64"),
        (CORNERS.astype(complex), OUTWARD, "SurfaceMesh.vertices: must hold float64, got complex128"),
        (CORNERS, OUTWARD + 1, r"SurfaceMesh.faces: indices must lie in 0..3, got 1..4"),
        (CORNERS, OUTWARD - 1, r"SurfaceMesh.faces: indices must lie in 0..3, got -1..2"),
        (
            CORNERS * [np.nan, 1.0, 1.0],
            OUTWARD,
            "SurfaceMesh.vertices: must be finite, but 4 values are NaN or infinite",
        ),
        (
            CORNERS + np.array([np.inf, 0.0, 0.0]),
            OUTWARD,
            "SurfaceMesh.vertices: must be finite, but 4 values are NaN or infinite",
        ),
    ],
)
def test_an_array_that_does_not_fit_is_refused(vertices: np.ndarray, faces: np.ndarray, rule: str):
    with pytest.raises(StageError, match=rule):
        SurfaceMesh(vertices, faces)


def test_volume_and_area_are_those_of_the_tetrahedron_wherever_it_lies():
    for place in (0.0, 1e6):
        mesh = SurfaceMesh(CORNERS + place, OUTWARD)
        assert mesh.volume == pytest.approx(1.0 / 6.0, rel=1e-6)
        assert mesh.area == pytest.approx(1.5 + np.sqrt(3.0) / 2.0, rel=1e-6)


def test_an_outer_shape_and_a_solid_must_enclose_a_volume():
    shape = OuterShape(CORNERS, OUTWARD, notes=("made",), facts={"holes": 3}).summary()
    assert (shape["notes"], shape["holes"]) == ("made", 3)
    for kind in (OuterShape, Solid):
        with pytest.raises(StageError, match=f"{kind.__name__}: must enclose a positive volume"):
            kind(CORNERS, OUTWARD[:, ::-1])
    with pytest.raises(StageError, match="got 0 triangles"):
        Solid(np.empty((0, 3)), np.empty((0, 3), int))


def test_an_empty_surface_has_a_summary():
    summary = SurfaceMesh(np.empty((0, 3)), np.empty((0, 3), int)).summary()
    assert (summary["triangles"], summary["volume_mm3"], summary["size_x"]) == (0, 0.0, 0.0)


def test_a_volume_mesh_tells_its_cells_edges_and_volume():
    mesh = VolumeMesh(CORNERS, np.array([[0, 1, 2, 3]]), facts={"maker": "hand"})
    assert {kind: cells.tolist() for kind, cells in mesh.cells.items()} == {"tetrahedron": [[0, 1, 2, 3]]}
    assert mesh.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert mesh.volume == pytest.approx(1.0 / 6.0)
    assert mesh.summary()["maker"] == "hand"
    assert mesh.summary()["edge_length_mean"] == pytest.approx((3.0 + 3.0 * np.sqrt(2.0)) / 6.0)


@pytest.mark.parametrize(
    ("vertices", "tetrahedra", "rule"),
    [
        (CORNERS, [[1, 0, 2, 3]], r"must have a positive volume, but 1 of 1 do not \(the first is cell 0\)"),
        (CORNERS * [1.0, 1.0, 0.0], [[0, 1, 2, 3]], "must have a positive volume"),
        (np.vstack([CORNERS, CORNERS[:1]]), [[0, 1, 2, 3]], "every vertex must belong to a cell, 1 do not"),
        (CORNERS, np.empty((0, 4), int), "must have at least one cell, got none"),
        (CORNERS, [[0, 1, 2, 4]], r"VolumeMesh.tetrahedra: indices must lie in 0..3, got 0..4"),
        (np.empty((0, 3)), np.empty((0, 4), int), "must have at least one cell, got none"),
        (CORNERS * [1.0, np.nan, 1.0], [[0, 1, 2, 3]], "VolumeMesh.vertices: must be finite, but 4 values are NaN"),
        (CORNERS + np.array([np.inf, 0.0, 0.0]), [[0, 1, 2, 3]], "VolumeMesh.vertices: must be finite"),
        (CORNERS * 1e150, [[0, 1, 2, 3]], "must have a positive volume, but 1 of 1 do not"),  # beyond float64
        (CORNERS, [[0, 1, 2, 2]], r"every cell must have distinct corners, but 1 of 1 do not \(the first is cell 0\)"),
        (CORNERS, [[0, 1, 2, 3], [1, 2, 0, 3]], "VolumeMesh: a face must have one cell on each side at most, but 4 "),
    ],
)
def test_a_volume_mesh_that_is_not_sound_is_refused(vertices: np.ndarray, tetrahedra: object, rule: str):
    with pytest.raises(StageError, match=rule):
        VolumeMesh(vertices, np.asarray(tetrahedra))


def test_a_hexahedron_that_stands_for_a_wedge_is_refused():
    base = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = np.vstack([np.insert(base, 2, 0.0, axis=1), [[0, 0.5, 1], [1, 0.5, 1]]])
    with pytest.raises(StageError, match=r"VolumeMesh.hexahedra: every cell must have distinct corners, but 1 of 1"):
        VolumeMesh(vertices, hexahedra=np.array([[0, 1, 2, 3, 4, 5, 5, 4]]))
    assert VolumeMesh(vertices, wedges=np.array([[0, 3, 4, 1, 2, 5]])).volume == pytest.approx(0.5)


@pytest.mark.parametrize("place", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_volume_mesh_is_sound_in_any_unit_and_far_away(scale: float, place: float):
    mesh = VolumeMesh(scale * (CORNERS + place), np.array([[0, 1, 2, 3]]))
    assert mesh.volume == pytest.approx(scale**3 / 6.0, rel=1e-6)
    with pytest.raises(StageError, match="must have a positive volume, but 1 of 1 do not"):
        VolumeMesh(scale * (CORNERS + place), np.array([[1, 0, 2, 3]]))


def test_cells_of_separate_bodies_and_of_bodies_that_touch_make_one_mesh():
    for place in (5.0, 1.0):  # the second has a vertex at the place of one of the first
        vertices = np.vstack([CORNERS, CORNERS + np.array([place, 0.0, 0.0])])
        mesh = VolumeMesh(vertices, np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
        assert mesh.volume == pytest.approx(1.0 / 3.0)
        assert mesh.summary()["vertices"] == 8


def test_a_planar_mesh_tells_its_tiles_edges_area_and_plane():
    places = np.array([[0, 0, 3], [2, 0, 3], [2, 2, 3], [0, 2, 3], [3, 1, 3]], float)
    mesh = PlanarMesh(places, np.array([[1, 4, 2]]), np.array([[0, 1, 2, 3]]), facts={"maker": "hand"})
    assert {kind: len(cells) for kind, cells in mesh.cells.items()} == {"triangle": 1, "quadrangle": 1}
    assert mesh.edges.tolist() == [[0, 1], [0, 3], [1, 2], [1, 4], [2, 3], [2, 4]]
    assert (mesh.area, mesh.z) == (5.0, 3.0)
    summary = mesh.summary()
    assert (summary["cells"], summary["area_mm2"], summary["maker"]) == (2, 5.0, "hand")
    assert summary["edge_length_mean"] == pytest.approx((8.0 + 2.0 * np.sqrt(2.0)) / 6.0)


SQUARE = np.array([[0, 0, 3], [1, 0, 3], [1, 1, 3], [0, 1, 3]], float)


@pytest.mark.parametrize(
    ("vertices", "quadrangles", "rule"),
    [
        (
            SQUARE,
            [[0, 3, 2, 1]],
            "PlanarMesh.quadrangles: every cell must have a positive area, its corners counter-cl",
        ),
        (SQUARE * [1.0, 0.0, 1.0], [[0, 1, 2, 3]], "must have a positive area"),
        (SQUARE, [[0, 1, 2, 2]], "every cell must have distinct corners, but 1 of 1 do not"),
        (
            SQUARE * [[1], [1], [1], [0.5]],
            [[0, 1, 2, 3]],
            "PlanarMesh.vertices: must all have one z, but it runs from 1.5",
        ),
        (SQUARE[:, [2, 0, 1]], [[0, 1, 2, 3]], "must all have one z, but it runs from 0 to 1 mm"),
        (np.vstack([SQUARE, [[5, 5, 3]]]), [[0, 1, 2, 3]], "every vertex must belong to a cell, 1 do not"),
        (SQUARE, [[0, 1, 2, 3], [1, 2, 3, 0]], "a face must have one cell on each side at most, but 4 have more"),
        (SQUARE, np.empty((0, 4), int), "PlanarMesh: must have at least one cell, got none"),
        (SQUARE * [1.0, np.nan, 1.0], [[0, 1, 2, 3]], "PlanarMesh.vertices: must be finite"),
    ],
)
def test_a_planar_mesh_that_is_not_sound_is_refused(vertices: np.ndarray, quadrangles: object, rule: str):
    with pytest.raises(StageError, match=rule):
        PlanarMesh(vertices, quadrangles=np.asarray(quadrangles))


def test_a_quadrangle_may_be_hollow_but_not_crossed():
    hollow = np.array([[0, 3, 0], [-2, -1, 0], [0, 0, 0], [2, -1, 0]], float)
    assert PlanarMesh(hollow, quadrangles=np.array([[0, 1, 2, 3]])).area == pytest.approx(6.0)
    crossed = np.array([[0, 0, 0], [4, 0, 0], [0, 3, 0], [1, 3, 0]], float)
    with pytest.raises(StageError, match="every cell must have sides that do not cross, but 1 of 1 do not"):
        PlanarMesh(crossed, quadrangles=np.array([[0, 1, 2, 3]]))


def test_a_certificate_counts_what_is_thinner_than_two_voxels_and_names_the_voxels_that_would_do():
    channels, struts = np.array([[0.3, -0.2, -0.9]]), np.array([[0.6, 0.7, 0.8], [-0.1, 0.2, 0.9]])
    certificate = Certificate(np.array([-1.0]), np.array([1.0, 1.0]), channels, struts, voxel_size=0.4)
    assert [certificate.at(iso)["under_resolved"] for iso in (-0.5, 0.0, 0.5)] == [1, 2, 1]
    assert certificate.resolving_voxel_size(0.0) == 0.2
    assert certificate.resolving_voxel_size(0.5) == 0.1
    assert certificate.resolving_voxel_size(-0.95) is None


def test_a_certificate_counts_what_is_closed_and_broken_at_an_iso():
    certificate = Certificate(np.array([-0.5, 0.0, 0.2]), np.array([0.1, 0.4]))
    assert certificate.at(0.1) == {
        "channel_max": 0.2,
        "strut_min": 0.1,
        "channels": 3,
        "channels_closed": 1,
        "struts": 2,
        "struts_broken": 1,
        "under_resolved": None,
    }


def test_a_field_keeps_single_precision_and_refuses_what_that_cannot_hold():
    values = np.linspace(-1.0, 1.0, 8).reshape(2, 2, 2)
    field = ScalarField(values, np.zeros(3), 0.5)
    assert field.values.dtype == np.float32
    assert field.summary()["grid"] == "2 x 2 x 2"
    with pytest.raises(StageError, match="must be finite, but 8 values"):
        ScalarField(np.full((2, 2, 2), 1e39), np.zeros(3), 0.5)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.inf, np.nan])
def test_a_field_needs_a_positive_spacing(spacing: float):
    with pytest.raises(StageError, match=r"ScalarField.spacing: must be a positive length"):
        ScalarField(np.zeros((2, 2, 2)), np.zeros(3), spacing)


@pytest.mark.parametrize("shape", [(2, 1, 2), (1, 2, 2), (2, 2, 0)])
def test_a_field_needs_two_samples_along_x_and_y_and_one_along_z(shape: tuple[int, int, int]):
    assert ScalarField(np.zeros((2, 2, 1)), np.zeros(3), 1.0).summary()["grid"] == "2 x 2 x 1"
    with pytest.raises(StageError, match=rf"needs two samples along x and y, one along z, got \({shape[0]}, "):
        ScalarField(np.zeros(shape), np.zeros(3), 1.0)


def test_summaries_tell_what_was_asked_and_done():
    surface = IsoSurface(CORNERS, OUTWARD, iso=0.2, porosity_requested=0.6, facts={"removed": 3})
    assert {**surface.summary(), "iso": 0.2, "porosity_requested": 0.6, "removed": 3} == surface.summary()
    assert Solid(CORNERS, OUTWARD, pore_volumes=np.array([2.0, 1.0])).summary()["pore_pieces"] == 2
    assert WrittenFiles({"stl_bytes": 284}).summary() == {"stl_bytes": 284}


def test_metrics_pass_or_name_the_gates_that_failed():
    assert Metrics({"points": 3}).summary() == {"points": 3, "quality": "pass"}
    assert Metrics({"points": 3}, has_gates=False).summary() == {"points": 3, "quality": "not measured"}
    assert Metrics({}, ("points: too few", "drawn: no")).summary() == {"quality": ["points: too few", "drawn: no"]}


def test_an_artifact_says_what_it_holds_in_one_line():
    shown = repr(OuterShape(CORNERS, OUTWARD, ("a note",), {"repaired": 3}))
    assert shown == "OuterShape(vertices=float64 (4, 3), faces=int64 (4, 3), notes=('a note',), facts={'repaired': 3})"
    measured = Metrics({f"number_{index}": float(index) for index in range(100)})
    assert len(repr(measured)) < 400


def test_what_is_no_array_is_told_by_its_type_and_a_number_that_is_not_finite_by_its_place():
    with pytest.raises(StageError, match=r"got \(\); it is no array but of type NoneType$"):
        SurfaceMesh(None, OUTWARD)
    with pytest.raises(StageError, match=r"1 values are NaN or infinite, the first at \[1, 2\]$"):
        SurfaceMesh(np.where(np.arange(12).reshape(4, 3) == 5, np.nan, CORNERS), OUTWARD)
    with pytest.raises(StageError, match=r"must hold int64, got float64; convert it: array.astype\('int64'\)$"):
        SurfaceMesh(CORNERS, OUTWARD.astype(float))


def test_triangles_that_disagree_are_told_before_the_sign_of_a_volume_that_says_nothing():
    mixed = np.vstack([OUTWARD[:1], OUTWARD[1:, ::-1]])
    with pytest.raises(
        StageError, match=r"OuterShape: must be closed and consistently oriented, but 6 of 12 triangle sides have no"
    ):
        OuterShape(CORNERS, mixed)
