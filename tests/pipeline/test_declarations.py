"""Metrics, gates and drawings are what stages declare: in `metrics.json`, in the record and on the page."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.artifacts import Declared, Drawing, Gate, Metric
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.report.declared import declared_of
from scaffold_pipeline.report.publish import publish
from scaffold_pipeline.runs.runner import execute
from scaffold_pipeline.stages.registry import load_stage

THIRD_PARTY = """
    from scaffold_pipeline.artifacts import Artifact, Drawing, Gate, Metric, Metrics
    from scaffold_pipeline.stages.contract import Params, stage

    CURVATURE = Metric("curvature_{end}", "1/mm", "Curvature, {end}", "Cells <prefer> hollows.", "Shape",
                       shown_in=("headline",))

    class CurveParams(Params):
        gate_hollow: bool = True
        "Whether it must be hollow."

    @stage(writes="metrics", version=1, metrics=(CURVATURE, Metric("count", "", "Count", "Of all.", "Shape")),
           gates=(Gate("hollow", "It is hollow.", "gate_hollow"),))
    def curve(*, params: CurveParams) -> Metrics:
        "Measure."
        return Metrics({"zzz": 1, "count": 3, "curvature_most": 0.5, "aaa": 2})
    """
PATTERNS = Declared(
    (
        Metric("size_{axis}", "mm", "Size along {axis}", "{axis} is an axis.", "A"),
        Metric("size_{axis}_error", "", "Error along {axis}", "Of it.", "A"),
        Metric("old", "", "Old", "Goes.", "", instead="new"),
    )
)


def run(project: Project, text: str = "stages: [{use: curve}]") -> Path:
    plan = project.plan(text)
    publish(plan, execute(plan, Path("out")), Path("out"))
    return Path("out")


def words(path: Path) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", path.read_text(encoding="utf-8").partition("</style>")[2]))


def test_a_measure_of_a_third_party_is_on_the_page_by_its_declaration_alone(
    project: Project, install: Callable[..., None]
):
    install("curves", THIRD_PARTY, "curve")
    out = run(project)
    text = words(out / "report.html")
    assert "Shape Curvature, most 0.5" in text
    assert "Cells &lt;prefer&gt; hollows." in text
    assert "hollow passed: It is hollow." in text
    assert "<dt>Curvature, most</dt><dd>0.5" in (out / "report.html").read_text(encoding="utf-8")


def test_metrics_come_in_the_order_of_their_declarations_and_others_after_them(
    project: Project, install: Callable[..., None]
):
    install("curves", THIRD_PARTY, "curve")
    keys = list(json.loads((run(project) / "metrics.json").read_text()))
    assert keys == ["curvature_most", "count", "quality", "seconds", "peak_memory_bytes", "aaa", "zzz"]


PLACE = """
    from scaffold_pipeline.artifacts import Metric, Metrics
    from scaffold_pipeline.stages.contract import Params, stage

    PLACES = (Metric("needle_place", "mm", "Place", "Where it is.", "Shape"),
              Metric("needle_at", "mm", "Place", "Where it is.", "Shape", instead="needle_place"))

    class PlaceParams(Params):
        x: float = 0.5
        "Where."

    @stage(writes="metrics", version=1, metrics=PLACES)
    def place(*, params: PlaceParams) -> Metrics:
        "Measure."
        return Metrics({"needle_place": [params.x, -1.25, 3.0], "needle_at": "0.5, -1.25, 3"}, has_gates=False)
    """


def test_a_place_is_three_numbers_in_files_tables_comparisons_and_on_the_page(
    project: Project, install: Callable[..., None]
):
    install("places", PLACE, "place")
    out = run(project, "stages: [{use: place}]")
    assert json.loads((out / "metrics.json").read_text())["needle_place"] == [0.5, -1.25, 3.0]
    text = words(out / "report.html")
    assert "Place 0.5, -1.25, 3 mm Where it is." in text.replace("\u202f", " ")
    assert "needle_place" in text
    assert "needle_at" not in text
    project.write("base: config.yaml\nvary: {place.x: [0.5, 2.0]}", "study.yaml")
    assert project.command("study", "study.yaml", "--yes").code == 0
    lines = Path("studies/study/table.csv").read_text().splitlines()
    assert ['"[2.0, -1.25, 3.0]"' in line for line in lines] == [False, False, True]
    points = sorted(Path("studies/study/points").iterdir())
    assert "needle_place: [0.5, -1.25, 3.0] | [2.0, -1.25, 3.0]" in project.command("compare", *points).out


def test_the_page_needs_no_installed_stage_but_the_record(project: Project, install: Callable[..., None]):
    install("curves", THIRD_PARTY, "curve")
    out = run(project)
    page = (out / "report.html").read_bytes()
    install("curves", THIRD_PARTY.replace("Curvature, {end}", "Another name"), "curve")
    assert project.command("report", out).code == 0
    assert (out / "report.html").read_bytes() == page


def test_a_record_of_before_is_told_by_the_stages_that_are_installed(project: Project, install: Callable[..., None]):
    install("curves", THIRD_PARTY, "curve")
    out = run(project)
    record = json.loads((out / "run.json").read_text())
    del record["declared"]
    (out / "run.json").write_text(json.dumps(record))
    assert project.command("report", out).code == 0
    assert "Curvature, most 0.5" in words(out / "report.html")
    assert declared_of({"stages": [{"label": "a", "stage": "gone"}]}).gates == ()


def test_of_patterns_the_one_that_says_most_is_taken():
    assert [PATTERNS.metric(key).title for key in ("size_x", "size_x_error")] == ["Size along x", "Error along x"]
    assert PATTERNS.metric("sizes") is None
    assert [PATTERNS.rank(key) for key in ("size_y", "size_y_error", "unknown")] == [0, 1, 3]


def test_declarations_are_the_same_after_json():
    declared = Declared(
        (*PATTERNS.metrics, Metric("a", "", "A", "A.", "A", shown_in=("headline", "caption"))),
        (("measure", Gate("a", "So it is.", "gate_a")),),
        (Drawing("a_{axis}.svg", "A", "", "section"),),
        ("draw",),
    )
    assert Declared.from_json(json.loads(json.dumps(declared.to_json()))) == declared


def test_a_gate_whose_switch_is_no_parameter_is_an_error(install: Callable[..., None]):
    install("curves", THIRD_PARTY.replace('"gate_hollow")', '"gate_holow")'), "curve")
    with pytest.raises(StageDefinitionError, match="gate 'hollow' is switched by 'gate_holow', which is not one of"):
        load_stage("curve")
