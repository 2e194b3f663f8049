from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from html import unescape
from pathlib import Path
from shutil import which

import pytest
from PIL import Image

from pipeline.test_page import HOSTILE, Tags
from pipeline.workplace import Project
from scaffold_pipeline.config.yaml_source import Document, parse
from scaffold_pipeline.studies import page
from scaffold_pipeline.studies.file import Point, Study
from scaffold_pipeline.studies.page import write_page
from scaffold_pipeline.studies.table import PointState

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := which(name))), None)
COLUMNS = ("field.interpolation", "mesh.counts")
WIDE, HIGH = (640, 320), (200, 400)


def study(states: list[PointState]) -> Study:
    points = tuple(Point(state.name, state.varied, Document("", {}, {}), ()) for state in states)
    return Study("beyond", COLUMNS, points, "Where does it end?")


def state(kind: str, count: int, porosity: float | None, files: tuple[str, ...] = ("mesh.png",)) -> PointState:
    record = {"files": {name: {} for name in files}}
    metrics = {"porosity": porosity, "iso": 0.0, "is_manifold": True, "quality": "pass"}
    return PointState(f"{kind}-{count}", dict(zip(COLUMNS, (kind, count), strict=True)), "done", None, record, metrics)


STATES = [
    state("exact", 10, 0.25),
    state("exact", 9, 0.75),
    state("normalised", 9, 0.5, ("preview.png", "solid.stl", "mesh.png")),
    replace(state("normalised", 10, 0.5), metrics={"porosity": 0.5, "quality": ["one_piece: 3 pieces; lower it"]}),
    replace(state("normalised", 11, None), status="failed", error="field: too large", record={}, metrics={}),
    replace(state("normalised", 12, None), status="waiting", record={}, metrics={}),
]


def draw_pictures(out: Path, states: list[PointState]) -> None:
    for each in states:
        folder = out / "points" / each.name
        folder.mkdir(parents=True)
        (folder / "report.html").touch()
        for name in each.record.get("files", ()):
            if name.endswith(".png"):
                Image.new("RGB", WIDE if name == "mesh.png" else HIGH, (200, 40, 40)).save(folder / name)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    draw_pictures(tmp_path, STATES)
    (tmp_path / "table.csv").touch()
    write_page(tmp_path, study(STATES), STATES, "points")
    return tmp_path


def text_of(out: Path) -> str:
    return (out / "study.html").read_text(encoding="utf-8")


def said(text: str) -> str:
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", text.partition("</style>")[2])))


def links(text: str) -> list[str]:
    return [value or "" for tag, attributes in Tags(text).found for key, value in attributes.items() if key == "href"]


# What the page tells


def test_the_page_counts_what_became_of_the_points_and_says_what_varied(out: Path):
    text = said(text_of(out))
    expected = ("3 passed", "1 failed a quality gate", "1 failed with an error", "1 not run", "Where does it end?")
    expected += ("field.interpolation : exact, normalised", "mesh.counts : 10, 9, 11, 12")
    assert [phrase for phrase in expected if phrase not in text] == []


def test_points_that_no_gate_has_judged_have_not_passed(tmp_path: Path):
    states = [replace(STATES[0], metrics={"quality": "not measured"}, record={})]
    write_page(tmp_path, study(states), states, "points")
    assert "1 without quality gates" in said(text_of(tmp_path))
    assert "passed" not in said(text_of(tmp_path))


def test_cards_come_in_the_order_of_the_points_with_what_was_measured(out: Path):
    cards = re.findall(r'<figure class="card">.*?</figure>', text_of(out))
    assert [re.search(r"<h3>(.*?)</h3>", card)[1].rpartition("<")[0].rpartition(">")[2] for card in cards[:4]] == [
        each.name for each in STATES[:4]
    ]
    verdicts = [said("</style>" + re.search(r"<p class=.*?</p>", card)[0]).strip() for card in cards]
    assert verdicts == [
        "porosity 0.25, iso 0, quality pass",
        "porosity 0.75, iso 0, quality pass",
        "porosity 0.5, iso 0, quality pass",
        "porosity 0.5, quality gates failed: one_piece",
        "failed: field: too large",
        "not run",
    ]


