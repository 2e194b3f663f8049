"""`study` from Python: run a config for several parameter values and collect one table."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from scaffold_pipeline.api.run import Run, open_run
from scaffold_pipeline.api.show import show_page
from scaffold_pipeline.artifacts.markup import facts_table
from scaffold_pipeline.cli.console import watch_study
from scaffold_pipeline.config.draft import settings_from
from scaffold_pipeline.errors import ConfigError, Fault, StageError, did_you_mean
from scaffold_pipeline.processes.threads import computing
from scaffold_pipeline.runs.cache import choose_cache
from scaffold_pipeline.stages.faults import format_value
from scaffold_pipeline.studies.file import Study, read_study
from scaffold_pipeline.studies.page import PAGE
from scaffold_pipeline.studies.study import POINTS, run_study
from scaffold_pipeline.studies.table import PointState, to_table
from scaffold_pipeline.studies.workers import in_process, local_pool

_SHOWN = ("quality", "porosity", "volume_mm3")
"""Metrics of a point shown in a notebook; `table` has all."""


class StudyRun(Mapping[str, Run]):
    """A study and its results: `table`, and the `Run` of each point by its name.

    `study` returns it.

    Parameters
    ----------
    folder : Path
        The study's folder, with `table.csv`, `study.html` and the run of each point.
    columns : tuple of str
        The varied parameters.
    states : list of PointState
        The state of each point.
    """

    def __init__(self, folder: Path, columns: tuple[str, ...], states: list[PointState]) -> None:
        self.folder = folder
        self._columns = columns
        self._states = {state.name: state for state in states}
        self._is_temporary = False

    def remove_folder_at_end(self) -> None:
        """Remove the folder when this object is no longer used, or the process ends."""
        self._is_temporary = True
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)

    @property
    def table(self) -> list[dict[str, object]]:
        """One row for each point, for `pandas.DataFrame`: name, varied parameters, metrics, verdict and error."""
        titles, rows = to_table(self._columns, list(self._states.values()))
        return [dict(zip(titles, row, strict=True)) for row in rows]

    @property
    def errors(self) -> dict[str, str]:
        """The errors of failed points, by their names."""
        return {name: state.error for name, state in self._states.items() if state.error is not None}

    @property
    def page(self) -> Path:
        """The page `study.html`."""
        return self.folder / PAGE

    def show(self) -> None:
        """Show the page in the notebook, or else in the browser."""
        show_page(self.page, is_temporary=self._is_temporary)

    def __getitem__(self, name: str) -> Run:
        if name not in self._states:
            raise KeyError(f"the study has no point {name!r}{did_you_mean(name, self._states)}")
        point = open_run(self.folder / POINTS / name)
        point.keep_alive(self)
        return point

    def __iter__(self) -> Iterator[str]:
        return iter(self._states)

    def __len__(self) -> int:
        return len(self._states)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return f"<StudyRun: {len(self)} points, {len(self.errors)} failed; {self.folder}>"

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder, "_columns": self._columns, "_states": self._states, "_is_temporary": True}

    def _repr_html_(self) -> str:
        shown = {
            state.name: state.error or [f"{key}: {state.metrics[key]}" for key in _SHOWN if key in state.metrics]
            for state in self._states.values()
        }
        return f"<div><strong>{len(self)} points</strong>{facts_table(shown)}</div>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)


def study(  # noqa: PLR0913 - all but one by name, each a choice of its own
    study_file: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    workers: int = 1,
    keep_going: bool = False,
    cache: str | Path | None = None,
    verbose: bool = False,
) -> StudyRun:
    r"""Run a config for all points of a study, as the command `scaffold-pipeline study` does, and return the results.

    Parameters
    ----------
    study_file : path
        The YAML file of the study.
    settings : dict, optional
        Values for all points, by `stage.parameter`.
    out : path, optional
        The study's folder: the same call resumes from its stored results. Without it the study has a temporary folder
        that is removed with the `StudyRun`.
    workers : int, default 1
        Points to run at the same time, each in its own process if more than one. A script must then call this under
        `if __name__ == "__main__":`, as Python requires for new processes.
    keep_going : bool, default False
        Continue with the other points after one has failed; `errors` lists the failed ones.
    cache : path, optional
        Folder of shared results; the environment variable `SCAFFOLD_PIPELINE_CACHE` by default.
    verbose : bool, default False
        Print each finished point on standard error.

    Returns
    -------
    StudyRun
        A mapping of points to runs, with the `table`.

    Raises
    ------
    ConfigError
        The study or one of its configs cannot run; the error has every fault with its place.
    StageError
        A point failed, unless `keep_going`; one line for each failed point.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> config, varied = Path(folder.name, "rod.yaml"), Path(folder.name, "edges.yaml")
    >>> _ = config.write_text("stages: [{use: make_mesh, shape: rod}, {use: extract_outer}]")
    >>> _ = varied.write_text("base: rod.yaml\nvary: {make_mesh.edge: [1.0, 2.0]}")
    >>> edges = study(varied)
    >>> [row["make_mesh.edge"] for row in edges.table]
    [1.0, 2.0]
    >>> edges["edge-2.0"]["outer"].volume
    32.0
    >>> folder.cleanup()
    """
    _require_sensible(study_file, workers)
    asked = read_study(Path(study_file).expanduser(), settings_from(settings), may_be_large=True)
    folder = Path(tempfile.mkdtemp(prefix="scaffold-study-")) if out is None else Path(out).expanduser().absolute()
    try:
        states = _run(asked, folder, workers, cache, keep_going=keep_going, verbose=verbose)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    made = StudyRun(folder, asked.columns, states)
    if out is None:
        made.remove_folder_at_end()
    if made.errors and not keep_going:
        raise StageError("\n".join(f"{name}: {error}" for name, error in made.errors.items()))
    return made


def _require_sensible(study_file: object, workers: object) -> None:
    if not isinstance(study_file, str | Path):
        raise ConfigError([Fault(0, 0, f"a study is the path of a YAML file, got {format_value(study_file)}")])
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ConfigError([Fault(0, 0, f"workers: must be a whole number of 1 at least, got {format_value(workers)}")])


def _run(
    asked: Study, folder: Path, workers: int, cache: str | Path | None, *, keep_going: bool, verbose: bool
) -> list[PointState]:
    shared = choose_cache(cache)
    pool_factory = partial(local_pool, count=workers) if workers > 1 else lambda _count: in_process()
    with computing(), watch_study(quiet=not verbose) as watcher:
        states = run_study(
            asked, folder, cache=shared, pool_factory=pool_factory, keep_going=keep_going, watcher=watcher
        )
    if shared is not None:
        shared.prune()
    return states
