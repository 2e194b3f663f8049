"""What bounds a solid loads, cleaned and in mm; all else is one clear line."""

from __future__ import annotations

import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.load_surface import LoadSurfaceParams, load_surface

DATA = Path(__file__).parents[2].parent / "shared" / "data"
CORNERS = np.array([(x, y, z) for z in (0.0, 4.0) for y in (0.0, 4.0) for x in (0.0, 4.0)])
FACES = np.array(
    [
        *((0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4)),
        *((2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)),
    ]
)
"""A cube of side 4, wound outward."""


def rows_of(table: np.ndarray, pattern: str):
    return "".join(pattern.format(*row) + "\n" for row in table)


def as_binary_stl(corners: np.ndarray, faces: np.ndarray, announced: int | None = None):
    facets = [struct.pack("<12fH", 0, 0, 0, *corners[face].ravel(), 0) for face in faces]
    return b" " * 80 + struct.pack("<I", len(faces) if announced is None else announced) + b"".join(facets)


def as_ascii_stl(corners: np.ndarray, faces: np.ndarray):
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    facets = [facet.format(rows_of(corners[face], "vertex {} {} {}")) for face in faces]
    return f"solid cube\n{''.join(facets)}endsolid cube\n"


def as_obj(corners: np.ndarray, faces: np.ndarray):
    return rows_of(corners, "v {} {} {}") + rows_of(faces + 1, "f {} {} {}")


def as_off(corners: np.ndarray, faces: np.ndarray):
    counts = f"OFF\n# a comment\n{len(corners)} {len(faces)} 0\n"
    return counts + rows_of(corners, "{} {} {}") + rows_of(faces, "3 {} {} {}")


def as_ply(corners: np.ndarray, faces: np.ndarray):
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header + rows_of(corners, "{} {} {}") + rows_of(faces, "3 {} {} {}")


def as_vtk(corners: np.ndarray, faces: np.ndarray):
    header = f"# vtk DataFile Version 3.0\ncube\nASCII\nDATASET POLYDATA\nPOINTS {len(corners)} double\n"
    polygons = f"POLYGONS {len(faces)} {4 * len(faces)}\n"
    return header + rows_of(corners, "{} {} {}") + polygons + rows_of(faces, "3 {} {} {}")


def as_vtp(corners: np.ndarray, faces: np.ndarray):
    def array(kind: int, name: str, values: int, width: int = 1):
        numbers = " ".join(str(value) for value in np.ravel(values))
        opening = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="ascii">'
        return f"{opening}{numbers}</DataArray>"

    connectivity, offsets = array("Int64", "connectivity", faces), array("Int64", "offsets", range(3, 37, 3))
    return (
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"><PolyData>'
        f'<Piece NumberOfPoints="{len(corners)}" NumberOfPolys="{len(faces)}">'
        f"<Points>{array('Float64', 'Points', corners, 3)}</Points><Polys>{connectivity}{offsets}</Polys>"
        "</Piece></PolyData></VTKFile>"
    )


