"""3MF: what the build names, in its place, by part and number; what is not read is refused by its name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from scaffold_geometry.files.surfaces import three_mf
from scaffold_geometry.files.surfaces.reading import MILLIMETRES, read_surface
from scaffold_geometry.surfaces import triangles
from scaffold_pipeline.errors import PipelineWarning, StageError
from shapes import box

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
TYPES = (
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)


def relations(*targets: str):
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    rows = [f'<Relationship Target="{target}" Id="r{k}" Type="{kind}"/>' for k, target in enumerate(targets)]
    return f'<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">{"".join(rows)}</Relationships>'


def mesh(side: float, extra: str = ""):
    vertices, faces = box((0.0, 0.0, 0.0), (side, side, side))
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in vertices)
    corners = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    return f"<mesh><vertices>{points}</vertices><triangles>{corners}</triangles>{extra}</mesh>"


def thing(number: int, content: str, kind: str = "model", attributes: str = ""):
    return f'<object id="{number}" type="{kind}" {attributes}>{content}</object>'


def model(resources: str, build: str, attributes: str = 'unit="millimeter"'):
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><model {attributes} xmlns="{CORE}" xmlns:p="{PRODUCTION}"><resources>'
        f"{resources}</resources><build>{build}</build></model>"
    )


def item(number: int, transform: str = "", attributes: str = ""):
    return f'<item objectid="{number}" {f"transform={chr(34)}{transform}{chr(34)}" if transform else ""} {attributes}/>'


def written(path: Path, start: str, **others: str):
    members = {"[Content_Types].xml": TYPES, "_rels/.rels": relations("/3D/3dmodel.model"), "3D/3dmodel.model": start}
    with zipfile.ZipFile(path, "w") as package:
        for name, content in {**members, **others}.items():
            package.writestr(name, content)
    return path


@pytest.fixture(autouse=True)
def _read_here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(three_mf, "call_in_child", lambda function, arrays, scalars, **_: function(**arrays, **scalars))


@pytest.fixture
def path(tmp_path: Path):
    return tmp_path / "part.3mf"


def volume(found):
    return float(triangles.piece_volumes(found.vertices, found.faces, np.zeros(len(found.faces), np.int64)).sum())


def bounds(found):
    return [found.vertices.min(axis=0).tolist(), found.vertices.max(axis=0).tolist()]


@pytest.mark.parametrize(
    ("word", "unit"),
    [
        ("micron", "micron"),
        ("millimeter", "mm"),
        ("centimeter", "cm"),
        ("inch", "inch"),
        ("foot", "foot"),
        ("meter", "m"),
    ],
)
def test_each_unit_of_the_specification_is_known(path: Path, word: str, unit: str):
    found = read_surface(written(path, model(thing(1, mesh(2)), item(1), f'unit="{word}"')))
    assert found.unit == unit
    assert unit in MILLIMETRES


def test_a_unit_left_out_is_millimetre(path: Path):
    assert read_surface(written(path, model(thing(1, mesh(2)), item(1), ""))).unit == "mm"


def test_only_what_the_build_names_is_read_and_where_it_puts_it(path: Path):
    resources = thing(1, mesh(2)) + thing(2, mesh(50))
    build = item(1, "1 0 0 0 1 0 0 0 1 10 20 30") + item(1, "2 0 0 0 2 0 0 0 2 -9 0 0")
    found = read_surface(written(path, model(resources, build)))
    assert volume(found) == pytest.approx(8 + 64)
    assert bounds(found) == [[-9, 0, 0], [12, 22, 32]]


def test_components_lie_in_each_other_with_their_transforms(path: Path):
    turn = "0 1 0 -1 0 0 0 0 1 5 0 0"  # a quarter turn about z, and 5 along x
    inner = f'<components><component objectid="1" transform="{turn}"/></components>'
    raised = '<component objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 7"/>'
    outer = f'<components>{raised}<component objectid="1"/></components>'
    resources = thing(1, mesh(2)) + thing(2, inner) + thing(3, outer)
    found = read_surface(written(path, model(resources, item(3, "1 0 0 0 1 0 0 0 1 100 0 0"))))
    assert volume(found) == pytest.approx(16)
    assert bounds(found) == [[100, 0, 0], [105, 2, 9]]


def test_a_mirrored_object_still_faces_outward(path: Path):
    found = read_surface(written(path, model(thing(1, mesh(2)), item(1, "-1 0 0 0 1 0 0 0 1 0 0 0"))))
    assert volume(found) == pytest.approx(8)


def test_parts_that_use_the_same_number_are_kept_apart(path: Path):
    component = '<components><component p:path="/3D/{}.model" objectid="1"/></components>'
    start = model(
        thing(2, component.format("one")) + thing(3, component.format("two")),
        item(2) + item(3, "1 0 0 0 1 0 0 0 1 9 0 0"),
        'unit="millimeter" requiredextensions="p"',
    )
    parts = {f"3D/{name}.model": model(thing(1, mesh(side)), "") for name, side in (("one", 2), ("two", 3))}
    written(path, start, **parts, **{"3D/_rels/3dmodel.model.rels": relations("/3D/one.model", "/3D/two.model")})
    found = read_surface(path)
    assert (len(found.faces), volume(found)) == (24, pytest.approx(8 + 27))


@pytest.mark.parametrize("kind", ["support", "solidsupport", "surface", "other"])
def test_objects_of_other_types_are_left_out_and_said_so(path: Path, kind: str):
    resources = thing(1, mesh(2)) + thing(2, mesh(50), kind)
    found = read_surface(written(path, model(resources, item(1) + item(2))))
    assert volume(found) == pytest.approx(8)
    assert f"left out object 2 of type {kind}" in found.notes


def test_the_start_part_is_the_one_that_the_relations_name(path: Path):
    others = {"_rels/.rels": relations("/3D/Scan.model"), "3D/Scan.model": model(thing(1, mesh(3)), item(1))}
    assert volume(read_surface(written(path, model(thing(1, mesh(2)), item(1)), **others))) == pytest.approx(27)


def test_a_package_without_content_types_is_read(path: Path):
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", relations("/3D/3dmodel.model"))
        package.writestr("3D/3dmodel.model", model(thing(1, mesh(2)), item(1)))
    assert volume(read_surface(path)) == pytest.approx(8)


def test_an_odd_change_of_size_is_warned_of_with_its_factor(path: Path):
    with pytest.warns(PipelineWarning, match="a component changes the size by a factor of 5000; check"):
        read_surface(written(path, model(thing(1, mesh(2)), item(1, "5000 0 0 0 5000 0 0 0 5000 0 0 0"))))


NAMESPACES = {
    "beam lattice": "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02",
    "slice": "http://schemas.microsoft.com/3dmanufacturing/slice/2015/07",
    "secure content": "http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04",
    "volumetric": "http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01",
    "implicit": "http://schemas.3mf.io/3dmanufacturing/implicit/2023/12",
    "displacement": "http://schemas.3mf.io/3dmanufacturing/displacement/2023/10",
    "boolean operations": "http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07",
    "http://example.org/unknown": "http://example.org/unknown",
}


@pytest.mark.parametrize("name", NAMESPACES)
def test_a_required_extension_that_is_not_read_is_refused_by_name(path: Path, name: str):
    attributes = f'unit="millimeter" xmlns:e="{NAMESPACES[name]}" requiredextensions="p e"'
    with pytest.raises(
        StageError, match=rf"requires the extension {name}.*which is not supported; export it as plain"
    ) as said:
        read_surface(written(path, model(thing(1, mesh(2)), item(1), attributes)))
    assert "\n" not in str(said.value)


def test_beams_are_refused_also_where_the_extension_is_optional(path: Path):
    beams = '<b:beamlattice minlength="0.01" radius="1"><b:beams><b:beam v1="0" v2="7"/></b:beams></b:beamlattice>'
    attributes = f'unit="millimeter" xmlns:b="{NAMESPACES["beam lattice"]}"'
    with pytest.raises(StageError, match=r"object 1 has beams .the beam lattice extension., which are not supported"):
        read_surface(written(path, model(thing(1, mesh(2, beams)), item(1), attributes)))


@pytest.mark.parametrize("name", ["anti_overhang_mesh", "infill_mesh", "cutting_mesh", "support_mesh"])
def test_meshes_that_are_no_body_of_their_own_for_a_slicer_are_refused(path: Path, name: str):
    said = f'<metadatagroup><metadata name="cura:{name}" type="xs:string">True</metadata></metadatagroup>'
    attributes = 'unit="millimeter" xmlns:cura="http://software.ultimaker.com/xml/cura/3mf/2015/10"'
    with pytest.raises(StageError, match=f"object 1 is not a separate body for the slicer .{name}"):
        read_surface(written(path, model(thing(1, said + mesh(2)), item(1), attributes)))


SETTINGS = {
    "NegativeVolume": '<volume><metadata type="volume" key="volume_type" value="NegativeVolume"/></volume>',
    "ParameterModifier": '<volume><metadata type="volume" key="volume_type" value="ParameterModifier"/></volume>',
    "modifier": '<volume><metadata type="volume" key="modifier" value="1"/></volume>',
    "negative_part": '<part id="1" subtype="negative_part"/>',
    "modifier_part": '<part id="1" subtype="modifier_part"/>',
    "support_blocker": '<part id="1" subtype="support_blocker"/>',
}


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("member", ["Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config"])
def test_volumes_that_a_slicer_marks_are_refused_by_their_mark(path: Path, member: str, name: str):
    settings = {member: f'<config><object id="1">{SETTINGS[name]}</object></config>'}
    with pytest.raises(StageError, match=rf"a volume of it is marked {name} by the slicer .{member}."):
        read_surface(written(path, model(thing(1, mesh(2)), item(1)), **settings))


def test_settings_of_a_slicer_that_mark_nothing_are_no_matter(path: Path):
    whole = '<part id="1" subtype="normal_part"/><volume><metadata key="volume_type" value="ModelPart"/></volume>'
    settings = {
        "Metadata/model_settings.config": f"<config>{whole}</config>",
        "Metadata/Slic3r_PE.config": "; generated by a slicer\nlayer_height = 0.2\n",
    }
    assert volume(read_surface(written(path, model(thing(1, mesh(2)), item(1)), **settings))) == pytest.approx(8)


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (
            model(thing(1, mesh(2)), ""),
            "has no build items, .*; put the object on the plate and export",
        ),
        (
            model(thing(1, mesh(2), "support"), item(1)),
            "builds no object of type model .left out object 1 of type support",
        ),
        (model(thing(1, mesh(2)), item(7)), "cannot be read as 3MF: lib3mf says"),
        (model(thing(1, mesh(2)), item(1, "0 0 0 0 0 0 0 0 0 1 2 3")), "has a singular or invalid matrix"),
        (model(thing(1, mesh(2)), item(1), 'unit="furlong"'), "its unit is 'furlong', must be one of centimeter, foot"),
        (model(thing(1, mesh(2)), item(1))[:300], "cannot be read as 3MF"),
        ("<html/>", "cannot be read as 3MF"),
        ("", "its XML is damaged"),
    ],
)
def test_what_is_wrong_is_one_line_with_the_file(path: Path, start: str, said: str):
    with pytest.raises(StageError, match=said) as caught:
        read_surface(written(path, start))
    assert str(caught.value).startswith("part.3mf: ")
    assert "\n" not in str(caught.value)


def test_a_package_without_its_start_part_is_refused(path: Path):
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", relations("/3D/lost.model"))
    with pytest.raises(StageError, match=r"names '3D/lost\.model' as its start part, which does not exist"):
        read_surface(path)
