"""Planar meshes from end to end: a config in, a judged plate and its drawings out; what does not fit is told first."""

import json
from pathlib import Path

import pytest

from end_to_end.solid_judge import faults_of
from scaffold_pipeline.cli.app import main

PLATE = Path(__file__).parents[2] / "configs" / "plate.yaml"


def test_the_plate_config_makes_a_printable_plate_and_its_drawings(tmp_path):
    assert main(["run", str(PLATE), "--out", str(tmp_path), "--quiet", "--set", "write_solid.preview=false"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    asked = metrics["porosity_requested"]
    for name in ("solid.stl", "solid.3mf"):
        assert faults_of(tmp_path / name, metrics["outer_volume_mm3"], asked) == []
    assert metrics["quality"] == "pass"
    assert metrics["iso"] < metrics["strut_min"]
    assert metrics["holes"] == metrics["cells"] == 48
    assert metrics["outer_volume_mm3"] == pytest.approx(40.0 * 30.0 * 2.0)
    drawn = {"contour.svg", "contour.png", "view.npz", "section_x.svg", "section_y.svg", "section_z.svg"}
    assert drawn <= {path.name for path in tmp_path.iterdir()}
    page = (tmp_path / "report.html").read_bytes()
    assert b'id="view-canvas"' in page
    assert page.count(b"data:image/svg+xml") == 4
    assert main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").read_bytes() == page


PLANAR = "make_planar_mesh"
UNFIT = {
    "a planar mesh where a body's is moved": (
        [PLANAR, "jitter"],
        "(jitter): reads slot 'mesh' as VolumeMesh, but stages.0 (make_planar_mesh) writes a PlanarMesh",
    ),
    "a body's mesh where a planar one is moved": (
        ["make_shape", "tetrahedralise", "jitter_planar"],
        "(jitter_planar): reads slot 'mesh' as PlanarMesh, but stages.1 (tetrahedralise) writes a VolumeMesh",
    ),
    "a contour of a body's mesh": (
        ["make_shape", "tetrahedralise", "arbf_field", "contour"],
        "(contour): reads slot 'mesh' as PlanarMesh, but stages.1 (tetrahedralise) writes a VolumeMesh",
    ),
    "an outer shape of a planar mesh": (
        [PLANAR, "extract_outer"],
        "(extract_outer): reads slot 'mesh' as VolumeMesh, but stages.0 (make_planar_mesh) writes a PlanarMesh",
    ),
    "an iso-surface of a planar chain": (
        [PLANAR, "arbf_field", "isosurface"],
        "(isosurface): reads slot 'outer', which no stage before it writes; add one of: ",
    ),
    "a clip of a contour": (
        [PLANAR, "arbf_field", "contour", "intersect_outer"],
        "(intersect_outer): reads slot 'porous', which no stage before it writes; add one of: isosurface",
    ),
    "a plate of an iso-surface": (
        ["make_shape", "tetrahedralise", "arbf_field", "isosurface", "extrude"],
        "(extrude): reads slot 'contour', which no stage before it writes; add one of: contour",
    ),
    "a plate measured as a body": (
        [PLANAR, "arbf_field", "contour", "extrude", "measure"],
        "(measure): reads slot 'porous', which no stage before it writes; add one of: isosurface",
    ),
}
NEEDED = {
    "arbf_field": "voxel_size: 0.1",
    "contour": "porosity: 0.3",
    "extrude": "height: 2",
    "isosurface": "porosity: 0.5",
    "tetrahedralise": "edge_length: 8",
}


@pytest.mark.parametrize("case", UNFIT)
def test_a_plane_where_a_body_is_read_and_the_reverse_are_faults_of_the_config(case, tmp_path, capsys):
    names, said = UNFIT[case]
    entries = "".join(f"  - use: {name}\n" + (f"    {NEEDED[name]}\n" if name in NEEDED else "") for name in names)
    config = tmp_path / "config.yaml"
    config.write_text(f"name: unfit\nseed: 1\nstages:\n{entries}")
    assert main(["validate", str(config)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert any(said in line and f"stages.{len(names) - 1} " in line for line in lines)
