"""The pages as a reader has them: opened from disk in a real Chromium, without a network."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from browser import Browser, Tab, chromium, find_chromium
from pipeline.example_page import write_run
from pipeline.test_page import HOSTILE, METRICS, RECORD, STAGE
from pipeline.test_study_page import STATES, study
from scaffold_pipeline.report.publish import publish_page
from scaffold_pipeline.studies.page import write_page

DRAWN = 8.0
"""Deviation of a picture's values above which something is drawn on it."""

STAGES = [
    {**STAGE, "label": "slow", "seconds": 100.0, "peak_memory_bytes": 5_000_000},
    {**STAGE, "label": "quick", "seconds": 9.5, "peak_memory_bytes": 80_000_000},
    {**STAGE, "label": "middling", "seconds": 25.0, "peak_memory_bytes": 1_000_000_000},
    {**STAGE, "label": "unknown", "seconds": None, "peak_memory_bytes": None},
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if find_chromium() is None:
        pytest.skip("no Chromium is installed, in which the pages would be opened: on Debian, apt-get install chromium")
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a run that has all that a page can show."""
    folder = tmp_path_factory.mktemp("run")
    write_run(folder, {**RECORD, "stages": STAGES}, METRICS)
    return publish_page(folder)


@pytest.fixture
def page(browser: Browser, run: Path) -> Iterator[Tab]:
    tab = browser.open(run)
    tab.wait_until("document.body.classList.contains('has-view')")
    yield tab
    tab.close()


def settled(tab: Tab, selector: str = "#view-canvas") -> np.ndarray:
    """Return the picture of an element when it no longer changes."""
    before = tab.screenshot(selector)
    for _ in range(100):
        after = tab.screenshot(selector)
        if (before == after).all():
            return after
        before = after
    raise TimeoutError(f"{selector} never came to rest")


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the share of pixels that differ."""
    return float((np.abs(first - second).max(axis=2) > 8).mean())


def choose(tab: Tab, control: str, value: str) -> None:
    tab.run(f"(() => {{ const c = document.getElementById({json.dumps(control)}); c.value = {json.dumps(value)};"
            " for (const name of ['input', 'change']) c.dispatchEvent(new Event(name)); })()")  # fmt: skip


def click(tab: Tab, selector: str) -> None:
    tab.run(f"document.querySelector({json.dumps(selector)}).click()")


def labels(tab: Tab) -> list[str]:
    return tab.run("[...document.querySelectorAll('table.stages tbody tr strong')].map((cell) => cell.textContent)")


# The checks find what they are for


@pytest.mark.parametrize(
    "bad",
    [
        "<script>console.error('a fault')</script>",
        "<script>throw new Error('a fault')</script>",
        "<script>Promise.reject(new Error('a fault'))</script>",
        '<meta http-equiv="Content-Security-Policy" content="script-src \'none\'"><script>let a = 1</script>',
        '<img src="nothing_there.png" alt="">',
    ],
)
def test_a_page_with_a_fault_is_found_out(browser: Browser, tmp_path: Path, bad: str):
    (tmp_path / "bad.html").write_text(f"<!DOCTYPE html><title>bad</title>{bad}", encoding="utf-8")
    tab = browser.open(tmp_path / "bad.html")
    assert tab.complaints() != []
    tab.close()


@pytest.mark.parametrize(
    "bad",
    [
        '<img src="http://127.0.0.1:9/a.png" alt="">',
        '<link rel="stylesheet" href="https://127.0.0.1:9/a.css">',
        "<script>fetch('http://127.0.0.1:9/').catch(() => 0)</script>",
        "<style>body { background: url(http://127.0.0.1:9/b.png) }</style>",
    ],
)
def test_a_page_that_asks_a_host_is_found_out(browser: Browser, tmp_path: Path, bad: str):
    (tmp_path / "bad.html").write_text(f"<!DOCTYPE html><title>bad</title>{bad}", encoding="utf-8")
    tab = browser.open(tmp_path / "bad.html")
    assert [address.partition(":9/")[0].partition("//")[2] for address in tab.requests()] == ["127.0.0.1"]
    tab.close()


def test_a_canvas_on_which_nothing_is_drawn_is_found_out(browser: Browser, tmp_path: Path):
    (tmp_path / "bad.html").write_text("<!DOCTYPE html><canvas id='view-canvas'></canvas>", encoding="utf-8")
    tab = browser.open(tmp_path / "bad.html")
    assert settled(tab).std() < DRAWN
    tab.close()


# The page of a run


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_the_page_draws_the_solid_without_a_complaint_and_asks_no_host(browser: Browser, run: Path, *, dark: bool):
    tab = browser.open(run, dark=dark)
    tab.wait_until("document.body.classList.contains('has-view')")
    assert settled(tab).std() > DRAWN
    assert (tab.screenshot().mean() < 100) == dark
    assert tab.complaints() == []
    assert tab.requests() == []
    tab.close()


def test_all_pictures_are_shown(page: Tab):
    widths = page.run("[...document.images].filter((image) => image.offsetParent).map((image) => image.naturalWidth)")
    assert len(widths) == 1
    assert min(widths) > 0


def test_the_clipping_plane_cuts_and_moves(page: Tab):
    whole = settled(page)
    choose(page, "view-axis", "x")
    middle = settled(page)
    assert page.run("document.getElementById('view-place').textContent") == "x = 0.00 mm"
    choose(page, "view-cut", "-2")
    left = settled(page)
    assert page.run("document.getElementById('view-place').textContent") == "x = -2.00 mm"
    click(page, "#view-flip")
    other = settled(page)
    choose(page, "view-axis", "")
    pairs = [(whole, middle), (middle, left), (left, other)]
    assert [difference(*pair) > 0.01 for pair in pairs] == [True, True, True]
    assert difference(settled(page), whole) == 0.0


@pytest.mark.parametrize(
    ("selector", "least"), [("#view-outer", 0.05), ("#view-finding-0", 0.0001), ("#view-finding-1", 0.0001)]
)
def test_what_is_shown_can_be_switched_off_and_on(page: Tab, selector: str, least: float):
    before = settled(page)
    click(page, selector)
    assert difference(settled(page), before) > least
    click(page, selector)
    assert difference(settled(page), before) == 0.0


def test_the_colour_is_that_of_strut_thickness_with_a_legend_or_that_of_bone(page: Tab):
    coloured = settled(page)
    is_shown = "!document.getElementById('view-legend').hidden"
    assert page.run(is_shown)
    assert "1.1 or less" in page.run("document.getElementById('view-legend').textContent")
    choose(page, "view-colour", "bone")
    plain = settled(page)
    assert not page.run(is_shown)
    assert difference(coloured, plain) > 0.02
    is_green = coloured[..., 1] - coloured[..., 0] > 60
    assert is_green.mean() > 0.005 > (plain[..., 1] - plain[..., 0] > 60).mean()


def test_a_drag_turns_the_solid_and_a_wheel_makes_it_larger(page: Tab):
    before = settled(page)
    x, y = page.run(
        "(() => { const canvas = document.getElementById('view-canvas'); canvas.scrollIntoView();"
        " const box = canvas.getBoundingClientRect(); return [box.left + box.width / 2, box.top + 100]; })()"
    )
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + 60, y=y, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x + 60, y=y, **mouse)
    turned = settled(page)
    assert difference(before, turned) > 0.02
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
    larger = settled(page)
    assert difference(turned, larger) > 0.02
    page.run("document.activeElement.blur()")
    still = settled(page)
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
    assert difference(still, settled(page)) == 0.0, "a wheel that moves the page must not change the view"


