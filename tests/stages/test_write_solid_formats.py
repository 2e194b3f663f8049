"""What each format holds, seen by readers that had no part in writing it."""

from __future__ import annotations

import json
import struct
import zipfile
from pathlib import Path

import lib3mf
import numpy as np
import pytest
import trimesh

from scaffold_geometry.files.solids.formats import FORMATS
from scaffold_pipeline.artifacts import Solid
from scaffold_stages.write_solid import WriteSolidParams, write_solid

HASH = "0123456789abcdef" * 4
READERS = [(kind, name) for kind, form in FORMATS.items() for name in form.readers]
BALL = trimesh.creation.icosphere(3)
STRETCHED = (np.asarray(BALL.vertices) * [1e-3, 30.0, 700.0] + [0.0, 100.0, -1000.0]).astype(np.float32)


def written(out: Path, kind: str, **parameters: object) -> Path:
    params = WriteSolidParams.model_validate({"formats": (kind,), "preview": False, **parameters})
    write_solid(Solid(STRETCHED, np.asarray(BALL.faces)), params=params, out=out, config_hash=HASH)
    return out / f"solid.{kind}"


def read_model(path: Path) -> object:
    model = lib3mf.get_wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))
    return model


def glb_parts(path: Path) -> tuple[dict, bytes]:
    content = path.read_bytes()
    magic, version, length, text_length, text_kind = struct.unpack_from("<4sII I4s", content)
    assert (magic, version, length, text_kind) == (b"glTF", 2, len(content), b"JSON")
    assert text_length % 4 == 0
    binary_length, binary_kind = struct.unpack_from("<I4s", content, 20 + text_length)
    assert (binary_kind, 28 + text_length + binary_length) == (b"BIN\0", length)
    assert binary_length % 4 == 0
    return json.loads(content[20 : 20 + text_length]), content[28 + text_length :]


@pytest.mark.parametrize(("kind", "reader"), READERS)
def test_every_float32_comes_back_to_the_bit(tmp_path: Path, kind: str, reader: str):
    mesh = FORMATS[kind].readers[reader](written(tmp_path, kind))

    assert np.array_equal(mesh.vertices[mesh.faces], STRETCHED[np.asarray(BALL.faces)])


@pytest.mark.parametrize("kind", ["stl", "3mf", "obj", "ply"])
def test_trimesh_finds_the_solid_in_place_and_in_mm(tmp_path: Path, kind: str):
    mesh = trimesh.load_mesh(written(tmp_path, kind))

    assert mesh.is_watertight
    assert np.array_equal(mesh.bounds.astype(np.float32), [STRETCHED.min(axis=0), STRETCHED.max(axis=0)])


def test_a_glb_is_a_scene_in_metres_with_y_up(tmp_path: Path):
    scene = trimesh.load_scene(written(tmp_path, "glb"))
    x, y, z = 0.001 * STRETCHED.astype(np.float64).T

    assert np.allclose(scene.bounds, [[x.min(), z.min(), -y.max()], [x.max(), z.max(), -y.min()]], rtol=1e-12)
    assert scene.to_mesh().volume > 0.0


def test_a_glb_keeps_the_rules_of_gltf(tmp_path: Path):
    text, binary = glb_parts(written(tmp_path, "glb", name="Fersenbein <2> & Knöchel"))
    (primitive,) = text["meshes"][0]["primitives"]
    position, index = (text["accessors"][at] for at in (primitive["attributes"]["POSITION"], primitive["indices"]))
    starts = [
        text["bufferViews"][one["bufferView"]]["byteOffset"] + one.get("byteOffset", 0) for one in (position, index)
    ]
    points = np.frombuffer(binary, "<f4", 3 * position["count"], offset=starts[0]).reshape(-1, 3)
    corners = np.frombuffer(binary, "<u4", index["count"], offset=starts[1])

    assert text["asset"]["version"] == "2.0"
    assert text["asset"]["extras"]["unit"] == "mm"
    assert text["asset"]["extras"]["config_sha256"] == HASH
    assert text["scenes"][0]["name"] == "Fersenbein <2> & Knöchel"
    assert all(view["byteOffset"] % 4 == 0 for view in text["bufferViews"])
    assert sum(view["byteLength"] for view in text["bufferViews"]) == text["buffers"][0]["byteLength"] == len(binary)
    assert (position["componentType"], position["type"], index["componentType"]) == (5126, "VEC3", 5125)
    assert np.array_equal(np.float32([position["min"], position["max"]]), [points.min(axis=0), points.max(axis=0)])
    assert np.array_equal(points[corners].reshape(-1, 3, 3), STRETCHED[np.asarray(BALL.faces)])


