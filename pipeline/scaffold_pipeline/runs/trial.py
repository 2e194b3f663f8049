"""Run a stage twice on given inputs and report its side effects: the second part of `testing.check_stage`."""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydantic import ValidationError

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.errors import PipelineError, PipelineWarning
from scaffold_pipeline.runs.runner import OWN_FILES
from scaffold_pipeline.runs.store import Store, hash_file, hash_json
from scaffold_pipeline.stages.contract import Params, Stage
from scaffold_pipeline.stages.faults import parameter_fault, with_article, without_consequences

_CONFIG_HASH = "0" * 64
_CACHES = frozenset({"__pycache__", ".cache"})
_CACHE_VARIABLES = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME")
_DEVICES = Path("/dev")
_CHANGES = {"os.mkdir": 1, "os.remove": 1, "os.rename": 2, "os.rmdir": 1, "os.link": 2, "os.symlink": 2}
"""Python's audit events that change a folder, with the number of their arguments that are paths."""

_FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class _Trial:
    """A stage with all arguments of a call, and the folder that it may write in."""

    stage: Stage
    inputs: Mapping[str, Artifact]
    params: Params
    seed: int
    folder: Path

    def call(self, out: Path, executor: Executor | None) -> Artifact:
        offered: dict[str, Callable[[], object]] = {
            "params": lambda: self.params,
            "rng": lambda: np.random.default_rng(self.seed),
            "out": lambda: out,
            "config_hash": lambda: _CONFIG_HASH,
            "executor": lambda: executor,
        }
        engine = {name: offered[name]() for name in self.stage.engine_arguments}
        with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):  # numpy's own, whatever was set
            return self.stage.function(**self.inputs, **engine)


def run_faults(stage: Stage, inputs: Mapping[str, Artifact], given: Mapping[str, Any] | Params, seed: int) -> list[str]:
    """Return a line for each rule that `stage` breaks when it is run; its own errors are passed on."""
    faults = list(_input_faults(stage, inputs))
    try:
        params = given if isinstance(given, stage.params) else stage.params.model_validate(given, context={"base": "."})
    except ValidationError as error:
        details = without_consequences(error.errors(include_url=False))
        return [*faults, *(f"the given parameters are invalid: {parameter_fault(detail, stage)}" for detail in details)]
    if faults:
        return faults
    with TemporaryDirectory(prefix="stage-trial-") as name, ThreadPoolExecutor(2) as executor:
        trial = _Trial(stage, inputs, params, seed, Path(name).resolve())
        store = Store(trial.folder / "store")
        store.make_folders()
        before = {argument: store.save(value) for argument, value in inputs.items()}
        first = _results_of_call(trial, store, "first", None, faults)
        if not faults:
            second = _results_of_call(trial, store, "second", executor, faults)
            faults += _differences(stage, first, second)
        faults += (
            f"changes its input {argument!r}; return a new artifact instead"
            for argument, value in inputs.items()
            if store.save(value) != before[argument]
        )
    return list(dict.fromkeys(faults))


def _input_faults(stage: Stage, inputs: Mapping[str, Artifact]) -> Iterator[str]:
    for name, read in stage.reads.items():
        if name in inputs and not isinstance(inputs[name], read.type):
            yield f"the input {name!r} must be {with_article(read.type)}, got {with_article(type(inputs[name]))}"
        elif name not in inputs and not read.optional:
            yield f"needs the input {name!r}, {with_article(read.type)}, to be run; give it in `inputs`"
    yield from (f"does not read the given input {name!r}" for name in inputs if name not in stage.reads)


def _results_of_call(
    trial: _Trial, store: Store, name: str, executor: Executor | None, faults: list[str]
) -> dict[str, str]:
    """Call the stage once; return the hashes of its result and of each file, and add its side effects to `faults`."""
    out = trial.folder / name / "out"
    out.mkdir(parents=True)
    with _watch(trial.folder, trial.folder / name, faults):
        output = trial.call(out, executor)
    if not isinstance(output, trial.stage.output):
        faults.append(f"returned {with_article(type(output))}, but its annotation is {trial.stage.output.__name__}")
        return {}
    faults += (
        f"the array {entry.name!r} of its {type(output).__name__} is writable; call `own_array` in __post_init__"
        for entry in fields(output)
        if isinstance(array := getattr(output, entry.name), np.ndarray) and array.flags.writeable
    )
    for path in sorted(out.iterdir()):
        if not path.is_file() or path.name in OWN_FILES or path.name.startswith("."):
            rule = f"`out` may hold only plain files, not named {', '.join(sorted(OWN_FILES))} or with a leading dot"
            faults.append(f"{rule}, got {path.name}")
    files = {path.name: hash_file(path) for path in sorted(out.iterdir()) if path.is_file()}
    return {"": _stored_hash(output, store, faults), **files}


