"""`run` a config from Python, or `open_run` a finished one; both return a `Run` with all results."""

from __future__ import annotations

import json
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scaffold_pipeline.api.show import run_html, show_page
from scaffold_pipeline.artifacts import Artifact, Fact
from scaffold_pipeline.cli.console import watch
from scaffold_pipeline.config.draft import make_draft, read_document, settings_from
from scaffold_pipeline.config.plan import Plan, make_plan
from scaffold_pipeline.config.yaml_source import Document
from scaffold_pipeline.errors import ConfigError, Fault, PipelineError, did_you_mean, warn
from scaffold_pipeline.processes.threads import computing
from scaffold_pipeline.report.publish import publish, run_metrics
from scaffold_pipeline.report.sources import METRICS, PAGE, read_record
from scaffold_pipeline.report.wording import failed_gates
from scaffold_pipeline.runs.cache import choose_cache
from scaffold_pipeline.runs.runner import STORE, RunResult, execute, locked
from scaffold_pipeline.runs.store import Store
from scaffold_pipeline.stages.faults import format_value, to_plain

Config = str | Path | Mapping[str, Any]


class Run(Mapping[str, Artifact]):
    """A run and its results: `run["solid"]` is the value of the slot `solid`, `run["jitter"]` the result of that stage.

    It maps the names of slots to artifacts. An artifact is read from the run's folder at its first use, and kept.
    `run` and `open_run` return it.

    Parameters
    ----------
    folder : Path
        The run's folder.
    record : mapping
        The content of `run.json`: seed, config, stages, hashes, versions, warnings.
    metrics : mapping
        The content of `metrics.json`, by key: lengths mm, volumes mm^3, porosity from 0 to 1.

    Examples
    --------
    >>> from scaffold_pipeline import run
    >>> small = run({"stages": [{"use": "make_mesh", "shape": "rod"}, {"use": "extract_outer"}]})
    >>> list(small), small["outer"].volume
    (['mesh', 'outer'], 4.0)
    >>> small.quality
    'not measured'
    """

    def __init__(self, folder: Path, record: Mapping[str, Any], metrics: Mapping[str, Fact]) -> None:
        self.folder = folder
        self.record = record
        self.metrics = metrics
        self._values: dict[str, Artifact] = {}
        self._is_temporary = False
        self._owner: object = None

    def remove_folder_at_end(self) -> None:
        """Remove the folder when this object is no longer used, or the process ends."""
        self._is_temporary = True
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)

    def keep_alive(self, owner: object) -> None:
        """Keep `owner`, whose temporary folder contains this run's folder, as long as this run is used."""
        self._owner = owner

    @property
    def quality(self) -> Fact:
        """The verdict: `pass`, `not measured`, or a list with one line for each failed quality gate."""
        return self.metrics.get("quality")

    @property
    def failed_gates(self) -> tuple[str, ...]:
        """The failed quality gates, one line each."""
        return tuple(failed_gates(self.quality) or ())

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of the stages about results that are still valid."""
        return tuple(self.record["warnings"])

    @property
    def files(self) -> dict[str, Path]:
        """The files of the run's folder, by name; none if the run was stopped early."""
        return {name: self.folder / name for name in self.record["files"]}

    @property
    def page(self) -> Path:
        """The page `report.html`; raises `PipelineError` if the run was stopped before it was written."""
        if PAGE not in self.record["files"]:
            raise PipelineError(f"{self.folder}: has no {PAGE}, as the run was stopped early; run it to the end")
        return self.folder / PAGE

    def show(self) -> None:
        """Show the page in the notebook, or else in the browser.

        Raises
        ------
        PipelineError
            The run was stopped early and has no page, or its folder was removed.
        """
        page = self.page
        self._require_folder()
        show_page(page, is_temporary=self._is_temporary or self._owner is not None)

    def __getitem__(self, name: str) -> Artifact:
        hashes = self._hashes()
        if name not in hashes:
            raise KeyError(f"the run has no slot or stage {name!r}{did_you_mean(name, hashes)}")
        digest = hashes[name]
        if digest not in self._values:
            self._require_folder()
            self._values[digest] = Store(self.folder / STORE).load(digest)
        return self._values[digest]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(stage["slot"] for stage in self.record["stages"]))

    def __len__(self) -> int:
        return len({stage["slot"] for stage in self.record["stages"]})

    def __contains__(self, name: object) -> bool:
        return name in self._hashes()

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return f"<Run {self.record['name']!r}: {', '.join(self)}; quality: {self.quality}; {self.folder}>"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_values": {}, "_owner": None}  # the folder belongs to the original

    def _hashes(self) -> dict[str, str]:
        """Return the hash of each slot by its name, and then of each stage's result by the stage's label."""
        stages = self.record["stages"]
        labels = {stage["label"]: stage["output"] for stage in stages}
        return {**labels, **{stage["slot"]: stage["output"] for stage in stages}}

    def _require_folder(self) -> None:
        if not self.folder.is_dir():
            rule = "the folder of a run without `out` is removed with the Run that `run` returned; give out=FOLDER"
            raise PipelineError(f"{self.folder}: no such folder; {rule}")

    def _repr_html_(self) -> str:
        return run_html(self.folder, self.record, self.metrics)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._hashes())