def test_the_solid_turns_in_steps_unless_the_reader_prefers_that_nothing_moves(browser: Browser, run: Path):
    assert frames_of_a_turn(browser, run, calm=True) < 8 < frames_of_a_turn(browser, run, calm=False)


def frames_of_a_turn(browser: Browser, run: Path, *, calm: bool) -> int:
    page = browser.open(run, calm=calm)
    page.wait_until("document.body.classList.contains('has-view')")
    settled(page)
    page.run("document.getElementById('view-canvas').focus(); window.frames_ = 0; const again = requestAnimationFrame;"
             " window.requestAnimationFrame = (f) => { window.frames_ += 1; return again(f); }; 0")  # fmt: skip
    page.press("ArrowRight")
    settled(page)
    count = page.run("window.frames_")
    page.close()
    return int(count)


def test_every_control_is_reached_by_tab_and_worked_by_keys(page: Tab):
    page.run("document.querySelector('nav a:last-of-type').focus()")
    seen = []
    for _ in range(40):
        page.press("Tab")
        seen.append(page.run("document.activeElement.id || document.activeElement.textContent"))
    wanted = {"view-colour", "view-outer", "view-axis", "view-finding-0", "view-finding-1", "view-canvas", "view-reset"}
    assert wanted <= set(seen)
    assert {"Stage", "Time"} <= set(seen)
    page.run("document.getElementById('view-canvas').focus()")
    first = settled(page)
    changed = []
    for keys in (("ArrowRight",), ("+",), ("ArrowLeft", True)):
        page.press(keys[0], shift=len(keys) > 1)
        changed.append(difference(settled(page), first) > 0.001)
        page.press("Home")
        assert difference(settled(page), first) < 0.002
    assert changed == [True, True, True]


def test_every_control_and_picture_has_a_name_for_those_who_do_not_see_it(page: Tab):
    choose(page, "view-axis", "x")
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    found = [(node["role"]["value"], node.get("name", {}).get("value")) for node in nodes if not node["ignored"]]
    wanted = {"checkbox", "combobox", "slider", "button", "image", "application", "link"}
    named = {role: [name for kind, name in found if kind == role] for role in wanted}
    assert [role for role, names in named.items() if not names or not all(names)] == []
    assert "The solid heel in 3-D, 8 \u00d7 8 \u00d7 8 mm" in named["application"]
    assert named["slider"] == ["at"]


