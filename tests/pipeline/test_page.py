from __future__ import annotations

import re
from base64 import b64decode
from html import unescape
from html.parser import HTMLParser
from typing import Any

import pytest

from scaffold_pipeline.report.page import render_page
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
}
PNG = b"\x89PNG\r\n\x1a\n of a kind"
HOSTILE = '<script>alert("x")</script><img src=http://example.org/a.png onerror=x>&amp;'
VOID = {"meta", "img", "br", "wbr", "input", "rect", "line"}


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


def page(record: dict[str, Any] | None = None, metrics: dict[str, Any] | None = None) -> str:
    return render_page({**RECORD, **(record or {})}, {**METRICS, **(metrics or {})}, PNG)


def words(text: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text.partition("</style>")[2]))


def test_the_page_tells_verdict_metrics_stages_and_provenance():
    text = words(page())
    expected = ("heel", "quality pass", "0.6512", "mm³", "tetrahedralise", "reused", "12.7 s", "410.0 MB", "4 536")
    expected += ("mesh: the volume differs", "12" * 32, "34" * 32, "numpy", "Linux", '"edge_length": 5.0')

    assert [phrase for phrase in expected if phrase not in unescape(text)] == []


def test_a_failed_gate_is_a_line_under_the_verdict():
    text = page(metrics={"quality": "certificate: iso is high; lower c; one_piece: 10 pieces; lower porosity"})

    assert '<p class="verdict fail">quality fail</p>' in text
    assert "<li>certificate: iso is high; lower c</li><li>one_piece: 10 pieces; lower porosity</li>" in text


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
    assert "quality not measured" in render_page(RECORD, {}, PNG)


def test_everything_that_others_wrote_is_escaped():
    hostile = {HOSTILE: HOSTILE}
    stage = {
        **STAGE,
        "label": HOSTILE,
        "summary": hostile,
        "warnings": [HOSTILE],
        "inputs": hostile,
    }
    text = page(
        {
            "name": HOSTILE,
            "config": hostile,
            "stages": [stage],
            "warnings": [HOSTILE],
            "files": {HOSTILE: {"sha256": HOSTILE, "bytes": 1}},
            "versions": hostile,
            "platform": hostile,
            "finished": HOSTILE,
        },
        {HOSTILE: HOSTILE, "quality": HOSTILE, "porosity": HOSTILE},
    )
    tags = Tags(text).found

    assert {tag for tag, _ in tags}.isdisjoint({"script", "iframe", "link", "object", "embed", "a"})
    assert [tag for tag, _ in tags].count("img") == 1
    assert not any(name.startswith("on") for _, attributes in tags for name in attributes)


def test_the_page_asks_for_nothing_outside_itself():
    text = page()
    addresses = [
        value or ""
        for _, attributes in Tags(text).found
        for name, value in attributes.items()
        if name in {"src", "href", "srcset", "action", "data", "poster", "xlink:href"}
    ]

    assert all(address.startswith("data:image/png;base64,") for address in addresses)
    assert not re.search(r"url\(|@import|https?://", text)
    assert "default-src 'none'" in text


def test_the_picture_is_in_the_page_to_the_byte():
    assert b64decode(re.search(r'base64,([^"]+)"', page()).group(1)) == PNG  # type: ignore[union-attr]


def test_without_a_picture_the_page_says_so():
    text = render_page(RECORD, METRICS, None)

    assert "No picture was drawn" in text
    assert "<img" not in text


@pytest.mark.parametrize("record", [{}, dict.fromkeys(RECORD), {"stages": [{}]}, {"stages": [dict.fromkeys(STAGE)]}])
def test_what_is_missing_is_a_dash(record: dict[str, Any]):
    for metrics in ({}, dict.fromkeys(METRICS)):
        text = render_page(record, metrics, None)
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
        ({"iso": 0.7}, "lies 0.19 above strut_min, so struts are broken."),
        ({"iso": -0.9}, "lies 0.07 below channel_max, so channels are closed."),
        (
            {"iso": 0.0, "channel_max": 0.1, "strut_min": -0.1},
            "lies 0.1 below channel_max, so channels are closed and 0.1 above strut_min, so struts are broken.",
        ),
        ({"iso": None}, "promise before any voxel"),
        ({"iso": 6.0, "strut_min": 5.0}, "lies 1 above strut_min"),
    ],
)
def test_the_window_says_on_which_side_the_iso_value_is(change: dict[str, Any], judgement: str):
    text = page(metrics=change)

    assert judgement in text
    assert all(0.0 < x < 800.0 for x in marks(text))


def test_a_field_without_a_certificate_has_no_window():
    assert "<svg" not in page(metrics={"channel_max": None})
    assert "<svg" not in page(metrics={"strut_min": float("nan")})


def test_gates_that_had_nothing_to_judge_are_named():
    skipped = ["certificate: the field has none", "interrupted: there is no mesh"]
    told = words(page(metrics=METRICS | {"gates_not_applied": skipped}))
    assert "Gates not applied 2 certificate: the field has none; interrupted: there is no mesh" in told
    assert "Gates not applied" not in page(metrics=METRICS | {"gates_not_applied": []})


def test_a_share_that_is_almost_one_is_not_rounded_to_it():
    assert [to_text(value) for value in (0.99996, 1.0, 0.5)] == ["0.99996", "1", "0.5"]
