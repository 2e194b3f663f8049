from __future__ import annotations

import re
from base64 import b64decode
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from jinja2 import UndefinedError

from pipeline.example_page import DECLARED, MEASURES, view_file
from scaffold_pipeline.artifacts import Declared, Drawing, Gate, Metric
from scaffold_pipeline.report import rendering, reproducing
from scaffold_pipeline.report.page import render_page
from scaffold_pipeline.report.sources import Sources
from scaffold_pipeline.report.wording import NOTHING, failed_gates, to_text

METRICS: dict[str, Any] = {
    "porosity": 0.6512,
    "porosity_requested": 0.65,
    "iso": 0.31,
    "channel_max": -0.83,
    "strut_min": 0.51,
    "volume_mm3": 24081.2,
    "is_manifold": True,
    "quality": "pass",
}
STAGE: dict[str, Any] = {
    "label": "mesh",
    "stage": "tetrahedralise",
    "version": 2,
    "parameters": {"edge_length": 5.0},
    "inputs": {"outer": "ab" * 32},
    "slot": "mesh",
    "output": "cd" * 32,
    "seconds": 12.7,
    "peak_memory_bytes": 410_000_000,
    "reused": True,
    "seed": None,
    "summary": {"cells": 4536, "sha256": "ef" * 32},
    "warnings": ["the volume differs"],
    "files": {},
}
RECORD: dict[str, Any] = {
    "name": "heel",
    "seed": 7,
    "config": {"name": "heel", "stages": [{"use": "tetrahedralise", "edge_length": 5.0}]},
    "config_sha256": "12" * 32,
    "finished": "2030-01-02T03:04:05+00:00",
    "seconds": 73.4,
    "peak_memory_bytes": 2_100_000_000,
    "stages": [STAGE],
    "warnings": ["mesh: the volume differs"],
    "files": {"solid.stl": {"sha256": "34" * 32, "bytes": 53_561_784}},
    "versions": {"numpy": "2.0"},
    "platform": {"system": "Linux"},
    "declared": DECLARED.to_json(),
}
PNG = b"\x89PNG\r\n\x1a\n of a kind"
HOSTILE = '<script>alert("x")</script><img src=http://example.org/a.png onerror=x>&amp;'
VOID = {"meta", "img", "br", "wbr", "input", "rect", "line", "polyline"}


