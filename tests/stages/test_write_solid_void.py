from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import shapes
from scaffold_geometry.files.solids import pore_space as module
from scaffold_geometry.files.solids.formats import FORMATS, FileFormat
from scaffold_geometry.files.solids.model import Mesh, Model
from scaffold_geometry.files.solids.pore_space import pore_space
from scaffold_geometry.surfaces.booleans import from_manifold, to_manifold
from scaffold_pipeline.artifacts import OuterShape, Solid
from scaffold_pipeline.errors import StageError
from scaffold_stages.write_solid import WriteSolidParams, write_solid

Size = tuple[float, float, float]


def box(size: Size, corner: Size = (0.0, 0.0, 0.0)):
    low = np.array(corner)
    return to_manifold(*shapes.box(tuple(low), tuple(low + size)), "box")


def turned(body, angle: float = 25.0):
    """Turn a body off the axes, so that no facet lies where float32 holds it."""
    return body.rotate((angle, 2.0 * angle, 3.0 * angle))


def outer_of(body) -> OuterShape:
    return OuterShape(*from_manifold(body))


def solid_of(body) -> Solid:
    vertices, faces = from_manifold(body)
    return Solid(vertices.astype(np.float32).astype(np.float64), faces)


OUTER = turned(box((6.0, 5.0, 4.0)))
CHANNEL = turned(box((2.0, 2.0, 6.0), (2.0, 1.5, -1.0)))
DRILLED = solid_of(OUTER - CHANNEL)
"""A box with a square hole through it, its vertices rounded to float32."""


def written(out: Path, solid: Solid = DRILLED, outer: OuterShape | None = None, **given: object):
    params = WriteSolidParams.model_validate({"preview": False, "void": True, **given})
    return write_solid(solid, outer or outer_of(OUTER), params=params, out=out).facts


def write_bad(out: Path, message: str, solid: Solid = DRILLED, outer: OuterShape | None = None) -> None:
    with pytest.raises(StageError, match=message) as failure:
        written(out, solid, outer)
    assert "\n" not in str(failure.value)
    assert list(out.iterdir()) == []


def test_void_and_solid_fill_the_outer_shape(tmp_path: Path):
    facts = written(tmp_path)

    assert facts["void_volume_mm3"] == pytest.approx(16.0, rel=1e-5)
    assert facts["void_stl_volume_mm3"] + facts["stl_volume_mm3"] == pytest.approx(120.0, rel=1e-5)
    assert facts["void_pieces"] == 1


def test_the_void_is_written_in_the_formats_of_the_solid(tmp_path: Path):
    facts = written(tmp_path, formats=("stl", "3mf", "ply"))

    names = {f"{body}.{kind}" for body in ("solid", "void") for kind in ("stl", "3mf", "ply")}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert facts["void_3mf_read_by"] == "lib3mf, expat, manifold3d"


def test_others_read_the_void_as_the_hole(tmp_path: Path):
    written(tmp_path, formats=("stl",))

    void = trimesh.load_mesh(tmp_path / "void.stl")
    assert void.is_watertight
    assert void.volume == pytest.approx(16.0, rel=1e-5)
    inside = from_manifold(turned(box((1e-3, 1e-3, 1e-3), (3.0, 2.5, 2.0))))[0]
    assert void.bounds[0] == pytest.approx(from_manifold(OUTER ^ CHANNEL)[0].min(axis=0), abs=1e-4)
    assert (void.bounds[0] < inside.min(axis=0)).all()


def test_all_pieces_of_the_void_are_kept_and_told(tmp_path: Path):
    second = turned(box((0.5, 0.01, 6.0), (0.5, 1.5, -1.0)))

    facts = written(tmp_path, solid_of(OUTER - CHANNEL - second))

    assert facts["void_pieces"] == 2
    assert facts["void_volume_mm3"] == pytest.approx(16.0 + 0.02, rel=1e-5)


def test_a_void_around_all_of_the_solid_has_it_as_a_hole(tmp_path: Path):
    facts = written(tmp_path, solid_of(turned(box((1.0, 1.0, 1.0), (2.0, 2.0, 2.0)))))

    assert facts["void_volume_mm3"] == pytest.approx(119.0, rel=1e-5)


def test_the_void_is_the_same_each_time(tmp_path: Path):
    hashes = set()
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        hashes.add(written(folder)["void_stl_sha256"])

    assert len(hashes) == 1


def test_the_void_has_no_film_between_the_solid_and_the_outer_shape():
    void = pore_space(outer_of(OUTER), DRILLED)

    assert void.inset < 1e-4
    assert len(void.body.faces) <= len(DRILLED.faces) + 12


def test_a_void_that_rounding_folds_is_cut_deeper(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "INSETS", (0, 4, 16))

    assert pore_space(outer_of(OUTER), DRILLED).inset > 0.0


def test_a_void_that_always_folds_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "INSETS", (0,))

    write_bad(tmp_path, "pore space: has details finer than float32 can represent")


def test_no_void_is_written_by_default(tmp_path: Path):
    facts = written(tmp_path, void=False)

    assert not [name for name in facts if name.startswith("void")]
    assert not list(tmp_path.glob("void*"))


def test_a_void_without_an_outer_shape_is_refused(tmp_path: Path):
    with pytest.raises(StageError, match=r"^void: needs the outer shape, .* slot 'outer'.* or set void off$"):
        write_solid(DRILLED, params=WriteSolidParams(void=True, preview=False), out=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_solid_without_pores_is_refused(tmp_path: Path):
    write_bad(tmp_path, "the pore space is empty: the solid fills the outer shape", solid_of(OUTER))


def test_an_outer_shape_that_is_not_the_solids_is_refused(tmp_path: Path):
    smaller = outer_of(turned(box((5.0, 5.0, 4.0))))

    write_bad(tmp_path, r"must fill the outer shape to 0\.0001, but take 1\d\d.* of 100", outer=smaller)


def test_a_shape_whose_coordinates_are_too_coarse_for_the_volume_is_refused():
    far = (1e4, 0.0, 0.0)
    outer = OUTER.translate(far)
    solid = solid_of(outer - CHANNEL.translate(far))

    with pytest.raises(StageError, match=r"must fill the outer shape to 0\.0001, .* not far from the origin$"):
        pore_space(outer_of(outer), solid)


def test_a_void_file_with_a_fault_leaves_no_file_of_the_solid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    form = FORMATS["3mf"]

    def write_badly(path: Path, model: Model) -> None:
        mesh = model.mesh if path.stem == "solid" else Mesh(model.mesh.vertices, model.mesh.faces[:, ::-1])
        form.write(path, replace(model, mesh=mesh))

    monkeypatch.setitem(FORMATS, "3mf", FileFormat(write_badly, {"expat": form.readers["expat"]}))

    write_bad(tmp_path, r"^void\.3mf: read by expat: must be outward, .*; no file was kept$")