def test_the_mesh_stands_beside_the_solid_small_and_linked_to_the_whole_picture(out: Path):
    cards = re.findall(r'<figure class="card">.*?</figure>', text_of(out))
    sources = [re.findall(r'href="([^"]*png)"', card) for card in cards]
    assert sources[2] == ["points/normalised-9/mesh.png", "points/normalised-9/preview.png"]
    assert cards[2].count("data:image/jpeg;base64,") == 2
    assert "no picture" in cards[4]


def test_what_a_config_says_of_itself_is_its_caption():
    text = "# yaml-language-server: $schema=schema.json\n#\n# One cell:\n#   its pores.\nname: a\n# not this\n"
    assert parse(text, "a.yaml").comment == "One cell: its pores."
    assert parse("name: a\n", "a.yaml").comment == ""


def test_the_table_has_all_that_table_csv_has(project: Project):
    base = "# What it shows.\nstages: [{use: make_points}, {use: write_points, names: [mesh.png]}, {use: count_points}]"
    project.write(base, "a.yaml")
    project.write("runs: [a.yaml]", "study.yaml")
    assert project.command("study", "study.yaml").code == 0
    text = text_of(Path("studies/study"))
    titles = [title.replace("<wbr>", "") for title in re.findall(r'<th scope="col">(.*?)</th>', text)]
    assert ",".join(titles) == Path("studies/study/table.csv").read_text().splitlines()[0]
    assert "What it shows." in text


def test_a_seed_can_be_copied_from_the_table_digit_by_digit(tmp_path: Path):
    states = [replace(state("exact", count, 0.5), varied={"seed": 4398626441190084260 + count}) for count in (9, 10)]
    write_page(tmp_path, replace(study(states), columns=["seed"]), states, "points")
    text = text_of(tmp_path)
    assert {"<td>4398626441190084269</td>", "<td>4398626441190084270</td>"} <= set(re.findall("<td>.*?</td>", text))


# What it may not do


def test_every_link_is_relative_and_leads_to_a_file(out: Path):
    found = links(text_of(out))
    assert len(found) > 8
    assert [link for link in found if not (out / link).is_file()] == []


def test_the_page_asks_for_nothing_outside_itself_and_runs_its_own_script_alone(out: Path):
    text = text_of(out)
    assert not re.search(r"url\(|@import|https?:|//[a-z]", re.sub(r"//\s.*", "", text))
    assert re.search(r"default-src 'none'; img-src data:; script-src 'sha256-[^' ]+'; style-src 'unsafe-inline'", text)


def test_nothing_that_others_wrote_becomes_markup(tmp_path: Path):
    hostile = HOSTILE + "</script><!--"
    varied, metrics = {hostile: hostile}, {hostile: hostile, "quality": [hostile], "porosity": hostile}
    states = [PointState(hostile, varied, "done", None, {"files": {}}, metrics)]
    states += [PointState("picture", {}, "done", None, {"files": {"mesh.png": {}, "<b>.png": {}}}, metrics)]
    states += [PointState("failed", {}, "failed", hostile)]
    points = tuple(replace(point, caption=hostile) for point in study(states).points)
    (tmp_path / "points/picture").mkdir(parents=True)
    Image.new("RGB", WIDE).save(tmp_path / "points/picture/mesh.png")
    write_page(tmp_path, Study(hostile, (hostile,), points, hostile), states, "points")
    tags = Tags(text_of(tmp_path)).found
    assert [tag for tag, _ in tags].count("script") == 2
    assert [tag for tag, _ in tags].count("img") == 1
    assert {tag for tag, _ in tags}.isdisjoint({"b", "iframe", "link", "object", "embed"})
    assert not any(name.startswith("on") for _, attributes in tags for name in attributes)
    data = text_of(tmp_path).partition('id="data">')[2].partition("</script>")[0]
    assert json.loads(data)["rows"][0][:2] == [hostile, hostile]


# Pictures that are missing


def test_a_picture_that_cannot_be_read_is_named_and_the_sheet_is_drawn_all_the_same(out: Path):
    picture = out / "points" / "exact-10" / "mesh.png"
    picture.write_bytes(picture.read_bytes()[:50])
    write_page(out, study(STATES), STATES, "points")
    assert "exact-10: mesh.png cannot be read" in text_of(out)
    with Image.open(out / "sheet.png") as sheet:
        sheet.load()