class Tags(HTMLParser):
    """Checks that tags are balanced and keeps every tag with its attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.opened: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)
        self.close()
        assert self.opened == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in VOID:
            self.opened.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.opened.pop() == tag


SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="12.5mm" height="9mm"><script>alert(1)</script></svg>'


def page(
    record: dict[str, Any] | None = None,
    metrics: dict[str, Any] | None = None,
    measures: dict[str, Any] | None = None,
    **others: object,
) -> str:
    drawn: Any = {"pictures": {"preview.png": PNG}, **others}
    return render_page(Sources({**RECORD, **(record or {})}, {**METRICS, **(metrics or {})}, measures or {}, **drawn))


def words(text: str) -> str:
    told = re.sub(r"<script.*?</script>", " ", text.partition("</style>")[2], flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", told))


def test_the_page_tells_verdict_metrics_stages_and_provenance():
    text = words(page())
    expected = ("heel", "quality pass", "0.6512", "mm³", "tetrahedralise", "reused", "12.7 s", "410.0 MB", "4 536")
    expected += ("mesh: the volume differs", "12" * 32, "34" * 32, "numpy", "Linux", '"edge_length": 5.0')
    expected += ("2030-01-02 03:04:05",)

    assert [phrase for phrase in expected if phrase not in unescape(text)] == []


def test_seeds_are_told_digit_by_digit():
    stage = {**RECORD["stages"][0], "seed": 9876543210123}
    assert "seed 1234567 \u00b7" in words(page({"seed": 1234567}))
    assert page({"seed": 1234567, "stages": [stage]}).count("<code>9876543210123</code>") == 1


def test_a_failed_gate_is_a_line_under_the_verdict():
    text = page(metrics={"quality": "certificate: iso is high; lower c; one_piece: 10 pieces; lower porosity"})

    assert '<p class="verdict fail">quality fail</p>' in text
    assert "certificate failed: iso is high; lower c" in words(text)
    assert "one piece failed: 10 pieces; lower porosity" in words(text)


@pytest.mark.parametrize(
    ("quality", "gates"),
    [
        ("pass", []),
        ("a: b; c: d", ["a: b", "c: d"]),
        ("a: b; or c", ["a: b; or c"]),
        (["a; b"], ["a; b"]),
        ("not measured", None),
        ("", None),
        (None, None),
    ],
)
def test_quality_is_read_as_text_or_list(quality: object, gates: list[str] | None):
    assert failed_gates(quality) == gates


def test_a_run_without_measures_has_no_verdict():
    text = render_page(Sources(RECORD, {}))
    assert "quality not measured" in text
    assert '<ul class="gates">' not in text


def test_everything_that_others_wrote_is_escaped():
    hostile = {HOSTILE: HOSTILE}
    stage = {
        **STAGE,
        "label": HOSTILE,
        "summary": hostile,
        "warnings": [HOSTILE],
        "inputs": hostile,
    }
    measures = {
        "histograms": [{**told, "title": HOSTILE, "unit": HOSTILE, "name": HOSTILE} for told in MEASURES["histograms"]],
        "curves": [{**told, **dict.fromkeys(("title", "x_title", "y_title"), HOSTILE)} for told in MEASURES["curves"]],
        "findings": [{**told, "rule": HOSTILE, "message": HOSTILE} for told in MEASURES["findings"]],
    }
    text = page(
        {
            "name": HOSTILE,
            "config": hostile,
            "stages": [stage],
            "warnings": [HOSTILE],
            "files": {HOSTILE: {"sha256": HOSTILE, "bytes": 1}},
            "versions": {**hostile, "scaffold-pipeline": HOSTILE},
            "platform": hostile,
            "finished": HOSTILE,
        },
        {
            HOSTILE: HOSTILE,
            "quality": [HOSTILE, f"one_piece: {HOSTILE}"],
            "porosity": HOSTILE,
            "gates_not_applied": [f"interrupted: {HOSTILE}"],
        },
        measures,
        config=HOSTILE,
        view=view_file(),
        pictures={"preview.png": PNG, "section_x.svg": SVG, f"{HOSTILE}.png": PNG},
        missing=(HOSTILE,),
    )
    tags = Tags(text).found

    assert {tag for tag, _ in tags}.isdisjoint({"iframe", "link", "object", "embed", "b", "i"})
    assert [tag for tag, _ in tags].count("img") == 3
    assert [attributes.get("type") for tag, attributes in tags if tag == "script"] == [
        *("application/json", "text/plain"),
        None,
    ]
    assert not any(name.startswith("on") for _, attributes in tags for name in attributes)
    assert not re.search(r"<script>alert|<b>", text)


def test_what_a_plug_in_declares_is_escaped():
    declared = Declared(
        metrics=(Metric("porosity", HOSTILE, HOSTILE, HOSTILE, HOSTILE, shown_in=("headline",)),),
        gates=(("mesh", Gate(HOSTILE, HOSTILE, "on")),),
        drawings=(Drawing("preview.png", HOSTILE, HOSTILE, "picture"), Drawing("a.svg", HOSTILE, HOSTILE, "section")),
        viewers=(HOSTILE,),
    )
    stage = {**STAGE, "parameters": {"on": True}, "summary": {"quality": "pass"}}
    text = page({"declared": declared.to_json(), "stages": [stage]}, pictures={"preview.png": PNG, "a.svg": SVG})
    tags = Tags(text).found
    assert text.count("&lt;script&gt;alert(") > 10
    assert [tag for tag, _ in tags].count("script") == 1
    assert [tag for tag, _ in tags].count("img") == 2
    assert not any(name.startswith("on") for _, attributes in tags for name in attributes)


def test_templates_trust_nothing_but_our_own_styles_and_scripts():
    templates = sorted(Path(rendering.__file__).with_name("templates").glob("*.j2"))
    texts = [path.read_text(encoding="utf-8") for path in templates]
    assert len(texts) > 4
    assert not re.search(r"\|\s*safe\b|autoescape|Markup", "".join(texts))


def test_a_name_that_a_template_is_not_given_is_an_error():
    with pytest.raises(UndefinedError, match="'name' is undefined"):
        rendering.render("study.html.j2", styles=(), scripts=())


def test_the_page_asks_for_nothing_outside_itself():
    text = page(measures=MEASURES, view=view_file())
    addresses = [
        value or ""
        for _, attributes in Tags(text).found
        for name, value in attributes.items()
        if name in {"src", "href", "srcset", "action", "data", "poster", "xlink:href"}
    ]
    own = {f"#{attributes['id']}" for tag, attributes in Tags(text).found if tag == "section"}

    assert len(addresses) > 8
    assert all(address.startswith("data:image/png;base64,") or address in own for address in addresses)
    assert not re.search(r"url\(|@import|https?://", text)
    assert re.search(r"default-src 'none'; img-src data:; script-src 'sha256-[^' ]+'; style-src 'unsafe-inline'", text)


def test_the_picture_is_in_the_page_to_the_byte():
    assert b64decode(re.search(r'base64,([^"]+)"', page()).group(1)) == PNG  # type: ignore[union-attr]


def test_without_a_picture_or_a_view_the_page_says_so_and_how_to_have_one():
    text = render_page(Sources({**RECORD, "declared": None, "stages": [STAGE, {**STAGE, "slot": "solid"}]}, METRICS))

    assert "No picture was drawn" in text
    assert "the stage draw_solid , at the end of a config, adds one" in words(text)
    assert "<img" not in text
    assert 'id="view-canvas"' not in text


def test_a_run_without_a_solid_is_not_told_how_to_view_one():
    assert "draw_solid" not in words(page({"declared": None}))


def test_a_view_that_is_damaged_costs_the_view_alone():
    whole = view_file()
    for content in (
        whole[: len(whole) // 2],
        b"",
        b"PK\x03\x04",
        view_file(faces=[[0, 1, 99]]),
        view_file(thickness=[1.0]),
    ):
        text = page(view=content)
        assert "The 3-D view is left out: view.npz" in words(text)
        assert 'id="view-canvas"' not in text
        assert "0.6512" in text


def test_the_view_says_that_it_is_simplified():
    assert "Simplified for this page to 8 of 5 000 000 triangles; the files have all of them" in words(
        page(view=view_file(5_000_000))
    )
    assert "All 8 triangles are shown" in words(page(view=view_file(8)))


def test_a_gate_is_told_as_passed_failed_not_applied_or_switched_off():
    parameters = {
        **dict.fromkeys(("gate_manifold", "gate_one_piece", "gate_interrupted", "gate_of_a_plug_in"), True),
        "gate_porosity": False,
        "min_strut": 0.3,
        "min_throat": None,
        "porosity_tolerance": 0.1,
    }
    stage = {**STAGE, "parameters": parameters, "summary": {"quality": ["one_piece: 3 pieces"]}}
    metrics = {"quality": ["one_piece: 3 pieces"], "gates_not_applied": ["interrupted: there is no mesh"]}
    listed = re.findall(r"<li class.*?</li>", page({"stages": [stage]}, metrics).partition('class="gates"')[2])
    told = [" ".join(re.sub(r"<[^>]*>", "", line).split()) for line in listed]
    assert told == [
        "\u2717 one piece failed: 3 pieces",
        "\u2713 manifold passed: The surface is closed, with two triangles at each edge.",
        "\u2713 of a plug in passed",
        "\u2713 min strut passed: The thinnest strut is as thick as asked for.",
        "\u2013 interrupted not applied: there is no mesh",
        "\u2013 porosity switched off: The porosity is the one asked for.",
    ]


def test_a_metric_that_was_not_measured_is_left_out():
    assert "Strut thickness, mean" not in words(page())
    assert "Strut thickness, mean 0.31 mm" in words(page(metrics={"strut_thickness_mean": 0.31}))
    assert "Strut thickness, mean" not in words(page(metrics={"strut_thickness_mean": None}))


def test_distributions_are_drawings_with_words_and_numbers():
    text = page(measures=MEASURES)
    drawn = re.findall(r'<svg viewBox="0 0 480 300" role="img"><title>(.*?)</title><desc>(.*?)</desc>(.*?)</svg>', text)
    assert [title for title, _, _ in drawn] == ["Strut thickness", "Accessible pores"]
    assert drawn[0][1] == "Shares of the whole from 0.1 to 0.5, mm; mean about 0.2625."
    heights = [float(height) for height in re.findall(r'<rect class="bar"[^>]* height="([\d.]+)"', drawn[0][2])]
    assert [height / heights[1] for height in heights] == pytest.approx([0.5, 1.0, 0.5], abs=0.01)
    assert "0.1 to 0.2 0.25" in words(text)


@pytest.mark.parametrize(
    "told",
    [
        {"edges": [0.0, 1.0], "shares": [float("nan")]},
        {"edges": [0.0], "shares": [1.0]},
        {"edges": "ab", "shares": "c"},
        {"edges": [1.0, 0.0], "shares": [1.0]},
        {},
    ],
)
def test_a_distribution_without_sound_numbers_is_left_out(told: dict[str, Any]):
    assert 'class="plot"' not in page(measures={"histograms": [told], "curves": [{"x": told.get("edges")}]})


def test_a_finding_tells_its_rule_and_leads_to_its_places():
    text = page(measures=MEASURES, view=view_file())
    assert "thin_strut : a strut of 0.1 mm" in words(text)
    assert re.findall(r'data-finding="(\d)" data-place="([^"]*)"', text) == [
        ("0", "0.5 0.25 1.0"),
        ("1", "-1.0 0.0 0.0"),
    ]
    many = [{"rule": "island", "message": "many", "places": [[float(x), 0.0, 0.0] for x in range(300)]}]
    assert "The first 200 of 300 places" in page(measures={"findings": many})


def test_sections_share_a_scale_and_have_words():
    text = page(pictures={"section_x.svg": SVG, "section_z.svg": SVG.replace(b"12.5", b"25")})
    assert re.findall(r"--wide: ([\d.]+)", text) == ["12.5", "25"]
    assert 'alt="Section across x: The solid is filled' in text
    assert "<svg xmlns" not in text
    assert "--wide: " not in page(pictures={"section_x.svg": SVG.replace(b"12.5", b"1.2.5")}).partition("</style>")[2]


def test_the_page_says_how_to_run_it_again_and_with_which_files():
    stage = {**STAGE, "parameters": {"path": "/data/heel.stl"}, "input_files": {"path": "98" * 32}}
    text = words(page({"stages": [stage], "versions": {"scaffold-pipeline": "0.1.0"}}))
    assert "scaffold-pipeline run config.yaml --out again scaffold-pipeline verify . scaffold-pipeline report ." in text
    assert f"/data/heel.stl: SHA-256 {'98' * 32}" in text


def test_the_page_cites_as_citation_cff_does():
    cited = (Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8")
    for text in (f"title: {reproducing.TITLE}", f"name: {reproducing.AUTHORS}", f"abstract: {reproducing.ABOUT}."):
        assert text in cited
    assert f"title: {reproducing.PAPER}" in cited
    assert re.findall(r"family-names: (\w+)", cited) == re.findall(r"(\w+), \w\.", reproducing.PAPER_AUTHORS)
    assert reproducing.PAPER in words(page())


@pytest.mark.parametrize("record", [{}, dict.fromkeys(RECORD), {"stages": [{}]}, {"stages": [dict.fromkeys(STAGE)]}])
def test_what_is_missing_is_a_dash(record: dict[str, Any]):
    for metrics in ({}, dict.fromkeys(METRICS)):
        text = render_page(Sources(record, metrics))
        Tags(text)
        assert "None" not in words(text)
        assert f"<h1>{NOTHING}</h1>" in text


def marks(text: str) -> list[float]:
    return [float(x) for x in re.findall(r'<line x1="([-\d.]+)"', text)]


def test_the_window_shows_the_iso_value_between_its_ends():
    text = page()
    closed, broken, iso = marks(text)

    assert 0.0 < closed < iso < broken < 800.0
    assert iso == pytest.approx(8.0 + (0.31 + 1.0) / 2.0 * 784.0, abs=0.1)
    assert "as sampled, every channel is open and every strut whole" in text


@pytest.mark.parametrize(
    ("change", "judgement"),
    [
        ({"iso": 0.7}, "is 0.19 above strut_min, so some struts are broken."),
        ({"iso": -0.9}, "is 0.07 below channel_max, so some channels are closed."),
        (
            {"iso": 0.0, "channel_max": 0.1, "strut_min": -0.1},
            "is 0.1 below channel_max, so some channels are closed and 0.1 above strut_min, so some struts are broken.",
        ),
        ({"iso": None}, "The certificate of the field, computed before any voxel."),
        ({"iso": 6.0, "strut_min": 5.0}, "is 1 above strut_min"),
    ],
)
def test_the_window_says_on_which_side_the_iso_value_is(change: dict[str, Any], judgement: str):
    text = page(metrics=change)

    assert judgement in text
    assert all(0.0 < x < 800.0 for x in marks(text))


def test_a_field_without_a_certificate_has_no_window():
    assert 'class="window"' in page()
    assert 'class="window"' not in page(metrics={"channel_max": None})
    assert 'class="window"' not in page(metrics={"strut_min": float("nan")})


def test_gates_that_had_nothing_to_judge_are_named():
    skipped = ["certificate: the field has none", "interrupted: there is no mesh"]
    told = words(page(metrics=METRICS | {"gates_not_applied": skipped}))
    assert "certificate not applied: the field has none" in told
    assert "interrupted not applied: there is no mesh" in told
    assert "not applied:" not in words(page(metrics=METRICS | {"gates_not_applied": []}))


def test_a_share_that_is_almost_one_is_not_rounded_to_it():
    assert [to_text(value) for value in (0.99996, 1.0, 0.5)] == ["0.99996", "1", "0.5"]
