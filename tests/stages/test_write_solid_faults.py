"""Each check is shown to fail on a file with one fault planted by its writer, in every format, by every reader."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.solids import glb, three_mf
from scaffold_geometry.files.solids.formats import FORMATS, FileFormat
from scaffold_geometry.files.solids.model import Mesh, Model
from scaffold_pipeline.artifacts import Solid
from scaffold_pipeline.errors import StageError
from scaffold_stages.write_solid import WriteSolidParams, write_solid

READERS = [(kind, name) for kind, form in FORMATS.items() for name in form.readers]
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)
SHELLS = [4.0 * CUBE, CUBE + 1.0, 2.0 * CUBE + 5.0]
SOLID = Solid(np.concatenate(SHELLS), np.concatenate([FACES, FACES[:, ::-1] + 8, FACES + 16]))
"""A cube with a closed pore, and a smaller cube beside it."""


def dropped_triangle(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[1:])


def swapped_corners(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces[:1, ::-1], mesh.faces[1:]]))


def turned_corners(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.roll(mesh.faces, 1, axis=1))


def moved_vertex(mesh: Mesh) -> Mesh:
    return Mesh(
        mesh.vertices + np.float32([[0.0, 0.0, 1e-4]] + [[0.0, 0.0, 0.0]] * (len(mesh.vertices) - 1)), mesh.faces
    )


def merged_vertices(mesh: Mesh) -> Mesh:
    vertices = mesh.vertices.copy()
    vertices[1] = vertices[0]
    return Mesh(vertices, mesh.faces)


def larger(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * np.float32(1.001), mesh.faces)


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def inverted_pore(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, np.concatenate([mesh.faces[:12], mesh.faces[12:24, ::-1], mesh.faces[24:]]))


def pore_outside(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices - np.float32(9.0) * np.isin(np.arange(24), np.arange(8, 16))[:, None], mesh.faces)


def extra_piece(mesh: Mesh) -> Mesh:
    return Mesh(
        np.concatenate([mesh.vertices, CUBE.astype(np.float32) + 20.0]), np.concatenate([mesh.faces, FACES + 24])
    )


def piece_for_pore(_: Mesh) -> Mesh:
    corners = [4.0 * CUBE * [1.0, 1.0, 61.0 / 64.0], CUBE - 5.0, 2.0 * CUBE + 5.0]
    return Mesh(np.concatenate(corners).astype(np.float32), np.concatenate([FACES, FACES + 8, FACES + 16]))


def overlapping_pieces(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices - np.float32(1.5) * (np.arange(24) >= 16)[:, None], mesh.faces)


def no_number(mesh: Mesh) -> Mesh:
    vertices = mesh.vertices.copy()
    vertices[3, 1] = np.nan
    return Mesh(vertices, mesh.faces)


FAULTS: dict[Callable[[Mesh], Mesh], str] = {
    dropped_triangle: "must have 36 triangles, but 35 were read back",
    swapped_corners: "two of the same direction",
    turned_corners: "the solid's triangles in their order, but others were read back",
    moved_vertex: r"coordinates to the bit, but 1 of 24 vertices differ, by up to 0\.0001 mm",
    merged_vertices: "must (have no (triangle without area|collapsed edge)|be manifold)",
    larger: r"must keep the solid's volume to 0\.0001, but it is 71\.2",
    inside_out: r"must be outward, but \d of 3 shells are inverted",
    inverted_pore: "must be outward, but 1 of 3 shells",
    pore_outside: "must be outward, but 1 of 3 shells",
    extra_piece: "must have 36 triangles, but 48 were read back",
    piece_for_pore: "must have the solid's pieces and closed pores, 2 and 1, but has 3 and 0",
    overlapping_pieces: r"must not intersect itself, but \d+ triangles cross or touch another",
    no_number: "must (be finite|be valid)",
}


def write_refused(out: Path, kind: str, message: str) -> None:
    with pytest.raises(StageError, match=message) as failure:
        write_solid(SOLID, params=WriteSolidParams(formats=(kind,), preview=False), out=out)
    assert str(failure.value).startswith(f"solid.{kind}: ")
    assert "\n" not in str(failure.value)
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("kind", FORMATS)
def test_the_solid_without_a_fault_is_accepted(tmp_path: Path, kind: str):
    write_solid(SOLID, params=WriteSolidParams(formats=(kind,), preview=False), out=tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == [f"solid.{kind}"]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
@pytest.mark.parametrize(("kind", "reader"), READERS)
def test_each_reader_alone_finds_the_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, reader: str, fault: Callable[[Mesh], Mesh]
):
    form = FORMATS[kind]

    def write_badly(path: Path, model: Model) -> None:
        form.write(path, replace(model, mesh=fault(model.mesh)))

    monkeypatch.setitem(FORMATS, kind, FileFormat(write_badly, {reader: form.readers[reader]}))
    message = FAULTS[fault]
    if reader == "lib3mf":
        message = f"({message})|lib3mf says"

    write_refused(tmp_path, kind, message)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 1.0])
@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_that_is_cut_off_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, share: float):
    form = FORMATS[kind]

    def write_half(path: Path, model: Model) -> None:
        form.write(path, model)
        content = path.read_bytes()
        path.write_bytes(content[: int(share * (len(content) - 3))])

    def come_second(_: Path) -> Mesh:
        pytest.fail("VTK's readers crash on what is cut off: the first reader must have refused it")

    first = next(iter(form.readers))
    monkeypatch.setitem(FORMATS, kind, FileFormat(write_half, {first: form.readers[first], "second": come_second}))

    write_refused(tmp_path, kind, f"solid.{kind}: ")


def test_a_3mf_in_inches_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = three_mf._text
    monkeypatch.setattr(three_mf, "_text", lambda model: (part.replace("millimeter", "inch") for part in text(model)))

    write_refused(tmp_path, "3mf", "must have one object in mm, but has 1 in Inch")


def test_a_3mf_against_the_standard_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = three_mf._text
    monkeypatch.setattr(three_mf, "_text", lambda model: (part.replace("</mesh>", "") for part in text(model)))

    write_refused(tmp_path, "3mf", "must be valid 3MF, but lib3mf says")


def test_a_glb_in_other_units_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    complete = glb._complete

    def in_centimetres(model: Model, tree: dict) -> None:
        complete(model, tree)
        tree["nodes"][0]["matrix"] = [10.0 * value for value in tree["nodes"][0]["matrix"][:15]] + [1.0]

    monkeypatch.setattr(glb, "_complete", in_centimetres)

    write_refused(tmp_path, "glb", "must be in metres with y up, but its node's matrix is")