def test_without_any_picture_the_page_says_what_draws_them_and_an_earlier_sheet_goes(out: Path):
    states = [replace(each, record={}) for each in STATES]
    write_page(out, study(states), states, "points")
    assert "No picture was drawn: the stages draw_mesh" in said(text_of(out))
    assert not (out / "sheet.png").exists()


def test_a_sheet_of_too_many_points_says_so(out: Path, monkeypatch: pytest.MonkeyPatch):
    titles = []
    monkeypatch.setattr(page, "MOST_ON_SHEET", 2)
    monkeypatch.setattr(
        "scaffold_pipeline.report.contact_sheet.draw_sheet",
        lambda title, cells: titles.append((title, len(cells))) or Image.new("RGB", (1, 1)),
    )
    write_page(out, study(STATES), STATES, "points")
    assert titles == [("beyond: the first 2 of 6 points", 2)]


# What its script does


def dom(page: Path, script: str = "", fragment: str = "") -> str:
    """Return the page as a browser has it after `script`, which its policy would forbid."""
    if CHROMIUM is None:
        pytest.skip("no chromium is installed, whose DOM would show what the script did")
    text = page.read_text(encoding="utf-8")
    free = re.sub(r"<meta http-equiv[^>]*>", "", text) if script else text
    copy = page.with_name("copy.html")
    copy.write_text(free.replace("</body>", f"<script>{script}</script></body>"), encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    command = [CHROMIUM, *flags.split(), f"--user-data-dir={page.parent / 'chromium'}", "--virtual-time-budget=2000"]
    shown = subprocess.run(
        [*command, "--dump-dom", f"{copy.as_uri()}#{fragment}"], capture_output=True, text=True, timeout=60, check=False
    )
    if shown.returncode != 0:
        pytest.skip(f"chromium cannot run here: {shown.stderr[-200:]}")
    return shown.stdout


def test_the_script_draws_what_is_asked_for_under_the_pages_own_policy(out: Path):
    shown = dom(out / "study.html", fragment="y=porosity&x=mesh.counts")
    drawing = shown.partition('<section id="plot">')[2].partition("</section>")[0]
    dots = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)".*?<title>([^:]*): porosity ([\d.]+)', drawing)
    assert [(name, value) for _, _, name, value in dots] == [
        ("exact-10", "0.25"), ("exact-9", "0.75"), ("normalised-9", "0.5"), ("normalised-10", "0.5"),
    ]  # fmt: skip
    assert float(dots[0][0]) > float(dots[1][0])
    assert float(dots[0][1]) > float(dots[2][1]) > float(dots[1][1])
    assert drawing.count("<polyline") == 2
    assert "porosity against mesh.counts" in drawing


def test_the_table_sorts_by_number_with_empty_cells_last_and_filters_by_words(out: Path):
    script = """
        const button = (title) => [...document.querySelectorAll("th button")].find((b) => b.textContent === title);
        button("mesh.counts").click();
        const column = (index) => [...document.querySelectorAll(".points tbody tr:not([hidden])")].map(
            (row) => row.cells[index].textContent);
        const told = [column(2)];
        button("porosity").click();
        button("porosity").click();
        told.push(column(3));
        told.push(button("porosity").parentNode.getAttribute("aria-sort"));
        const words = document.querySelector("#filter input");
        words.value = "EXACT 0.75";
        words.dispatchEvent(new Event("input"));
        told.push(column(0));
        told.push(document.querySelectorAll("#plot circle").length, document.querySelector("#filter output").value);
        document.title = JSON.stringify(told);
    """
    shown = dom(out / "study.html", script)
    counts, porosities, order, found, dots, told = json.loads(
        unescape(re.search(r"<title>(\[.*?\])</title>", shown)[1])
    )
    assert counts == ["9", "9", "10", "10", "11", "12"]
    assert porosities == ["0.75", "0.5", "0.5", "0.25", "", ""]
    assert order == "descending"
    assert (found, dots, told) == (["exact-9"], 1, "1 of 6 points")
