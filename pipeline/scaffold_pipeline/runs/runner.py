"""Run a plan: artifacts, files and a record.

The key of a step is a hash of its stage, with its version and those of its libraries, its parameters with the content
of their files, its seed, and the hashes of its inputs. A step with a stored result for its key is not run again, so a
run that was stopped, failed or was killed resumes. Files are moved to the run directory only after all steps are done.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from scaffold_pipeline.artifacts import Artifact, Metrics
from scaffold_pipeline.config.plan import Plan, Step
from scaffold_pipeline.errors import (
    MemoryShortageError,
    PipelineError,
    PipelineWarning,
    StageDefinitionError,
    StageError,
    no_folder,
)
from scaffold_pipeline.processes.memory import PeakMemory
from scaffold_pipeline.runs.cache import Cache, CacheClient
from scaffold_pipeline.runs.measurements import merge_metrics
from scaffold_pipeline.runs.records import StepRecord, config_hash, input_files, step_key
from scaffold_pipeline.runs.store import OUT_PREFIX, DamagedStoreError, Store, first_result

STORE = ".store"
"""Folder of a run directory that holds the results of its stages."""

OWN_FILES = frozenset({"config.yaml", "measures.json", "metrics.json", "report.html", "run.json"})
"""Files of a run directory that no stage writes."""


@dataclass(frozen=True)
class Progress:
    """Callbacks for the progress of a run."""

    started: Callable[[Step, int, int], None] = lambda _step, _number, _count: None
    finished: Callable[[StepRecord], None] = lambda _record: None
    warned: Callable[[str], None] = lambda _message: None


@dataclass(frozen=True)
class _Run:
    """The state of one call of `execute`; `forced` are labels still to be run although their results are stored.

    `executor` computes parts of a stage in other processes, or is None.
    """

    plan: Plan
    store: Store
    until: str | None
    forced: set[str]
    progress: Progress
    cache: Cache | None
    executor: Executor | None
    messages: list[str] = field(default_factory=list)

    @cached_property
    def sharing(self) -> CacheClient:
        return CacheClient(self.cache, self.store, self.warn)

    def warn(self, message: str) -> None:
        self.messages.append(message)
        self.progress.warned(message)


@dataclass
class _State:
    """The slots while a plan runs: the step that wrote each, and the values in memory."""

    records: dict[str, StepRecord] = field(default_factory=dict)
    values: dict[str, Artifact] = field(default_factory=dict)

    def hashes(self, step: Step) -> dict[str, str]:
        """Return the hash of the value of each argument that `step` reads."""
        return {argument: self.records[slot].output for argument, slot in step.sources.items()}


@dataclass(frozen=True)
class RunResult:
    """The steps that ran or were reused, the metrics if there are any, and whether the plan was finished.

    `warnings` are the run's own; those of a stage are in its record.
    """

    steps: tuple[StepRecord, ...]
    metrics: Metrics | None
    seconds: float
    is_complete: bool
    warnings: tuple[str, ...] = ()

    @property
    def files(self) -> dict[str, str]:
        """The hash of each file that the stages wrote, by name."""
        return {name: digest for step in self.steps for name, digest in step.files.items()}


def execute(  # noqa: PLR0913 - all but two by name, each a choice of its own
    plan: Plan,
    out: Path,
    *,
    until: str | None = None,
    force: Collection[str] = (),
    progress: Progress | None = None,
    cache: Cache | None = None,
    executor: Executor | None = None,
) -> RunResult:
    """Run `plan` up to the step labelled `until`, and store its results in `out`.

    Results of other runs are taken from `cache`, and new ones are added to it. Stages that can be computed in parts use
    `executor`, whose processes must have the same packages. Steps whose labels are in `force` are run again although
    their results are stored. Raises `StageError` if a stage fails; the results of earlier stages stay stored.
    """
    started = time.monotonic()
    with locked(out):
        store = Store(out / STORE)
        store.prepare()
        run = _Run(plan, store, until, set(force), progress or Progress(), cache, executor)
        records, metrics = _run_despite_damage(run)
        is_complete = len(records) == len(plan.steps)
        if is_complete:
            store.keep_only(record.key for record in records)
    return RunResult(tuple(records), metrics, time.monotonic() - started, is_complete, tuple(run.messages))


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Create the run directory `out` if needed, and lock it for this thread, which may already hold the lock.

    Raises `PipelineError` if another run has locked it.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PipelineError(no_folder(out, error)) from error
    lock = FileLock(out.resolve() / ".lock", timeout=0, is_singleton=True)
    try:
        lock.acquire()
    except Timeout as error:
        message = f"{out}: another run is using this directory; wait for it or choose another --out"
        raise PipelineError(message) from error
    try:
        yield
    finally:
        lock.release()


def unchanged_labels(plan: Plan, out: Path, force: Collection[str] = (), cache: Cache | None = None) -> list[str]:
    """Return the labels of the steps that `execute` will not run again; reads the stores and writes nothing."""
    state, labels = _State(), []
    stores = [Store(out / STORE), *([cache.store] if cache else [])]
    for step in plan.steps:
        is_known = step.label not in force and all(slot in state.records for slot in step.sources.values())
        stored = first_result(stores, step_key(plan, step, state.hashes(step))) if is_known else None
        state.records.pop(step.slot, None)
        if stored is not None:
            state.records[step.slot] = _reuse(step, stored)
            labels.append(step.label)
    return labels


def _run_despite_damage(run: _Run) -> tuple[list[StepRecord], Metrics | None]:
    """Run the plan; if a stored value is damaged, delete its result and start again.

    A value is loaded only if its step was not run in this pass, so that on a sound disk there is at most one more pass
    for each step.
    """
    for _ in run.plan.steps:
        try:
            return _run_steps(run)
        except DamagedStoreError as damage:
            run.warn(f"{damage}; its stage is run again")
    return _run_steps(run)


def _run_steps(run: _Run) -> tuple[list[StepRecord], Metrics | None]:
    state = _State()
    records: list[StepRecord] = []
    steps = run.plan.steps
    for number, step in enumerate(steps):
        run.progress.started(step, number + 1, len(steps))
        record = _run_or_reuse(run, step, state)
        _require_new_names(record, records)
        records.append(record)
        run.progress.finished(record)
        if issubclass(step.stage.output, Metrics):
            _metrics(run, state)  # a duplicate key is reported before the next stage is run
        if step.label == run.until:
            break
        _drop_unread(run.plan, number, state)
    return records, _metrics(run, state)


def _require_new_names(record: StepRecord, earlier: Iterable[StepRecord]) -> None:
    """Require that no two steps write a file of the same name, as all files go into one directory."""
    for other in earlier:
        for name in sorted(set(record.files) & set(other.files)):
            raise StageError(f"{record.label}: writes {name}, which {other.label} also writes; remove one of them")


def _drop_unread(plan: Plan, number: int, state: _State) -> None:
    """Free the memory of values that no later step reads."""
    wanted = {slot for step in plan.steps[number + 1 :] for slot in step.sources.values()}
    state.values = {slot: value for slot, value in state.values.items() if slot in wanted}


def _run_or_reuse(run: _Run, step: Step, state: _State) -> StepRecord:
    key, value = step_key(run.plan, step, state.hashes(step)), None
    record = _reusable(run, step, key)
    if record is None:
        with run.sharing.lock(key):
            is_given = step.label not in run.forced and run.sharing.fetch(key)
            record = _reusable(run, step, key) if is_given else None
            if record is None:
                record, value = _run_step(run, step, key, state)
                run.sharing.publish(key)
                run.forced.discard(step.label)
    state.values.pop(step.slot, None)
    if value is not None:
        state.values[step.slot] = value
    state.records[step.slot] = record
    return record


def _reusable(run: _Run, step: Step, key: str) -> StepRecord | None:
    stored = None if step.label in run.forced else _stored_result(run, step, key)
    return None if stored is None else _reuse(step, stored)


def _stored_result(run: _Run, step: Step, key: str) -> dict[str, Any] | None:
    try:
        return run.store.result(key)
    except DamagedStoreError as damage:
        run.warn(f"{step.label}: {damage}; the stage is run again")
        return None


def _reuse(step: Step, stored: Mapping[str, Any]) -> StepRecord:
    """Return a stored record as one of this run, in which labels, slots and file names may differ."""
    record = StepRecord(**{**stored, "warnings": tuple(stored["warnings"])})
    parameters = step.params.model_dump(mode="json")
    return replace(record, label=step.label, slot=step.slot, parameters=parameters, reused=True)


def _value(slot: str, run: _Run, state: _State) -> Artifact:
    if slot not in state.values:
        record = state.records[slot]
        try:
            state.values[slot] = run.store.load(record.output)
        except DamagedStoreError:
            run.store.forget(record.key)
            raise
    return state.values[slot]


def _run_step(run: _Run, step: Step, key: str, state: _State) -> tuple[StepRecord, Artifact]:
    started, files_read = time.monotonic(), input_files(step)
    inputs = {argument: _value(slot, run, state) for argument, slot in step.sources.items()}
    with TemporaryDirectory(dir=run.store.root, prefix=OUT_PREFIX) as folder, PeakMemory() as memory:
        engine = _engine_arguments(run, step, Path(folder))
        output, messages = _call(step, {**inputs, **engine})
        files = _save_files(step, Path(folder), run.store)
    if input_files(step) != files_read:
        raise StageError(f"{step.label}: an input file was changed during the run; run again")
    try:
        record = StepRecord(
            label=step.label,
            stage=step.stage.name,
            version=step.stage.version,
            libraries=step.stage.libraries,
            parameters=step.params.model_dump(mode="json"),
            inputs=state.hashes(step),
            input_files=files_read,
            slot=step.slot,
            key=key,
            output=run.store.save(output),
            seed=step.seed(run.plan.seed),
            seconds=round(time.monotonic() - started, 3),
            peak_memory_bytes=memory.peak,
            summary=output.summary(),
            warnings=messages,
            files=files,
        )
        run.store.save_result(record.key, asdict(record))
    except (TypeError, ValueError) as error:
        got = type(output).__name__
        raise StageDefinitionError(f"{step.label}: the facts of its {got} cannot be stored as JSON: {error}") from error
    return record, output


def _engine_arguments(run: _Run, step: Step, out: Path) -> dict[str, object]:
    """Return the arguments that the engine gives to the stage besides its slots."""
    offered: dict[str, Callable[[], object]] = {
        "params": lambda: step.params,
        "rng": lambda: np.random.default_rng(step.seed(run.plan.seed)),
        "out": lambda: out,
        "config_hash": lambda: config_hash(run.plan),
        "executor": lambda: run.executor,
    }
    return {name: offered[name]() for name in step.stage.engine_arguments}


def _save_files(step: Step, folder: Path, store: Store) -> dict[str, str]:
    """Store the files that the stage wrote in its folder; return the hash of each by name."""
    files = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name in OWN_FILES or path.name.startswith("."):
            rule = f"`out` may hold only plain files, not named {', '.join(sorted(OWN_FILES))} or with a leading dot"
            raise StageDefinitionError(f"{step.label}: {rule}, got {path.name}")
        files[path.name] = store.save_file(path)
    return files


def _call(step: Step, arguments: Mapping[str, object]) -> tuple[Artifact, tuple[str, ...]]:
    """Call the stage; return its artifact and its warnings, every failure as one `PipelineError`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            output = step.stage.function(**arguments)
        except PipelineError as error:
            raise _labelled_error(error, step) from error
        except MemoryError as error:
            raise MemoryShortageError(f"{step.label}: ran out of memory; use larger voxels or cells") from error
        except Exception as error:
            kind = " ".join(f"{type(error).__name__}: {error}".split())
            raise StageError(f"{step.label}: failed unexpectedly: {kind}; --debug shows where") from error
    if not isinstance(output, step.stage.output):
        got, promised = type(output).__name__, step.stage.output.__name__
        raise StageDefinitionError(f"{step.label}: returned a {got}, but its annotation is {promised}")
    messages = [str(warning.message) for warning in caught if issubclass(warning.category, PipelineWarning)]
    return output, tuple(dict.fromkeys(messages))


def _labelled_error(error: PipelineError, step: Step) -> PipelineError:
    kind = type(error) if type(error) in {MemoryShortageError, StageError, StageDefinitionError} else StageError
    return kind(f"{step.label}: {error}")


def _metrics(run: _Run, state: _State) -> Metrics | None:
    """Return the combined metrics of all stages so far, without those in slots written again."""
    measured: dict[str, Metrics] = {}
    for step in run.plan.steps:
        record = state.records.get(step.slot)
        if record is not None and record.label == step.label and issubclass(step.stage.output, Metrics):
            value = _value(step.slot, run, state)
            measured |= {step.label: value} if isinstance(value, Metrics) else {}
    return merge_metrics(measured)