def write_3mf(path: Path, corners: np.ndarray, faces: np.ndarray, unit: str):
    vertices = rows_of(corners, '<vertex x="{}" y="{}" z="{}"/>')
    triangles = rows_of(faces, '<triangle v1="{}" v2="{}" v3="{}"/>')
    model = (
        f'<model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>'
        '</object></resources><build><item objectid="1" transform="1 0 0 0 1 0 0 0 1 7 0 0"/></build></model>'
    )
    relation = (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
        'Target="/3D/3dmodel.model" Id="rel0" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("3D/3dmodel.model", model)
        package.writestr("_rels/.rels", relation)


WRITERS = {
    "binary.stl": as_binary_stl,
    "ascii.stl": as_ascii_stl,
    "blank_first_line.stl": lambda corners, faces: "\n" + as_ascii_stl(corners, faces),
    "cube.obj": as_obj,
    "cube.off": as_off,
    "cube.ply": as_ply,
    "cube.vtk": as_vtk,
    "cube.vtp": as_vtp,
}


def written(path: Path, content: str | bytes):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def loaded(path: Path, units: str | None = "mm", **given: object):
    return load_surface(params=LoadSurfaceParams.model_validate({"path": path, "units": units, **given}))


def refused_as_it_is(path: Path, said: str, **given: object):
    """Load a surface without any repair, and require that it is refused by such a line."""
    with pytest.raises(StageError, match=said):
        loaded(path, repair="none", **given)


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("load_surface", load_surface)
    assert (declared.writes, declared.reads) == ("outer", {})


@pytest.mark.parametrize("name", WRITERS)
def test_each_format_loads_as_the_same_cube(tmp_path: Path, name: str):
    outer = loaded(written(tmp_path / name, WRITERS[name](CORNERS, FACES)))
    assert (len(outer.vertices), len(outer.faces)) == (8, 12)
    assert outer.volume == pytest.approx(64.0)


def test_a_3mf_brings_its_unit_and_its_transforms(tmp_path: Path):
    write_3mf(tmp_path / "cube.3mf", CORNERS, FACES, "inch")
    outer = loaded(tmp_path / "cube.3mf", units=None)
    np.testing.assert_allclose(outer.bounds, [[7 * 25.4, 0, 0], [11 * 25.4, 4 * 25.4, 4 * 25.4]])
    assert any("unit inch (from the file)" in note for note in outer.notes)


def test_a_glb_is_in_metres_and_its_split_vertices_are_merged(tmp_path: Path):
    import trimesh

    trimesh.Trimesh(CORNERS[FACES].reshape(-1, 3) / 100, np.arange(36).reshape(-1, 3), process=False).export(
        tmp_path / "cube.glb"
    )
    outer = loaded(tmp_path / "cube.glb", units=None)
    assert (len(outer.vertices), outer.volume) == (8, pytest.approx(64_000.0, rel=1e-5))


@pytest.mark.parametrize(("up", "moved"), [(None, True), ("y", True), ("z", False)])
def test_a_glb_is_turned_to_z_up_unless_it_is_said_to_be_so(tmp_path: Path, up: str | None, moved: bool):  # noqa: FBT001
    import trimesh

    trimesh.Trimesh(CORNERS / 100 * [1.0, 2.0, 3.0], FACES, process=False).export(tmp_path / "cube.glb")
    outer = loaded(tmp_path / "cube.glb", units=None, up=up)
    low, high = outer.bounds
    wanted = ([0, -120, 0], [40, 0, 80]) if moved else ([0, 0, 0], [40, 80, 120])
    np.testing.assert_allclose([low, high], wanted, atol=1e-4)
    assert any("turned so that y" in note for note in outer.notes) == moved


def test_any_file_may_be_said_to_have_y_up(tmp_path: Path):
    path = written(tmp_path / "cube.off", as_off(CORNERS * [1.0, 2.0, 3.0], FACES))
    np.testing.assert_allclose(loaded(path, up="y").bounds, [[0, -12, 0], [4, 0, 8]])
    np.testing.assert_allclose(loaded(path).bounds, [[0, 0, 0], [4, 8, 12]])


@pytest.mark.parametrize("name", ["far.stl", "far.off", "far.obj", "far.ply"])
def test_coordinates_that_no_body_has_are_refused_with_the_number(tmp_path: Path, name: str):
    far = np.where(CORNERS > 3, 3e38, CORNERS)
    content = {"stl": as_binary_stl, "off": as_off, "obj": as_obj, "ply": as_ply}[name[-3:]](far, FACES)
    with pytest.raises(
        StageError, match=r"a vertex is 3e\+38 mm from the origin, at most 1e\+09 mm is accepted; check `units`"
    ):
        loaded(written(tmp_path / name, content))


@pytest.mark.parametrize("space", ["RAS", "LPS"])
def test_anatomical_axes_that_a_header_names_are_facts_of_the_shape(tmp_path: Path, space: str):
    content = f"3D Slicer output. SPACE={space}".encode().ljust(80) + as_binary_stl(CORNERS, FACES)[80:]
    outer = loaded(written(tmp_path / "cube.stl", content))
    assert outer.summary()["space"] == space
    assert any(f"its header gives the axes as {space}; the coordinates are not changed" in note for note in outer.notes)
    assert "space" not in loaded(written(tmp_path / "cube.off", as_off(CORNERS, FACES))).summary()


def test_the_unit_given_wins_over_the_files_with_a_warning(tmp_path: Path):
    write_3mf(tmp_path / "cube.3mf", CORNERS, FACES, "inch")
    with pytest.warns(PipelineWarning, match="the file's unit is inch, but `units` is mm: mm is used"):
        assert loaded(tmp_path / "cube.3mf").volume == pytest.approx(64.0)


def test_a_file_without_a_unit_needs_one(tmp_path: Path):
    path = written(tmp_path / "cube.off", as_off(CORNERS, FACES))
    with pytest.raises(StageError, match=r"does not state its unit; set `units` to mm, cm, m or inch .*4 x 4 x 4"):
        loaded(path, units=None)


@pytest.mark.parametrize(("units", "scale"), [("cm", 10.0), ("inch", 25.4)])
def test_units_scale_to_mm(tmp_path: Path, units: str, scale: float):
    outer = loaded(written(tmp_path / "cube.off", as_off(CORNERS, FACES)), units=units)
    np.testing.assert_allclose(np.ptp(outer.bounds, axis=0), 4 * scale)


@pytest.mark.parametrize(("size", "units"), [(0.1, "mm"), (1.0, "mm"), (4.0, "m")])
def test_an_odd_size_asks_for_the_unit(tmp_path: Path, size: float, units: str):
    path = written(tmp_path / "cube.off", as_off(CORNERS * size / 4, FACES))
    with pytest.warns(PipelineWarning, match="is `units` right"):
        loaded(path, units=units)


def test_polygons_are_cut_into_triangles_also_where_they_are_not_convex(tmp_path: Path):
    outline = [(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)]
    vertices = [(*point, z) for z in (0, 3) for point in outline]
    walls = [f"f {k + 1} {(k + 1) % 5 + 1} {(k + 1) % 5 + 6} {k + 6}" for k in range(5)]
    text = rows_of(vertices, "v {} {} {}") + "\n".join([*walls, "f 5 4 3 2 1", "f -5 -4 -3 -2 -1"]) + "\n"
    outer = loaded(written(tmp_path / "prism.obj", text))
    assert outer.volume == pytest.approx(3 * 10.0)
    assert "cut 7 polygons of more than three corners into triangles" in outer.notes


def test_inverted_and_mixed_windings_are_turned_outward(tmp_path: Path):
    for turned in (range(12), [3, 7]):
        faces = FACES.copy()
        faces[list(turned)] = faces[list(turned)][:, ::-1]
        outer = loaded(written(tmp_path / "cube.off", as_off(CORNERS, faces)))
        assert outer.volume == pytest.approx(64.0)
        assert any("reoriented" in note for note in outer.notes)


def test_what_is_superfluous_is_dropped_by_number(tmp_path: Path):
    corners = np.vstack([CORNERS, CORNERS[:1], [[99.0, 99.0, 99.0]]])
    faces = np.vstack([FACES, FACES[:2], [[0, 8, 1], [1, 1, 2]]])
    outer = loaded(written(tmp_path / "cube.off", as_off(corners, faces)), repair="none")
    assert (len(outer.vertices), len(outer.faces)) == (8, 12)
    for note in (
        "merged 1 coincident vertices",
        "dropped 2 triangles that use a vertex twice",
        "dropped 2 duplicate triangles",
        "dropped 1 vertices that no triangle uses",
    ):
        assert note in outer.notes


def test_the_largest_piece_is_kept_and_the_rest_named(tmp_path: Path):
    path = written(
        tmp_path / "cubes.off",
        as_off(np.vstack([CORNERS / 4 + 9, CORNERS]), np.vstack([FACES, FACES + 8])),
    )
    outer = loaded(path)
    assert outer.volume == pytest.approx(64.0)
    assert "kept the largest of 2 pieces (64 mm^3) and dropped 1 (12 triangles, the largest 1 mm^3)" in outer.notes
    assert loaded(path, component="all").volume == pytest.approx(65.0)


def test_dropping_a_large_piece_warns(tmp_path: Path):
    faces = np.vstack([FACES, FACES + 8])
    path = written(tmp_path / "cubes.off", as_off(np.vstack([CORNERS, CORNERS + 9]), faces))
    with pytest.warns(PipelineWarning, match="set `component: all` to keep every piece"):
        loaded(path)


@pytest.mark.parametrize("step", [1, -1])
def test_a_cavity_stays_a_cavity_even_in_an_inverted_file(tmp_path: Path, step: int):
    faces = np.vstack([FACES, FACES[:, ::-1] + 8])
    path = written(tmp_path / "hollow.off", as_off(np.vstack([CORNERS, CORNERS / 4 + 1.5]), faces[:, ::step]))
    assert loaded(path, component="all").volume == pytest.approx(63.0)


def test_a_body_inside_a_body_is_refused(tmp_path: Path):
    corners = np.vstack([CORNERS, CORNERS / 4 + 1.5])
    path = written(tmp_path / "nested.off", as_off(corners, np.vstack([FACES, FACES + 8])))
    with pytest.raises(StageError, match="1 of 2 pieces are inside another with the same orientation"):
        loaded(path, component="all")


def test_an_open_surface_is_refused(tmp_path: Path):
    path = written(tmp_path / "open.off", as_off(CORNERS, FACES[1:]))
    refused_as_it_is(path, r"open\.off: does not bound a solid: it is open \(3 boundary edges\); set `repair: safe`")


def test_a_non_manifold_edge_is_refused(tmp_path: Path):
    beside = CORNERS + np.array([4.0, 4.0, 0.0])
    path = written(tmp_path / "two.off", as_off(np.vstack([CORNERS, beside]), np.vstack([FACES, FACES + 8])))
    refused_as_it_is(path, "1 edges have more than two faces; set `repair: safe`")


def klein_bottle(n: int = 4):
    """The faces of an n x n grid: one pair of its sides meets as it is, the other turned round."""

    def at(i: int, j: int):
        return (i % n) * n + ((j if i < n else -j) % n)

    halves = [((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))]
    return np.array([[at(i + di, j + dj) for di, dj in half] for i in range(n) for j in range(n) for half in halves])


def test_a_surface_of_one_side_is_refused(tmp_path: Path):
    places = np.random.default_rng(0).random((16, 3)) * 9
    refused_as_it_is(written(tmp_path / "klein.off", as_off(places, klein_bottle())), "it is not orientable")


def test_a_surface_that_passes_through_itself_is_refused(tmp_path: Path):
    dented = CORNERS.copy()
    dented[7] = (-2.0, 1.0, 2.0)
    path = written(tmp_path / "dented.off", as_off(dented, FACES))
    refused_as_it_is(path, r"intersects itself: \d+ triangles intersect others .*; set `repair: safe`")


def test_a_closed_sheet_is_refused(tmp_path: Path):
    flat = CORNERS * [1.0, 1.0, 0.0]
    flat[4:] += [0.5, 0.25, 0.0]
    with pytest.raises(StageError, match="encloses no volume: 1 of 1 pieces are flat"):
        loaded(written(tmp_path / "sheet.off", as_off(flat, FACES)))


HTML = "<!DOCTYPE html><html><body>404</body></html>\n"
DAMAGED = {
    "unknown.step": ("ISO-10303-21;", r"cannot read files of type \.step; export the surface as one of \.3mf, \.glb"),
    "zero.stl": ("", r"zero\.stl: is an empty file \(0 bytes\)"),
    "lying.stl": (as_binary_stl(CORNERS, FACES, announced=20), r"684 bytes, where its header announces 1084 \(20 tri"),
    "short.stl": (as_binary_stl(CORNERS, FACES)[:300], "damaged: 300 bytes, where its header announces 684"),
    "none.stl": (as_binary_stl(CORNERS, FACES[:0]), "has no triangles"),
    "nan.stl": (as_binary_stl(np.where(CORNERS > 3, np.nan, 0.0), FACES), "of 36 vertices are NaN or infinite"),
    "cut.stl": (as_ascii_stl(CORNERS, FACES)[:-200], "ASCII STL is cut off or damaged"),
    "words.stl": (as_ascii_stl(CORNERS, FACES).replace("4.0", "four"), "a vertex must be three numbers"),
    "page.stl": (HTML, "is not an STL file, or damaged"),
    "page.obj": (HTML, r"has no triangles \(it begins with '<!DOCTYPE html"),
    "nan.obj": (as_obj(CORNERS, FACES).replace("4.0", "nan"), "7 of 8 vertices are NaN or infinite"),
    "range.obj": (
        as_obj(CORNERS, FACES) + "f 1 2 99\n",
        r"faces name vertices 0\.\.98, but those of the file are 0\.\.7",
    ),
    "nought.obj": (as_obj(CORNERS, FACES) + "f 0 1 2\n", r"nought\.obj:21: '0' names no vertex"),
    "edge.obj": (as_obj(CORNERS, FACES) + "f 1 2\n", r"edge\.obj:21: a face has 2 corners"),
    "flatland.obj": ("v 0 0\n", r"flatland\.obj:1: a vertex has 2 coordinates"),
    "page.off": (HTML, "is not an ASCII OFF file"),
    "lying.off": (as_off(CORNERS, FACES).replace("8 12", "8 14"), "announces 8 vertices and 14 faces, but 20 rows"),
    "lacking.off": (as_off(CORNERS, FACES).replace("3 0 2 3", "4 0 2 3"), "fewer corners than it announces"),
    "worded.off": (as_off(CORNERS, FACES).replace("3 0 2 3", "3 0 2 x"), "is not a whole number"),
    "page.ply": (HTML, "is not a PLY file"),
    "cut.ply": (as_ply(CORNERS, FACES)[:-30], "announces 20 rows, but 17 follow"),
    "points.ply": (as_ply(CORNERS, FACES[:0]), "has no triangles"),
    "page.3mf": (HTML, "cannot be read as 3MF"),
    "page.glb": (HTML, "cannot be read as GLB"),
    "page.vtk": (HTML, "VTK says: Unrecognized file type"),
    "cut.vtk": (as_vtk(CORNERS, FACES)[:-30], "VTK says: Error reading ascii"),
    "cut.vtp": (as_vtp(CORNERS, FACES)[:-90], "VTK says: Error parsing XML"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_one_clear_line(tmp_path: Path, name: str):
    content, said = DAMAGED[name]
    with pytest.raises(StageError, match=said) as caught:
        loaded(written(tmp_path / name, content))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not re.search(r"0x[0-9a-f]{6}", str(caught.value))


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data is not beside this checkout")
def test_an_inverted_left_patella_loads_outward():
    outer = loaded(DATA / "anatomy" / "bmf_PatellaL.stl", units="m")
    np.testing.assert_allclose(np.ptp(outer.bounds, axis=0), [26.07, 45.32, 46.38], atol=0.01)
    assert outer.volume == pytest.approx(23461, rel=1e-3)
    assert "reoriented 1 pieces that faced the wrong way" in outer.notes


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data is not beside this checkout")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("cgal_cow.off", "touches itself at 1 vertices"),
        ("pymskt_1_RIGHT_femur_Nov_02_2021.vtk", "open .2 boundary edges. and 1 edges have more than two faces"),
        ("trimesh_empty.stl", "has no triangles"),
        ("trimesh_points_ascii.ply", "has no triangles"),
        ("vtkdata_bunny.ply", "open .223 boundary edges."),
    ],
)
def test_real_dirty_files_are_refused_by_their_defect(name: str, said: str):
    refused_as_it_is(DATA / "dirty" / name, said)