def _stored_hash(output: Artifact, store: Store, faults: list[str]) -> str:
    """Return the hash of an artifact, after checking that it is equal when loaded from the store."""
    kind = type(output).__name__
    try:
        digest, summary = store.save(output), hash_json(output.summary())
        again = store.load(digest)
        is_same = type(again) is type(output) and store.save(again) == digest and hash_json(again.summary()) == summary
    except (TypeError, ValueError, PipelineError) as error:
        faults.append(f"its {kind} cannot be stored and loaded: {error}")
        return ""
    if not is_same:
        faults.append(f"its {kind} differs when loaded from the store; keep all its state in its fields")
    return digest


def _differences(stage: Stage, first: Mapping[str, str], second: Mapping[str, str]) -> Iterator[str]:
    """Yield the results that differ between two equal calls."""
    if not stage.is_repeatable:
        return
    remedy = "draw random numbers from `rng` alone, order sets, or declare it repeatable=False"
    for name in sorted(first.keys() | second.keys()):
        if first.get(name) != second.get(name):
            what = f"file {name}" if name else stage.output.__name__
            yield f"two equal calls give a different {what}; {remedy}"


@contextmanager
def _watch(allowed: Path, place: Path, faults: list[str]) -> Iterator[None]:
    """Put the working directory and temporary files below `place`, and add what a call changes there to `faults`."""
    work, temporary, home = place / "work", place / "temporary", Path.cwd()
    work.mkdir()
    temporary.mkdir()
    state = _random_state()
    os.chdir(work)
    try:
        with _temporary_files_in(temporary), _changes_outside(allowed, faults), _only_our_warnings(faults):
            yield
        if Path.cwd() != work:
            faults.append("changes the working directory; use paths instead")
    finally:
        os.chdir(home)
    if _random_state() != state:
        faults.append("uses numpy's global random numbers; use `rng` alone")
    faults += (f"writes {path.name} into the working directory; use `out`" for path in sorted(work.iterdir()))
    faults += (f"leaves {path.name} among the temporary files; remove it" for path in sorted(temporary.iterdir()))


def _random_state() -> tuple[object, ...]:
    name, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002 - this state itself is checked
    return name, keys.tobytes(), *rest  # type: ignore[union-attr]


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    earlier, variable = tempfile.tempdir, os.environ.get("TMPDIR")
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = earlier
        if variable is None:
            del os.environ["TMPDIR"]
        else:
            os.environ["TMPDIR"] = variable


@contextmanager
def _only_our_warnings(faults: list[str]) -> Iterator[None]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        if not issubclass(warning.category, PipelineWarning):
            place = f"{Path(warning.filename).name}:{warning.lineno}"
            faults.append(
                f"warns {warning.category.__name__} in {place}: {warning.message}; warn users by "
                "scaffold_pipeline.errors.warn, and avoid all other warnings"
            )


class _Auditor:
    """Records changes of files by Python code while it is active, as an audit hook cannot be removed."""

    def __init__(self) -> None:
        self.report: Callable[[Path], None] | None = None
        self.is_installed = False

    def install(self) -> None:
        if not self.is_installed:
            sys.addaudithook(self.hear)
            self.is_installed = True

    def hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.report is None:
            return
        is_write = event == "open" and isinstance(arguments[2], int) and bool(arguments[2] & _FOR_WRITING)
        for path in arguments[: 1 if is_write else _CHANGES.get(event, 0)]:
            if isinstance(path, (str, bytes, os.PathLike)):
                self.report(Path(os.path.abspath(os.fsdecode(path))))  # noqa: PTH100 - does not access the file


_AUDITOR = _Auditor()


@contextmanager
def _changes_outside(allowed: Path, faults: list[str]) -> Iterator[None]:
    """Add to `faults` the files that Python code changes outside `allowed`, caches and devices."""
    places = [allowed, _DEVICES, *(Path(os.environ[name]) for name in _CACHE_VARIABLES if os.environ.get(name))]

    def report(path: Path) -> None:
        if not (any(path.is_relative_to(place) for place in places) or _CACHES & set(path.parts)):
            faults.append(f"writes {path}, outside `out`")

    _AUDITOR.install()
    _AUDITOR.report = report
    try:
        yield
    finally:
        _AUDITOR.report = None
