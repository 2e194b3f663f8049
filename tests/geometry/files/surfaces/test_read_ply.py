"""PLY of every byte order, type and order of elements; faces of mixed sizes, concave ones, strips."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.surfaces.reading import read_surface
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.errors import PipelineWarning, StageError

OUTLINE = [(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)]
POINTS = np.array([(*point, z) for z in (0.0, 3.0) for point in OUTLINE])
WALLS = [(k, (k + 1) % 5, (k + 1) % 5 + 5, k + 5) for k in range(5)]
PRISM = [
    (4, 3, 2, 1, 0),
    (5, 6, 7, 8, 9),
    *WALLS,
]
"""A prism on a concave outline: pentagons and quadrangles, 30 mm^3."""

TYPES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


@dataclass(frozen=True)
class Ply:
    """How the prism is written: `extra` names the type of a number, and of a list, that stand beside the usual ones."""

    kind: str = "ascii"
    count: str = "uchar"
    index: str = "int"
    place: str = "double"
    extra: str = ""
    comment: str = ""
    line_end: str = "\n"

    def content(self, mark: bytes = b""):
        beside = f"property {self.extra} quality"
        header = ["ply", f"format {self.kind} 1.0", f"comment {self.comment}", f"element vertex {len(POINTS)}"]
        header += [*(f"property {self.place} {axis}" for axis in "xyz"), *([beside] if self.extra else [])]
        header += [f"element face {len(PRISM)}", *([beside] if self.extra else [])]
        header += [f"property list {self.count} {self.index} vertex_indices"]
        header += [f"property list uchar {self.extra} texcoord"] if self.extra else []
        return mark + self.line_end.join([*header, "end_header", ""]).encode() + b"".join(self.rows())

    def rows(self):
        one = [(self.extra, 7)] if self.extra else []
        for point in POINTS:
            yield self.row(*((self.place, value) for value in point), *one)
        for k, face in enumerate(PRISM):
            several = [("uchar", k % 3), *(k % 3 * [(self.extra, 5)])] if self.extra else []
            yield self.row(*one, (self.count, len(face)), *((self.index, corner) for corner in face), *several)

    def row(self, *pairs: tuple[str, float]):
        if self.kind == "ascii":
            return (" ".join(f"{value:g}" for _, value in pairs) + self.line_end).encode()
        order = {"binary_little_endian": "<", "binary_big_endian": ">"}[self.kind]
        return struct.pack(order + "".join(TYPES[of] for of, _ in pairs), *(_as(of, value) for of, value in pairs))


def _as(kind: str, value: float):
    return value if kind in ("float", "double") else int(value)


def ply(*given: str, mark: bytes = b"", **named: str):
    return Ply(*given, **named).content(mark)


def read(folder: Path, content: bytes | str):
    path = folder / "prism.ply"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_surface(path)


def require_prism(found):
    assert len(found.faces) == 2 * 3 + 5 * 2
    vertices, faces = triangles.merge_coincident(found.vertices, found.faces)
    assert not any(triangles.edge_faults(faces))
    volumes = triangles.piece_volumes(vertices, faces, np.zeros(len(faces), np.int64))
    assert volumes.sum() == pytest.approx(30.0)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", ["", *TYPES])
def test_faces_of_several_sizes_are_read_with_extra_properties_of_any_type(tmp_path: Path, kind: str, extra: str):
    require_prism(read(tmp_path, ply(kind, extra=extra)))


@pytest.mark.parametrize("place", ["float", "double", "int", "short"])
@pytest.mark.parametrize("index", ["uchar", "short", "uint"])
@pytest.mark.parametrize("count", ["uchar", "int", "ushort"])
def test_numbers_may_be_of_any_type(tmp_path: Path, count: str, index: str, place: str):
    require_prism(read(tmp_path, ply("binary_big_endian", count, index, place)))


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_header_may_have_any_line_ends_and_a_byte_order_mark(tmp_path: Path, kind: str, line_end: str):
    require_prism(read(tmp_path, ply(kind, line_end=line_end)))
    require_prism(read(tmp_path, ply(kind, line_end=line_end, mark=b"\xef\xbb\xbf")))


def test_concave_polygons_are_cut_in_their_plane_however_they_are_turned(tmp_path: Path):
    for start in range(5):
        faces = [face[start % len(face) :] + face[: start % len(face)] for face in PRISM]
        lines = [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
        top = ply().split(b"end_header\n")[0].decode()
        points = "\n".join(f"{x} {y} {z}" for x, y, z in POINTS)
        require_prism(read(tmp_path, f"{top}end_header\n{points}\n" + "\n".join(lines) + "\n"))


STRIP = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element tristrips 1
property list int int vertex_indices
end_header
0 0 0
4 0 0
0 4 0
0 0 4
{}
"""


@pytest.mark.parametrize(
    "strip",
    ["6 0 1 2 3 0 1", "7 0 1 2 3 -1 3 0", "12 2 1 0 -1 0 1 3 -1 1 2 3 -1", "16 2 1 0 -1 0 1 3 -1 1 2 3 -1 2 0 3 -1"],
)
def test_strips_are_cut_into_triangles_also_where_they_end_at_minus_one(tmp_path: Path, strip: str):
    found = read(tmp_path, STRIP.format(strip))
    assert {tuple(sorted(face)) for face in found.faces} <= {(0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)}
    assert len(found.faces) == {"6": 4, "7": 2, "12": 3, "16": 4}[strip.split(maxsplit=1)[0]]
    assert triangles.edge_faults(found.faces).misoriented == 0


def test_vertices_may_come_after_the_faces(tmp_path: Path):
    content = STRIP.format("").split("end_header")[0].replace("tristrips 1", "face 1").splitlines()
    header = [*content[:2], *content[6:], *content[2:6], "end_header"]
    found = read(tmp_path, "\n".join([*header, "3 0 1 2", "0 0 0", "4 0 0", "0 4 0", "0 0 4", ""]))
    assert found.faces.tolist() == [[0, 1, 2]]


def test_an_absent_texture_is_not_asked_for(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    require_prism(read(tmp_path, ply(comment="TextureFile not_there.png")))
    assert capfd.readouterr() == ("", "")


def test_anatomical_axes_of_a_comment_are_told(tmp_path: Path):
    assert read(tmp_path, ply(comment="3D Slicer output. SPACE=LPS")).space == "LPS"
    assert read(tmp_path, ply()).space is None


def test_what_follows_the_last_face_is_left_out_with_a_warning(tmp_path: Path):
    with pytest.warns(PipelineWarning, match="left out 3 bytes after its last element"):
        require_prism(read(tmp_path, ply("binary_little_endian") + b"abc"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (ply("binary_little_endian")[:-3], "announces 7 of face, but it is cut off before"),
        (ply("binary_little_endian")[:-200], "cut off before"),
        (ply().replace(b"5 4 3 2 1 0", b"2 4 3"), "face 0 has 2 corners, needs 3 or more"),
        (ply().replace(b"5 4 3 2 1 0", b"5 4 3 2 1 77"), "faces name vertices 0..77"),
        (ply().replace(b"4 0 3\n", b"4,5 0 3\n"), "'4,5' in its line 7; it has a decimal comma"),
        (ply().replace(b"double x", b"decimal x"), r"prism\.ply:5: its header has 'property decimal x'"),
        (ply().replace(b"double x", b"double a"), "its vertices have no x"),
        (ply().replace(b"format ascii", b"format cuneiform"), r"prism\.ply:2: its header has"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, content: bytes, said: str):
    with pytest.raises(StageError, match=said) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