def test_the_slider_of_the_plane_is_worked_by_keys(page: Tab):
    choose(page, "view-axis", "z")
    page.run("document.getElementById('view-cut').focus()")
    before = settled(page)
    page.press("End")
    assert page.run("document.getElementById('view-place').textContent") == "z = 4.00 mm"
    assert difference(before, settled(page)) > 0.01


def test_a_place_to_look_at_comes_into_the_middle_of_the_view(page: Tab):
    before = settled(page)
    click(page, "button[data-finding='0']")
    after = settled(page)
    assert page.run("document.activeElement.id") == "view-canvas"
    middle = after[after.shape[0] // 2 - 3 : after.shape[0] // 2 + 3, after.shape[1] // 2 - 3 : after.shape[1] // 2 + 3]
    assert difference(before, after) > 0.1
    assert np.abs(middle - (0xD5, 0x5E, 0x00)).max() < 120


def test_the_table_of_stages_sorts_by_number_and_back(page: Tab):
    assert labels(page) == ["slow", "quick", "middling", "unknown"]
    click(page, "table.stages th:nth-child(3) button")
    assert labels(page) == ["quick", "middling", "slow", "unknown"]
    click(page, "table.stages th:nth-child(3) button")
    assert labels(page) == ["slow", "middling", "quick", "unknown"]
    assert page.run("document.querySelector('table.stages th:nth-child(3)').getAttribute('aria-sort')") == "descending"
    click(page, "table.stages th:nth-child(4) button")
    assert labels(page) == ["slow", "quick", "middling", "unknown"]


def test_on_paper_a_picture_stands_for_the_view(page: Tab):
    shown = "[...document.querySelectorAll('#view, figure.instead')].map((part) => part.checkVisibility())"
    assert page.run(shown) == [False, True] or page.run(shown) == [True, False]
    on_screen = page.run(shown)
    page.call("Emulation.setEmulatedMedia", media="print")
    assert page.run(shown) == on_screen[::-1]


@pytest.mark.parametrize("how", ["no script", "no WebGL"])
def test_where_the_view_cannot_be_drawn_a_picture_stands_for_it(browser: Browser, run: Path, how: str):
    script = "HTMLCanvasElement.prototype.getContext = () => null" if how == "no WebGL" else ""
    tab = browser.open(run, script=script, is_scripted=how != "no script")
    shown = "['#view', 'figure.instead'].map((part) => document.querySelector(part).checkVisibility())"
    assert tab.run(shown) == [False, True]
    why = tab.run(
        "(() => { const p = document.getElementById('view-none'); return p.checkVisibility() ? p.textContent : ''; })()"
    )
    assert why.endswith("the browser has no WebGL 2.") == (how == "no WebGL")
    assert bool(why) == (how == "no WebGL")
    assert tab.complaints() == []
    tab.close()


def test_no_name_or_measure_that_others_wrote_runs(browser: Browser, tmp_path: Path):
    hostile = HOSTILE + "</script><script>document.title = 'taken'</script>"
    stage = {**STAGE, "label": hostile, "summary": {hostile: hostile}, "warnings": [hostile]}
    record = {**RECORD, "name": hostile, "stages": [stage], "warnings": [hostile], "config": {hostile: hostile}}
    write_run(tmp_path, record, {**METRICS, hostile: hostile, "quality": [hostile]})
    measures = json.loads((tmp_path / "measures.json").read_text())
    for told in (entry for entries in measures.values() for entry in entries):
        told.update({key: hostile for key, value in told.items() if isinstance(value, str)})
    write_run(tmp_path, record, {**METRICS, hostile: hostile}, measures=measures)
    tab = browser.open(publish_page(tmp_path), script="window.alert = () => { document.title = 'taken'; }")
    tab.wait_until("document.body.classList.contains('has-view')")
    assert "taken" not in tab.run("document.title").partition("\u2013")[2]
    assert tab.run("document.querySelectorAll('script').length") == 3
    assert tab.complaints() == []
    assert tab.requests() == []
    tab.close()


# The page of a study


def test_the_page_of_a_study_sorts_and_plots_without_a_complaint_and_asks_no_host(browser: Browser, tmp_path: Path):
    states = [replace(each) for each in STATES]
    for each in states:
        folder = tmp_path / "points" / each.name
        folder.mkdir(parents=True)
        for name in each.record.get("files", ()):
            if name.endswith(".png"):
                Image.new("RGB", (64, 32), (200, 40, 40)).save(folder / name)
    write_page(tmp_path, study(states), states, "points")
    tab = browser.open(tmp_path / "study.html")
    column = "[...document.querySelectorAll('table.points tbody tr')].map((row) => row.cells[3].textContent)"
    click(tab, "table.points th:nth-child(4) button")
    assert tab.run(column) == ["0.25", "0.5", "0.5", "0.75", "", ""]
    tab.run("document.querySelector('table.points th:nth-child(4) button').focus()")
    tab.press("Enter")
    assert tab.run(column) == ["0.75", "0.5", "0.5", "0.25", "", ""]
    assert settled(tab, "#plot svg").std() > DRAWN / 2
    assert tab.complaints() == []
    assert tab.requests() == []
    tab.close()