def test_a_glb_has_the_colour_in_linear_light(tmp_path: Path):
    text, _ = glb_parts(written(tmp_path, "glb", colour="#ff0080"))

    assert text["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] == [1.0, 0.0, 0.215861, 1.0]


def test_3mf_unit_and_metadata_are_read_back(tmp_path: Path):
    model = read_model(written(tmp_path, "3mf", name="Fersenbein <2> & Knöchel"))
    group = model.GetMetaDataGroup()

    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    assert group.GetMetaDataByKey("", "Title").GetValue() == "Fersenbein <2> & Knöchel"
    assert group.GetMetaDataByKey("", "Application").GetValue().startswith("scaffold-pipeline ")
    assert group.GetMetaDataByKey("urn:scaffold-pipeline", "config_sha256").GetValue() == HASH


@pytest.mark.parametrize(("given", "rgb"), [("#12abEF", (0x12, 0xAB, 0xEF)), (None, (0xE3, 0xDA, 0xC9))])
def test_3mf_colour_is_read_back(tmp_path: Path, given: str | None, rgb: tuple[int, int, int]):
    model = read_model(written(tmp_path, "3mf", **({"colour": given} if given else {})))
    groups, objects = model.GetBaseMaterialGroups(), model.GetMeshObjects()
    assert groups.MoveNext()
    assert objects.MoveNext()
    group = groups.GetCurrentBaseMaterialGroup()
    resource, place, has_one = objects.GetCurrentMeshObject().GetObjectLevelProperty()
    colour = group.GetDisplayColor(place)

    assert has_one
    assert resource == group.GetResourceID()
    assert (colour.Red, colour.Green, colour.Blue, colour.Alpha) == (*rgb, 255)


def test_without_a_hash_the_3mf_names_none(tmp_path: Path):
    params = WriteSolidParams(formats=("3mf",), preview=False)
    write_solid(Solid(STRETCHED, np.asarray(BALL.faces)), params=params, out=tmp_path)

    assert read_model(tmp_path / "solid.3mf").GetMetaDataGroup().GetMetaDataCount() == 2


def test_the_3mf_package_holds_what_the_standard_asks_for(tmp_path: Path):
    with zipfile.ZipFile(written(tmp_path, "3mf")) as package:
        assert package.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]


def test_trimesh_reads_the_3mf_too(tmp_path: Path):
    mesh = trimesh.load_mesh(written(tmp_path, "3mf"), process=False)

    assert np.array_equal(np.float32(mesh.vertices)[mesh.faces], STRETCHED[np.asarray(BALL.faces)])


@pytest.mark.parametrize(("kind", "start"), [("stl", 0), ("obj", 0), ("ply", 0)])
def test_formats_without_metadata_name_project_and_unit(tmp_path: Path, kind: str, start: int):
    head = written(tmp_path, kind).read_bytes()[start : start + 250]

    assert b"scaffold-pipeline" in head
    assert b"unit: mm" in head
    assert kind == "stl" or HASH.encode() in head


def test_either_zero_gives_the_same_bytes(tmp_path: Path):
    box = trimesh.creation.box()
    corners, params = np.asarray(box.vertices) + 0.5, WriteSolidParams(formats=tuple(FORMATS), preview=False)
    contents = []
    for sign in (1.0, -1.0):
        out = tmp_path / str(sign)
        out.mkdir()
        write_solid(Solid(np.where(corners == 0.0, sign * 0.0, corners), np.asarray(box.faces)), params=params, out=out)
        contents.append([path.read_bytes() for path in sorted(out.iterdir())])

    assert contents[0] == contents[1]
