"""Cells of a sound mesh load, cleaned and in mm, from each format; all else is one clear line."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from scaffold_pipeline.artifacts import VolumeMesh
from scaffold_pipeline.artifacts.cells import cell_volumes
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages import load_volume_mesh as module
from scaffold_stages.load_volume_mesh import LoadVolumeMeshParams, load_volume_mesh

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "volume"

POINTS = 4.0 * np.array(
    [
        *((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
        *((2, 0, 0), (2, 0, 1), (0.5, 0.5, 2), (0.5, -1, 1.5)),
    ]
)
CELLS = {
    "hexahedron": [(0, 1, 2, 3, 4, 5, 6, 7)],
    "wedge": [(1, 2, 8, 5, 6, 9)],
    "pyramid": [(4, 5, 6, 7, 10)],
    "tetra": [(4, 5, 10, 11)],
}
"""A cube of side 4 with half a cube beside it, a pyramid upon it and a tetrahedron against the pyramid."""
VOLUMES = {"hexahedra": 64.0, "wedges": 32.0, "pyramids": 64.0 / 3.0, "tetrahedra": 80.0 / 6.0}
BRICKS = {"hexahedron": CELLS["hexahedron"], "wedge": CELLS["wedge"]}
BRICK_POINTS = POINTS[:10]
TWO_TETRAHEDRA = 4.0 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1.0)])


def written(path: Path, content: str):
    path.write_text(content)
    return path


def with_meshio(path: Path, points: np.ndarray = POINTS, cells: dict[str, object] | None = None, **options: object):
    meshio = pytest.importorskip("meshio", reason="meshio, another writer of these formats, is not installed")
    cells = CELLS if cells is None else cells
    blocks = [(kind, np.array(rows)) for kind, rows in cells.items()]
    of_gmsh = path.suffix == ".msh"  # an ending that meshio shares out among two formats
    tags = {"gmsh:dim_tags": np.full((len(points), 2), (3, 1))} if of_gmsh else {}
    numbered = [np.full(len(rows), number) for number, rows in enumerate(cells.values(), 1)]
    entities = {"gmsh:geometrical": numbered, "gmsh:physical": numbered} if of_gmsh else {}
    meshio.Mesh(np.asarray(points, float), blocks, point_data=tags, cell_data=entities).write(
        path, **{**({"file_format": "gmsh"} if of_gmsh else {}), **options}
    )
    return path


def rows_of(table: object, first: int = 0):
    return "".join(f"{number} {' '.join(map(str, row))}\n" for number, row in enumerate(table, first))


def as_msh(points: object, elements: list[str]):
    """Return an MSH file of version 2; the elements are rows `type tag-count tags nodes`."""
    numbered = "".join(f"{number} {row}\n" for number, row in enumerate(elements, 1))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(points)}\n{rows_of(points, 1)}$EndNodes\n"
        f"$Elements\n{len(elements)}\n{numbered}$EndElements\n"
    )


def as_vtk(points: object, cells: list[tuple[int, ...]], types: list[int]):
    size = sum(len(cell) + 1 for cell in cells)
    return (
        f"# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(points)} double\n"
        + "".join(" ".join(map(str, point)) + "\n" for point in points)
        + f"CELLS {len(cells)} {size}\n"
        + "".join(" ".join(map(str, (len(cell), *cell))) + "\n" for cell in cells)
        + f"CELL_TYPES {len(types)}\n"
        + "\n".join(map(str, types))
        + "\n"
    )


def tetrahedra_vtk(points: object, cells: object):
    rows = [tuple(cell) for cell in cells]
    return as_vtk(points, rows, [10] * len(rows))


def as_inp(nodes: object, elements: str):
    return "*HEADING\n** made by a test\n*NODE\n" + "".join(f"{','.join(map(str, row))}\n" for row in nodes) + elements


def loaded(path: Path, units: str | None = "mm", **given: object) -> VolumeMesh:
    return load_volume_mesh(params=LoadVolumeMeshParams.model_validate({"path": path, "units": units, **given}))


def refused(path: Path, message: str, **given: object):
    with pytest.raises(StageError, match=message) as caught:
        loaded(path, **given)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)


def volumes_of(mesh: VolumeMesh):
    names = {"tetrahedron": "tetrahedra", "pyramid": "pyramids", "wedge": "wedges", "hexahedron": "hexahedra"}
    return {names[kind]: cell_volumes(mesh.vertices, cells, kind).sum() for kind, cells in mesh.cells.items()}


FORMATS = {
    "ascii.vtu": {"file_format": "vtu", "binary": False},
    "binary.vtu": {"file_format": "vtu", "binary": True, "compression": None},
    "compressed.vtu": {"file_format": "vtu", "binary": True},
    "ascii51.vtk": {"file_format": "vtk51", "binary": False},
    "binary51.vtk": {"file_format": "vtk51", "binary": True},
    "ascii42.vtk": {"file_format": "vtk42", "binary": False},
    "binary42.vtk": {"file_format": "vtk42", "binary": True},
    "ascii2.msh": {"file_format": "gmsh22", "binary": False},
    "binary2.msh": {"file_format": "gmsh22", "binary": True},
    "ascii41.msh": {"file_format": "gmsh", "binary": False},
    "binary41.msh": {"file_format": "gmsh", "binary": True},
    "ascii.mesh": {"file_format": "medit"},
}


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("load_volume_mesh", load_volume_mesh)
    assert (declared.writes, declared.reads) == ("mesh", {})


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_loads_as_the_same_mesh(tmp_path: Path, name: str):
    mesh = loaded(with_meshio(tmp_path / name, **FORMATS[name]))
    assert volumes_of(mesh) == pytest.approx(VOLUMES)
    assert len(mesh.vertices) == len(POINTS)
    assert {plural: mesh.facts[plural] for plural in VOLUMES} == dict.fromkeys(VOLUMES, 1)


@pytest.mark.parametrize("mode", ["text", "binary"])
def test_the_first_version_4_of_gmsh_loads(tmp_path: Path, mode: str):
    gmsh = pytest.importorskip("meshio.gmsh", reason="meshio, another writer of the format, is not installed")
    meshio = pytest.importorskip("meshio")
    blocks = [(kind, np.array(rows)) for kind, rows in CELLS.items()]
    path = tmp_path / "mesh.msh"
    gmsh.write(path, meshio.Mesh(POINTS, blocks), fmt_version="4.0", binary=mode == "binary")
    assert volumes_of(loaded(path)) == pytest.approx(VOLUMES)


def test_gmsh_1_loads(tmp_path: Path):
    text = f"$NOD\n12\n{rows_of(POINTS, 1)}$ENDNOD\n$ELM\n2\n7 5 1 1 8 1 2 3 4 5 6 7 8\n8 4 1 1 4 5 11 6 12\n$ENDELM\n"
    mesh = loaded(written(tmp_path / "old.msh", text), component="all")
    assert volumes_of(mesh) == pytest.approx({"hexahedra": 64.0, "tetrahedra": 80.0 / 6.0})


def test_a_binary_gmsh_of_the_other_byte_order_with_sparse_numbers_loads(tmp_path: Path):
    nodes = b"".join(struct.pack(">i3d", 7 * k + 3, *place) for k, place in enumerate(TWO_TETRAHEDRA))
    elements = struct.pack(">3i", 4, 2, 2) + struct.pack(">14i", 1, 0, 1, 3, 10, 17, 24, 2, 0, 1, 10, 17, 24, 31)
    content = b"$MeshFormat\n2.2 1 8\n" + struct.pack(">i", 1) + b"\n$EndMeshFormat\n"
    content += b"$Nodes\n5\n" + nodes + b"\n$EndNodes\n$Elements\n2\n" + elements + b"\n$EndElements\n"
    path = tmp_path / "big.msh"
    path.write_bytes(content)
    assert volumes_of(loaded(path)) == pytest.approx({"tetrahedra": 64.0 / 6.0 + 64.0 / 3.0})


def test_abaqus_loads(tmp_path: Path):
    assert volumes_of(loaded(with_meshio(tmp_path / "mesh.inp", BRICK_POINTS, BRICKS))) == {
        "hexahedra": pytest.approx(64.0),
        "wedges": pytest.approx(32.0),
    }


def test_the_unit_is_needed_and_scales_to_mm(tmp_path: Path):
    path = written(tmp_path / "two.vtk", tetrahedra_vtk(TWO_TETRAHEDRA, [(0, 1, 2, 3)]))
    refused(
        path, r"does not state its unit; set `units` to mm, cm, m or inch \(the mesh measures 4 x 4 x 4", units=None
    )
    mesh = loaded(path, units="inch")
    assert mesh.volume == pytest.approx(64.0 / 6.0 * 25.4**3)
    assert "unit inch (given), size 4 x 4 x 4 inch" in mesh.facts["notes"]


@pytest.mark.parametrize(("size", "units"), [(0.1, "mm"), (4.0, "m")])
def test_an_odd_size_asks_for_the_unit(tmp_path: Path, size: float, units: str):
    path = written(tmp_path / "odd.vtk", tetrahedra_vtk(TWO_TETRAHEDRA * size / 4, [(0, 1, 2, 3)]))
    with pytest.warns(PipelineWarning, match="is `units` right"):
        loaded(path, units=units)


@pytest.mark.parametrize("name", ["curved.vtu", "curved.vtk", "curved.msh", "curved.inp"])
def test_quadratic_cells_are_reduced_to_their_corners(tmp_path: Path, name: str):
    ends = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = [(TWO_TETRAHEDRA[a] + TWO_TETRAHEDRA[b]) / 2 for a, b in ends]
    points = np.concatenate([TWO_TETRAHEDRA[:4], middles])
    mesh = loaded(with_meshio(tmp_path / name, points, {"tetra10": [tuple(range(10))]}))
    assert (len(mesh.vertices), mesh.volume) == (4, pytest.approx(64.0 / 6.0))
    assert "reduced 1 cells of higher order to their corners" in mesh.facts["notes"]
    assert "dropped 6 points that are no corner of a cell" in mesh.facts["notes"]


def test_gmsh_elements_of_the_third_order_are_reduced_to_their_corners(tmp_path: Path):
    points = np.concatenate([TWO_TETRAHEDRA[:4], np.random.default_rng(0).random((16, 3))])
    element = "29 2 0 1 " + " ".join(map(str, range(1, 21)))
    mesh = loaded(written(tmp_path / "third.msh", as_msh(points, [element])))
    assert (len(mesh.vertices), mesh.volume) == (4, pytest.approx(64.0 / 6.0))


def test_voxels_become_hexahedra(tmp_path: Path):
    corners = [(x, y, z) for z in (0.0, 4.0) for y in (0.0, 4.0) for x in (0.0, 4.0)]
    mesh = loaded(written(tmp_path / "voxel.vtk", as_vtk(corners, [tuple(range(8))], [11])))
    assert volumes_of(mesh) == pytest.approx({"hexahedra": 64.0})
    assert (mesh.facts["cells_turned"], mesh.facts["cells_folded"]) == (0, 0)


def test_elements_that_fill_no_space_are_ignored_by_number(tmp_path: Path):
    cells = [(0, 1, 2, 3), (0, 1, 2), (0, 1), (4,)]
    mesh = loaded(written(tmp_path / "beside.vtk", as_vtk(TWO_TETRAHEDRA, cells, [10, 5, 3, 1])))
    assert len(mesh.vertices) == 4
    assert "ignored 3 elements that fill no space (1 of type line, 1 of type point, 1 of type triangle)" in str(
        mesh.facts["notes"]
    )


def polyhedron_vtu():
    def array(kind: str, name: str, values: object, width: int = 1):
        numbers = " ".join(str(value) for value in np.ravel(values))
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="ascii">{numbers}</DataArray>'
        )

    faces = [4, 3, 0, 2, 1, 3, 0, 1, 3, 3, 1, 2, 3, 3, 2, 0, 3]
    cells = array("Int64", "connectivity", range(4)) + array("Int64", "offsets", [4]) + array("UInt8", "types", [42])
    cells += array("Int64", "faces", faces) + array("Int64", "faceoffsets", [len(faces)])
    points = array("Float64", "Points", TWO_TETRAHEDRA[:4], 3)
    return (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">'
        '<UnstructuredGrid><Piece NumberOfPoints="4" NumberOfCells="1">'
        f"<Points>{points}</Points><Cells>{cells}</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


def test_cells_of_other_kinds_are_refused_by_name_and_number(tmp_path: Path):
    refused(
        written(tmp_path / "poly.vtu", polyhedron_vtu()),
        "has cells that are not supported: 1 of type polyhedron; export",
    )
    angles = np.arange(6) * np.pi / 3
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    prism = [(*place, z) for z in (0.0, 4.0) for place in 4.0 * ring]
    path = written(tmp_path / "prism.vtk", as_vtk(prism, [tuple(range(12))], [16]))
    refused(path, "1 of type hexagonal prism; export the mesh as")
    path = written(tmp_path / "poly.msh", as_msh(TWO_TETRAHEDRA, ["35 2 0 1 1 2 3 4"]))
    refused(path, r"elements of Gmsh's type 35 \(a polyhedron\)")


@pytest.mark.parametrize("name", ["flat.vtu", "flat.vtk", "flat.msh", "flat.mesh", "flat.inp"])
def test_a_file_of_triangles_only_is_refused(tmp_path: Path, name: str):
    path = with_meshio(tmp_path / name, TWO_TETRAHEDRA, {"triangle": [(0, 1, 2)]})
    refused(path, r"has no volume cells \(1 of type .*\); export")


@pytest.mark.parametrize("name", [*FORMATS, "mesh.inp"])
@pytest.mark.parametrize("share", [0.4, 0.8])
def test_a_file_cut_off_anywhere_is_refused_in_one_line(tmp_path: Path, name: str, share: float):
    points, cells = (BRICK_POINTS, BRICKS) if name.endswith("inp") else (POINTS, CELLS)
    path = with_meshio(tmp_path / name, points, cells, **FORMATS.get(name, {}))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refused(path, "again|has no volume cells")


@pytest.mark.parametrize("suffix", ["vtu", "msh", "mesh", "inp"])
def test_an_empty_file_is_refused(tmp_path: Path, suffix: str):
    refused(written(tmp_path / f"empty.{suffix}", ""), r"is an empty file \(0 bytes\)")


HTML = "<!DOCTYPE html><html><body>404</body></html>\n"


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("page.vtu", "VTK reports: "),
        ("page.vtk", "VTK reports: Unrecognized file type"),
        ("page.msh", r"is not a Gmsh file \(no \$MeshFormat\)"),
        ("page.mesh", "is not a MEDIT text file"),
        ("page.inp", "is not an Abaqus input file: line 1 is under no keyword"),
        (
            "page.step",
            r"cannot read files of type \.step; export the volume mesh as one of \.inp, \.mesh, \.msh, \.vtk",
        ),
    ],
)
def test_what_is_no_mesh_at_all_is_refused(tmp_path: Path, name: str, rule: str):
    refused(written(tmp_path / name, HTML), rule)


def test_a_surface_in_vtk_is_refused(tmp_path: Path):
    points = "POINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
    text = f"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n{points}POLYGONS 1 4\n3 0 1 2\n"
    refused(written(tmp_path / "surface.vtk", text), "must contain an unstructured grid, got vtkPolyData")


DAMAGED = {
    "three.msh": (
        as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3 4"]).replace("2.2 0 8", "3 0 8"),
        "MSH version must be 1, 2 or 4, got 3",
    ),
    "node.msh": (as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3 99"]), r"use 1 nodes that are not in the file \(one is 99\)"),
    "zero.msh": (as_msh(TWO_TETRAHEDRA, ["4 2 0 1 0 2 3 4"]), r"use 1 nodes that are not in the file \(one is 0\)"),
    "twice.msh": (
        as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3 4"]).replace("\n5 ", "\n4 "),
        r"1 node numbers are used twice \(one is 4\)",
    ),
    "count.msh": (
        as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3 4"]).replace("$Elements\n1", "$Elements\n2"),
        r"\$Elements: announces 2 elements, but 1 follow",
    ),
    "huge.msh": (
        as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3 4"]).replace("$Nodes\n5", "$Nodes\n5000000000000"),
        r"\$Nodes: announces 20000000000000 numbers, but 20 follow",
    ),
    "word.msh": (as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 three 4"]), "must be numbers, got 'three' in its line 2"),
    "part.msh": (as_msh(TWO_TETRAHEDRA, ["4 2 0 1 1 2 3.5 4"]), "counts and node numbers must be whole numbers"),
    "nan.msh": (
        as_msh(np.where(TWO_TETRAHEDRA == 4.0, np.nan, 0.0), ["4 2 0 1 1 2 3 4"]),
        "3 of 4 vertices are NaN or infinite",
    ),
    "far.msh": (
        as_msh(np.where(TWO_TETRAHEDRA == 4.0, 1e200, 0.0), ["4 2 0 1 1 2 3 4"]),
        r"a vertex is 1e\+200 mm from the origin, at most 1e\+09 mm is accepted; check `units`",
    ),
    "range.vtk": (tetrahedra_vtk(TWO_TETRAHEDRA, [(0, 1, 2, 7)]), "VTK|the points of cells must be"),
    "range.mesh": (
        "MeshVersionFormatted 2\nDimension 3\nVertices 1\n0 0 0 0\nTetrahedra\n1\n1 2 3 4 0\nEnd\n",
        r"the points of cells must be 0\.\.0 \(from 0\), got 0\.\.3",
    ),
    "plane.mesh": ("MeshVersionFormatted 2\nDimension 2\nEnd\n", "Dimension must be 3, got 2"),
    "many.mesh": (
        "MeshVersionFormatted 2\nDimension 3\nVertices 2\n0 0 0 0\nEnd\n",
        "Vertices: announces 8 numbers, but 4 follow",
    ),
    "rows.inp": (
        as_inp([(1, 0, 0)], "*ELEMENT, TYPE=C3D4\n1,1,1,1,1\n"),
        r"must have 4 numbers per node \(number, x, y, z\), got 3 for 1 nodes",
    ),
    "short.inp": (
        as_inp([(1, 0, 0, 0)], "*ELEMENT, TYPE=C3D4\n1,1,1,1\n"),
        r"must have 5 numbers per element \(its own and its 4 nodes\), got 4 numbers in all",
    ),
    "include.inp": (
        as_inp([(1, 0, 0, 0)], "*INCLUDE, INPUT=more.inp\n"),
        r"include\.inp:5: \*INCLUDE is not supported",
    ),
    "part.inp": (as_inp([(1, 0, 0, 0)], "*INSTANCE, NAME=A, PART=B\n*END INSTANCE\n"), "instance of part 'B'"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_refused_by_its_fault(tmp_path: Path, name: str):
    content, rule = DAMAGED[name]
    refused(written(tmp_path / name, content), rule)


def test_nodes_may_have_any_numbers(tmp_path: Path):
    numbered = "".join(
        f"{number} {x} {y} {z}\n" for number, (x, y, z) in zip((70, 3, 900, 12), TWO_TETRAHEDRA, strict=False)
    )
    text = (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n{numbered}$EndNodes\n"
        "$Elements\n3\n5 15 2 0 1 3\n8 2 3 0 1 9 3 70 12\n44 4 2 0 1 70 3 900 12\n$EndElements\n"
    )
    assert loaded(written(tmp_path / "numbers.msh", text)).volume == pytest.approx(64.0 / 6.0)
    nodes = [(number, *place) for number, place in zip((70, 3, 900, 12), TWO_TETRAHEDRA, strict=False)]
    text = as_inp(nodes, "*ELEMENT, TYPE=C3D4, ELSET=bone\n1, 70, 3,\n900, 12\n*ELSET, ELSET=all\nbone\n")
    assert loaded(written(tmp_path / "numbers.inp", text)).volume == pytest.approx(64.0 / 6.0)


def test_parts_of_abaqus_stand_where_their_instances_put_them(tmp_path: Path):
    nodes = [(k + 1, *place) for k, place in enumerate(TWO_TETRAHEDRA[:4])]
    part = (
        "*PART, NAME={}\n"
        + as_inp(nodes, "*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n*ELEMENT, TYPE=S3R\n2,1,2,3\n")
        + "*END PART\n"
    )
    places = (
        "*ASSEMBLY, NAME=all\n*INSTANCE, NAME=A-1, PART=A\n*END INSTANCE\n"
        "*INSTANCE, NAME=B-1, PART=b\n10., 0., 0.\n10., 0., 0., 10., 0., 1., 90.\n*END INSTANCE\n*END ASSEMBLY\n"
    )
    path = written(tmp_path / "parts.inp", part.format("A") + part.format("B") + places)
    mesh = loaded(path, component="all")
    assert mesh.facts["tetrahedra"] == 2
    assert mesh.volume == pytest.approx(2 * 64.0 / 6.0)
    np.testing.assert_allclose(
        [mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[0, 0, 0], [10, 4, 4]], atol=1e-9
    )
    assert "ignored 2 elements that fill no space (2 of type element S3R)" in mesh.facts["notes"]


@pytest.mark.parametrize(
    ("kind", "turned"),
    [
        ("tetra", [0, 2, 1, 3]),
        ("pyramid", [0, 3, 2, 1, 4]),
        ("wedge", [3, 4, 5, 0, 1, 2]),
        ("hexahedron", [0, 3, 2, 1, 4, 7, 6, 5]),
    ],
)
def test_inverted_cells_are_turned_and_counted(tmp_path: Path, kind: str, turned: list[int]):
    cells = {**CELLS, kind: [np.array(CELLS[kind][0])[turned]]}
    one, other = loaded(with_meshio(tmp_path / "one.vtk")), loaded(with_meshio(tmp_path / "other.vtk", cells=cells))
    assert volumes_of(one) == volumes_of(other) == pytest.approx(VOLUMES)
    counts = sorted([one.facts["cells_turned"], other.facts["cells_turned"]])
    assert counts in ([0, 1], [1, 2])  # a wedge may be the wrong way round in both: programs differ about it
    assert f"turned {counts[1]} cells of negative volume" in one.facts["notes"] + other.facts["notes"]


def test_a_cell_that_is_really_inside_out_is_refused(tmp_path: Path):
    points = TWO_TETRAHEDRA.copy()
    points[4] = (0.5, 0.5, 0.5)  # pushed through the face that the two share
    path = written(tmp_path / "through.vtk", tetrahedra_vtk(points, [(0, 1, 2, 3), (1, 2, 3, 4)]))
    refused(
        path, r"cells overlap: 1 pairs are on the same side of the face .* one of these 2 cells is at .* mm; repair"
    )


def test_three_cells_at_a_face_are_refused(tmp_path: Path):
    points = np.concatenate([TWO_TETRAHEDRA, [(3.0, 3.5, 3.0)]])
    path = written(tmp_path / "three.vtk", tetrahedra_vtk(points, [(0, 1, 2, 3), (1, 2, 3, 4), (1, 2, 3, 5)]))
    refused(path, "and 3 cells are at a face of more than two")


def test_the_boundary_must_enclose_what_the_cells_fill():
    sound = {"tetrahedron": np.array([(0, 1, 2, 3), (1, 2, 3, 4)])}
    module._require_agreement(TWO_TETRAHEDRA, sound, "two")
    points = TWO_TETRAHEDRA.copy()
    points[4] = (0.5, 0.5, 0.5)
    overlapping = {"tetrahedron": np.array([(0, 1, 2, 3), (1, 3, 2, 4)])}
    with pytest.raises(StageError, match=r"the cells fill 17\.\d+ mm\^3, but their boundary encloses .* overlap"):
        module._require_agreement(points, overlapping, "two")


def test_repeated_and_flat_cells_go_by_number(tmp_path: Path):
    points = np.concatenate([TWO_TETRAHEDRA, [(4.0, 4.0, 0.0)]])
    cells = [(0, 1, 2, 3), (1, 0, 3, 2), (1, 2, 3, 4), (0, 1, 2, 5)]
    mesh = loaded(written(tmp_path / "more.vtk", tetrahedra_vtk(points, cells)))
    assert (len(mesh.tetrahedra), len(mesh.vertices)) == (2, 5)
    for note in ("dropped 1 cells with the corners of another", "dropped 1 cells without volume"):
        assert note in mesh.facts["notes"]


def test_a_mesh_without_any_volume_is_refused(tmp_path: Path):
    path = written(tmp_path / "sheet.vtk", tetrahedra_vtk(TWO_TETRAHEDRA * [1, 1, 0], [(0, 1, 2, 4)]))
    refused(path, "no cell has a volume; is the mesh flat")


def test_a_cell_that_uses_a_vertex_twice_is_refused(tmp_path: Path):
    hexahedron = (0, 1, 2, 2, 4, 5, 6, 6)
    path = written(tmp_path / "wedge.vtk", as_vtk(POINTS, [hexahedron], [12]))
    refused(path, r"1 of 1 cells use a vertex twice \(hexahedra that stand for wedges")


def test_a_folded_cell_is_told_of(tmp_path: Path):
    points = POINTS[:8].copy()
    points[6] = (0.6, 0.6, 0.6)
    with pytest.warns(PipelineWarning, match="1 of 1 cells are folded"):
        mesh = loaded(written(tmp_path / "folded.vtk", as_vtk(points, [tuple(range(8))], [12])))
    assert mesh.facts["cells_folded"] == 1


@pytest.mark.parametrize("order", [(0, 1, 3, 2, 4, 5, 7, 6), (0, 1, 2, 3, 4, 5, 7, 6), (1, 0, 2, 3, 4, 5, 6, 7)])
def test_a_cell_with_crossed_faces_is_refused(order: tuple[int, ...], tmp_path: Path):
    refused(
        written(tmp_path / "crossed.vtk", as_vtk(POINTS, [order], [12])), "1 of 1 cells have a face whose sides cross"
    )


def test_a_cell_with_bent_or_hollow_faces_is_no_crossed_one(tmp_path: Path):
    for corner, place in ((6, (4.5, 5.0, 3.0)), (2, (1.8, 1.8, 0.0))):
        points = POINTS[:8].copy()
        points[corner] = place
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PipelineWarning)  # the hollow one is folded
            mesh = loaded(written(tmp_path / "bent.vtk", as_vtk(points, [tuple(range(8))], [12])))
        assert len(mesh.hexahedra) == 1


def cracked(path: Path, gap: float):
    """Write two cubes side by side with vertices of their own, `gap` apart."""
    points = np.concatenate([POINTS[:8], POINTS[:8] + np.array([4.0 + gap, 0.0, 0.0])])
    return written(path, as_vtk(points, [tuple(range(8)), tuple(range(8, 16))], [12, 12]))


def test_a_crack_is_told_of_and_the_smaller_piece_dropped_with_a_warning(tmp_path: Path):
    with pytest.warns(PipelineWarning) as caught:
        mesh = loaded(cracked(tmp_path / "cracked.vtk", 0.0))
    said = " ".join(str(warning.message) for warning in caught)
    assert "8 vertices of the boundary lie within" in said
    assert "set `merge: 9.8e-06` to connect them" in said
    assert "dropped a piece of 64 mm^3; the largest, kept, has 64 mm^3" in said
    assert len(mesh.hexahedra) == 1


def test_a_crack_is_closed_where_that_is_asked_for(tmp_path: Path):
    mesh = loaded(cracked(tmp_path / "cracked.vtk", 0.01), merge=0.02)
    assert (len(mesh.hexahedra), len(mesh.vertices)) == (2, 12)
    assert "merged 4 vertices within 0.02 mm of another" in mesh.facts["notes"]


def test_merging_wider_than_a_cell_is_refused(tmp_path: Path):
    refused(cracked(tmp_path / "cracked.vtk", 0.01), "2 of 2 cells use a vertex twice .* or lower merge", merge=5.0)


def test_separate_bodies_are_kept_where_that_is_asked_for(tmp_path: Path):
    path = cracked(tmp_path / "apart.vtk", 1.0)
    assert loaded(path, component="all").volume == pytest.approx(128.0)
    with pytest.warns(PipelineWarning, match="set `component: all` to keep every piece"):
        assert loaded(path).volume == pytest.approx(64.0)


REAL = {
    "cinolib_rockerarm.mesh": ({"hexahedra": 10600}, 20505.9),
    "scalismo_tetraMesh.vtu": ({"tetrahedra": 160, "cells_turned": 80}, 2359.72),
    "sofa_liver.msh": ({"tetrahedra": 596}, 36.5609),
    "vtkdata_can.vtu": ({"hexahedra": 4800, "cells_folded": 37}, 48.0193),
    "vtkdata_notch_disp.vtu": ({"hexahedra": 2188, "wedges": 4}, 3.84866e-4),
    "vtkdata_uGridEx.vtk": ({"hexahedra": 2}, 2.0),
}


@pytest.mark.parametrize("name", REAL)
@pytest.mark.filterwarnings("ignore::scaffold_pipeline.errors.PipelineWarning")
def test_real_files_load(name: str):
    if not (DATA / name).is_file():
        pytest.skip("the real meshes are not beside this checkout")
    counts, volume = REAL[name]
    mesh = loaded(DATA / name)
    assert {key: mesh.facts[key] for key in counts} == counts
    assert mesh.volume == pytest.approx(volume, rel=1e-4)


def test_the_example_mesh_is_the_cylinder_that_it_is_said_to_be():
    mesh = loaded(Path(__file__).parents[2] / "configs" / "volume_mesh.msh")
    octagon = 2.0 * np.sqrt(2.0) * 8.0**2
    assert mesh.volume == pytest.approx(16.0 * octagon, rel=1e-5)
    assert (mesh.facts["wedges"], mesh.facts["hexahedra"]) == (32, 32)
    assert "read 32 wedges, 32 hexahedra over 85 points" in mesh.facts["notes"]


@pytest.mark.parametrize("name", ["ascii2.msh", "ascii41.msh", "ascii.mesh", "ascii.inp"])
@pytest.mark.parametrize(("encoding", "line_end"), [("utf-8-sig", "\n"), ("utf-16", "\r\n"), ("utf-8", "\r")])
def test_text_may_have_any_line_ends_and_byte_order_mark(tmp_path: Path, name: str, encoding: str, line_end: str):
    options, is_abaqus = FORMATS.get(name, {}), name.endswith("inp")
    given = (BRICK_POINTS, BRICKS) if is_abaqus else (POINTS, CELLS)
    text = with_meshio(tmp_path / name, *given, **options).read_text(encoding="utf-8")
    path = tmp_path / f"marked{Path(name).suffix}"
    path.write_bytes(text.replace("\n", line_end).encode(encoding))
    assert volumes_of(loaded(path)) == pytest.approx(volumes_of(loaded(tmp_path / name)))


def test_a_decimal_comma_is_named_as_the_cause(tmp_path: Path):
    text = with_meshio(tmp_path / "a.msh", **FORMATS["ascii2.msh"]).read_text(encoding="utf-8")
    refused(written(tmp_path / "a.msh", text.replace(".", ",").replace("2,2 0 8", "2.2 0 8")), "it has a decimal comma")
    text = with_meshio(tmp_path / "a.mesh", **FORMATS["ascii.mesh"]).read_text(encoding="utf-8")
    refused(
        written(tmp_path / "a.mesh", text.replace(".", ",")), "Vertices: must be numbers, got.*decimal comma: export"
    )
