"""OFF with any header and columns, OBJ and OFF of any line ends; what is not read is refused by its cause."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.surfaces.reading import read_surface
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.errors import StageError

POINTS = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)], float)
FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]


def off(header: str = "OFF\n4 4 6", columns: str = "", colours: str = ""):
    points = "".join(f"{x} {y} {z}{columns}\n" for x, y, z in POINTS)
    return f"{header}\n{points}" + "".join(f"3 {a} {b} {c}{colours}\n" for a, b, c in FACES)


def obj():
    return "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES
    )


def read(folder: Path, name: str, content: str | bytes):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_surface(path)


def require_tetrahedron(found):
    assert np.array_equal(found.vertices, POINTS)
    assert found.faces.tolist() == [list(face) for face in FACES]


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        *(("off\n4 4 0", ""), ("OFF 4 4 0", ""), ("OFF4 4 0", ""), ("OFF\n4 4", ""), ("4 4 0", ""), ("4 4", "")),
        *(("COFF\n4 4 0", " 255 0 0 255"), ("NOFF\n4 4 0", " 0 0 1"), ("CNOFF\n4 4 0", " 0 0 1 0.5 0.5 0.5 1")),
        *(("STOFF\n4 4 0", " 0.5 0.5"), ("stoff 4 4 0", " 0.5 0.5"), ("STCNOFF\n4 4 0", " 0 0 1 1 1 1 1 0 0")),
        ("# made by a program\n\nOFF # a surface\n# its counts\n4 4 0 # vertices, faces", " # a vertex"),
    ],
)
def test_off_may_have_any_header_and_columns(tmp_path: Path, header: str, columns: str):
    require_tetrahedron(read(tmp_path, "a.off", off(header, columns, " 0.1 0.2 0.3")))


@pytest.mark.parametrize("name", ["a.off", "a.obj"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_text_may_have_any_line_ends_and_byte_order_mark(tmp_path: Path, name: str, encoding: str, line_end: str):
    content = (off() if name == "a.off" else obj()).replace("\n", line_end)
    mark = "\ufeff" if encoding == "utf-16-le" else ""
    require_tetrahedron(read(tmp_path, name, (mark + content).encode(encoding)))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.off", off("OFF BINARY\n4 4 6"), "is a binary OFF file, which is not supported; export it as text"),
        ("a.off", off("4OFF\n4 4 6", " 1"), "its vertices are not in 3-D .4OFF."),
        ("a.off", off("nOFF\n4\n4 4 6", " 1"), "its vertices are not in 3-D"),
        ("a.off", off().replace("4.0 0.0 0.0", "4,0 0.0 0.0"), r"a\.off:4: .* '4,0'; it has a decimal comma"),
        ("a.obj", obj().replace("4.0 0.0 0.0", "4,0 0,0 0,0"), r"a\.obj:2: .* '4,0'; it has a decimal comma"),
        ("a.obj", obj().replace("f 1 3 2", "f 1,0 3,0 2,0"), r"a\.obj:5: '1,0' names no vertex"),
        ("a.obj", obj() + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\n", r"a\.obj:9: has curved surfaces .cstype."),
        (
            "a.obj",
            b"\xff\xfe" + obj().encode() + b"x",
            "begins as UTF-16-LE text but is not valid text of that encoding",
        ),
    ],
)
def test_what_is_not_read_is_refused_by_its_cause(tmp_path: Path, name: str, content: str | bytes, said: str):
    with pytest.raises(StageError, match=said) as caught:
        read(tmp_path, name, content)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (4, 0), (1, 1), (0, 4)],  # an arrow head, whose shorter diagonal runs outside
        [(0, 0), (2, 0), (4, 0), (4, 4), (2, 2), (0, 4)],  # a corner on a side
        [(0, 0), (5, 0), (5, 5), (4, 5), (4, 1), (3, 1), (3, 5), (2, 5), (2, 1), (1, 1), (1, 5), (0, 5)],  # a comb
    ],
)
def test_concave_polygons_are_cut_in_their_plane(tmp_path: Path, outline: list[tuple[float, float]]):
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    count = len(outline)
    area = 0.5 * sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(outline, outline[1:] + outline[:1], strict=True))
    for start in range(count):
        ring = outline[start:] + outline[:start]
        points = np.array([(*point, z) for z in (0.0, 3.0) for point in ring]) @ turn.T
        sides = [(k, (k + 1) % count, (k + 1) % count + count, k + count) for k in range(count)]
        faces = [tuple(range(count))[::-1], tuple(range(count, 2 * count)), *sides]
        rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        rows += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
        found = read(tmp_path, "comb.obj", "\n".join(rows))
        assert not any(triangles.edge_faults(found.faces))
        volumes = triangles.piece_volumes(found.vertices, found.faces, np.zeros(len(found.faces), np.int64))
        assert volumes.sum() == pytest.approx(3 * area)
        areas = triangles.face_areas(found.vertices, found.faces)
        assert areas[: 2 * (count - 2)].sum() == pytest.approx(2 * area)  # none lies upon another
