"""A finished run or study as an RO-Crate: a ZIP file of its files, with their origin described in JSON-LD.

Soiland-Reyes et al., "Packaging research artefacts with RO-Crate", Data Science 5 (2022).
"""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.provenance.verify import require_files
from scaffold_pipeline.report.sources import RECORD, read_record
from scaffold_pipeline.runs.runner import STORE
from scaffold_pipeline.runs.store import Store, hash_file, write_atomically
from scaffold_pipeline.stages.registry import load_stage
from scaffold_pipeline.studies.table import STUDY_RECORD, TABLE, read_json

if TYPE_CHECKING:
    from rocrate.model.entity import Entity
    from rocrate.rocrate import ROCrate

_VERSION = "1.3"
"""Of the RO-Crate specification."""

_PROGRAM = "scaffold-pipeline"

_FORMATS = {".yaml": "application/yaml", ".3mf": "model/3mf"}
"""Media types that Python's `mimetypes` may lack."""

_DESCRIPTIONS = {
    "config.yaml": "The configuration, with every default written out",
    "measures.json": "Measured distributions, curves and places",
    "metrics.json": "Measured values",
    "report.html": "The result on one page",
    RECORD: "The record: seeds, versions, and the hash of every input, result and file",
    STUDY_RECORD: "The record of the study: what varied, and the state of each point",
    TABLE: "One row per point: the varied parameters and all metrics",
}


def write_crate(folder: Path, target: Path, licence: str) -> int:
    """Write the run or study in `folder` into the ZIP file `target`; return the number of its files.

    Only the finished points of a study are packed. Results that are not deterministic are added from the run's store,
    because `verify` needs them. `licence` is a URL. The crate names no authors: they are not known here.
    Raises `PipelineError` if there is no finished run, or a file differs from its record.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ImportError as error:
        message = "a crate needs rocrate; install it with `pip install 'scaffold-pipeline[provenance]'`"
        raise PipelineError(message) from error
    crate = ROCrate(version=_VERSION)
    study = read_json(folder / STUDY_RECORD)
    runs = _runs(folder, study)
    first = study or read_record(folder)
    crate.name = first["name"]
    crate.description = f"A porous scaffold study of {len(runs)} points" if study else "A porous scaffold"
    crate.license = licence
    software = _add_software(crate, first["versions"])
    if study:
        tables = [
            folder / name for name in (STUDY_RECORD, TABLE, "study.html", "sheet.png") if (folder / name).is_file()
        ]
        _add_files(crate, folder, {path: hash_file(path) for path in tables})
    actions = [_add_run(crate, folder, run, software) for run in runs]
    crate.root_dataset["mentions"] = actions if study else actions[0]
    write_atomically(target, lambda stream: stream.writelines(crate.stream_zip()))
    return len(crate.get_by_type("File"))


def _runs(folder: Path, study: Mapping[str, Any]) -> list[Path]:
    """Return the folders of the finished runs."""
    if not study:
        return [folder]
    done = [folder / "points" / point["name"] for point in study["points"] if point["status"] == "done"]
    if not done:
        raise PipelineError(f"{folder}: no point of the study is finished; run the study first")
    return done


def _add_software(crate: ROCrate, versions: Mapping[str, str]) -> Entity:
    """Add each distribution with its version and package URL; return that of this program."""
    for name, version in versions.items():
        facts = {"name": name, "version": version, "url": f"pkg:pypi/{name}@{version}"}
        crate.add_jsonld({"@id": f"#{name}", "@type": "SoftwareApplication", **facts})
    program = crate.dereference(f"#{_PROGRAM}")
    program["softwareRequirements"] = [{"@id": f"#{name}"} for name in versions if name != _PROGRAM]
    return program


def _add_run(crate: ROCrate, root: Path, folder: Path, software: Entity) -> Entity:
    """Add the files of a run and the action that made them; return the action."""
    record = read_record(folder)
    require_files(folder, record)
    files = {folder / name: facts["sha256"] for name, facts in record["files"].items()}
    files[folder / RECORD] = hash_file(folder / RECORD)
    added = _add_files(crate, root, files)
    _add_files(crate, root, {path: hash_file(path) for path in _unrepeatable_files(folder, record)})
    config = added.pop("config.yaml")
    return crate.add_action(
        software,
        identifier=f"#run-{record['config_sha256'][:12]}-{folder.name}",
        object=config,
        result=list(added.values()),
        properties={"name": f"Run of {record['name']}", "endTime": record["finished"]},
    )


def _add_files(crate: ROCrate, root: Path, files: Mapping[Path, str]) -> dict[str, Entity]:
    """Add files with their hashes; return them by name."""
    added = {}
    for path, digest in files.items():
        kind = _FORMATS.get(path.suffix) or mimetypes.guess_type(path)[0] or "application/octet-stream"
        description = _DESCRIPTIONS.get(path.name, "Written by a stage")
        facts = {"name": path.name, "description": description, "encodingFormat": kind, "sha256": digest}
        facts["contentSize"] = str(path.stat().st_size)
        added[path.name] = crate.add_file(path, path.relative_to(root).as_posix(), properties=facts)
    return added


def _unrepeatable_files(folder: Path, record: Mapping[str, Any]) -> Iterator[Path]:
    """Yield the stored files of the stages that are not deterministic."""
    store = Store(folder / STORE)
    for stage in record["stages"]:
        if not load_stage(stage["stage"]).is_repeatable:
            result = store.result(stage["key"])
            yield from store.paths(stage["key"], result) if result else ()