def run(
    config: Config,
    *,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    until: str | None = None,
    cache: str | Path | None = None,
    verbose: bool = False,
) -> Run:
    """Run a config, as the command `scaffold-pipeline run` does, and return its results.

    All artifacts and files have the same hashes as those of the command. A process runs one config at a time.

    Parameters
    ----------
    config : path or dict
        A YAML file, or its content, with file paths relative to the current folder.
    settings : dict, optional
        Values that replace the config's, by `stage.parameter`, as in `--set`.
    out : path, optional
        The run's folder: a later run there resumes from its stored results. Without it the run has a temporary folder
        that is removed with the `Run`.
    until : str, optional
        Stop after this stage; no files are written then.
    cache : path, optional
        Folder of shared results; the environment variable `SCAFFOLD_PIPELINE_CACHE` by default.
    verbose : bool, default False
        Print each finished stage on standard error.

    Returns
    -------
    Run
        A mapping of slots to artifacts, with `metrics`, `files` and the verdict. A failed quality gate is not an
        error: it is listed in `failed_gates`.

    Raises
    ------
    ConfigError
        The config cannot run; the error has every fault with its place.
    StageError
        A stage failed; the results of earlier stages stay in `out`.

    Examples
    --------
    >>> config = {"stages": [{"use": "make_mesh", "shape": "block", "counts": 2}, {"use": "extract_outer"}]}
    >>> run(config, settings={"make_mesh.edge": 3.0})["outer"].volume
    216.0
    >>> run(config, settings={"make_mesh.edge": -1.0})
    Traceback (most recent call last):
    scaffold_pipeline.errors.ConfigError: settings['make_mesh.edge']: stages.0 (make_mesh): edge: must be greater than 0, got -1.0
    """  # noqa: E501 - the last line is what Python prints
    plan = make_plan(make_draft(_document(config), settings_from(settings)))
    if until is not None and until not in plan.labels:
        raise ConfigError([Fault(0, 0, f"until: the config has no stage {until!r}{did_you_mean(until, plan.labels)}")])
    if not isinstance(out, str | Path | None):
        raise ConfigError([Fault(0, 0, f"out: must be the path of a folder, got {format_value(out)}")])
    folder = Path(tempfile.mkdtemp(prefix="scaffold-run-")) if out is None else Path(out).expanduser().absolute()
    try:
        made = _execute(plan, folder, until, cache, verbose=verbose)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if out is None:
        made.remove_folder_at_end()
    for message in made.warnings:
        warn(message)
    return made


def open_run(folder: str | Path) -> Run:
    """Return the finished run in a folder, made by the command or by `run` with `out`.

    Parameters
    ----------
    folder : path
        The folder of a run, or of a point of a study.

    Raises
    ------
    PipelineError
        The folder has no record of a finished run.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> made = run({"name": "rod", "stages": [{"use": "make_mesh", "shape": "rod"}]}, out=folder.name)
    >>> len(open_run(folder.name)["mesh"].hexahedra)
    4
    >>> folder.cleanup()
    """
    place = Path(folder).expanduser().absolute()
    record = read_record(place)
    metrics = json.loads((place / METRICS).read_text(encoding="utf-8")) if METRICS in record["files"] else {}
    return Run(place, record, metrics)


def _document(config: Config) -> Document:
    if isinstance(config, Mapping):
        return Document("", to_plain(config), {})
    if isinstance(config, str | Path):
        return read_document(Path(config).expanduser(), "a config is a mapping with the keys name, seed and stages")
    raise ConfigError([Fault(0, 0, f"a config is the path of a YAML file or a dict, got {format_value(config)}")])


def _execute(plan: Plan, folder: Path, until: str | None, cache: str | Path | None, *, verbose: bool) -> Run:
    shared = choose_cache(cache)
    with computing(), locked(folder), watch(quiet=not verbose) as progress:
        result = execute(plan, folder, until=until, progress=progress, cache=shared)
        if result.is_complete:
            publish(plan, result, folder)
    if shared is not None:
        shared.prune()
    if result.is_complete:
        return open_run(folder)
    return Run(folder, _partial_record(plan, result), run_metrics(result))


def _partial_record(plan: Plan, result: RunResult) -> dict[str, Any]:
    """Return the record of a run that was stopped early, without files."""
    warnings = [*result.warnings, *(f"{step.label}: {message}" for step in result.steps for message in step.warnings)]
    stages = [asdict(step) for step in result.steps]
    config = plan.resolved()
    return {"name": plan.name, "seed": plan.seed, "config": config, "stages": stages, "warnings": warnings, "files": {}}
