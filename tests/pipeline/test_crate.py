from __future__ import annotations

import json
import zipfile
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from pipeline.test_study import BASE, NAMES, OUT, STUDY
from pipeline.test_verification import CONFIG
from pipeline.workplace import Project, harm
from scaffold_pipeline.runs.runner import STORE

pytestmark = pytest.mark.skipif(find_spec("rocrate") is None, reason="rocrate is not installed: [provenance]")

RUN = Path("runs/config")
LICENCE = "https://creativecommons.org/licenses/by/4.0/"


@pytest.fixture
def finished(project: Project) -> Project:
    assert project.command("run", project.write(CONFIG.replace("LOG", str(project.folder / "log")))).code == 0
    return project


def pack(project: Project, folder: Path) -> Any:  # noqa: ANN401 - rocrate has no types
    """Make a crate, unpack it as `crate`, and return it as rocrate reads it back."""
    from rocrate.rocrate import ROCrate

    answer = project.command("crate", folder, "--licence", LICENCE, "--out", "crate.zip", "--json")
    assert answer.code == 0, answer.err
    with zipfile.ZipFile("crate.zip") as archive:
        archive.extractall("crate")
    crate = ROCrate("crate")
    assert answer.json["files"] == len(crate.get_by_type("File"))
    return crate


def test_a_run_comes_back_with_its_files_and_hashes(finished: Project):
    crate = pack(finished, RUN)
    record = finished.record()
    described = {entity.id: entity for entity in crate.get_by_type("File")}
    assert {*record["files"], "run.json"} <= set(described)
    for name, entity in described.items():
        content = (Path("crate") / name).read_bytes()
        assert (entity["sha256"], entity["contentSize"]) == (sha256(content).hexdigest(), str(len(content)))
    assert (crate.name, crate.license, crate.creator) == ("config", LICENCE, None)


def test_a_run_comes_back_with_what_made_it(finished: Project):
    crate, record = pack(finished, RUN), finished.record()
    (action,) = crate.get_by_type("CreateAction")
    assert action["object"].id == "config.yaml"
    assert {entity.id for entity in action["result"]} == {*record["files"], "run.json"} - {"config.yaml"}
    assert (action["instrument"].id, action["endTime"]) == ("#scaffold-pipeline", record["finished"])
    software = {entity["name"]: entity["version"] for entity in crate.get_by_type("SoftwareApplication")}
    assert software == record["versions"]


def test_an_unpacked_run_can_be_verified(finished: Project):
    pack(finished, RUN)
    kept = {path.relative_to("crate") for path in Path("crate", STORE).rglob("*") if path.is_file()}
    assert {path.parts[1] for path in kept} == {"arrays", "artifacts", "results"}
    assert finished.command("verify", "crate").code == 0
    assert (finished.folder / "log").read_text() == "called\n"


def test_a_study_comes_back_with_its_table_and_the_points_that_are_done(project: Project):
    project.write(BASE, "base.yaml")
    project.write(STUDY, "study.yaml")
    assert project.command("study", "study.yaml", "--workers", "1", "--quiet").code == 0
    told = json.loads((OUT / "study.json").read_text())
    told["points"][0]["status"] = "failed"
    (OUT / "study.json").write_text(json.dumps(told))
    crate = pack(project, OUT)
    files = {entity.id for entity in crate.get_by_type("File")}
    assert {"table.csv", "study.json"} <= files
    assert {name.split("/")[1] for name in files if "/" in name} == set(NAMES[1:])
    assert {action["object"].id for action in crate.get_by_type("CreateAction")} == {
        f"points/{name}/config.yaml" for name in NAMES[1:]
    }


def test_what_is_no_finished_run_or_was_changed_becomes_no_crate(finished: Project):
    (finished.folder / "empty").mkdir()
    harm(RUN / "a.txt", "bit")
    for folder, says in [
        ("empty", "there is no record of a finished run"),
        (RUN, "is not the file that the run wrote"),
    ]:
        answer = finished.command("crate", folder, "--licence", LICENCE, "--out", "crate.zip")
        assert (answer.code, says in answer.err) == (1, True)
    assert finished.command("crate", RUN).code == 2
    assert not Path("crate.zip").exists()
