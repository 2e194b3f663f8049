"""A plan to artifacts, files and a record.

Every step has a key: its stage and version, its parameters with the content of the files they name, its seed, and
the hashes of what it reads. A step whose key has a stored result is not run again, so a run that was stopped, failed
or killed goes on where it was. Files reach the run directory only when all steps are done.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from scaffold_pipeline.artifacts import Artifact, Fact, Metrics
from scaffold_pipeline.contract import InputFileMark
from scaffold_pipeline.errors import PipelineError, PipelineWarning, StageDefinitionError, StageError
from scaffold_pipeline.memory import PeakMemory
from scaffold_pipeline.plan import Plan, Step
from scaffold_pipeline.store import DamagedStoreError, Store, hash_file, hash_json

STORE = ".store"
"""Folder of a run directory that holds the results of its stages."""


@dataclass(frozen=True)
class StepRecord:
    """What is kept of one step: enough to know what it did, from what, with what result."""

    label: str
    stage: str
    version: int
    parameters: Mapping[str, Any]
    inputs: Mapping[str, str]
    input_files: Mapping[str, str]
    slot: str
    key: str
    output: str
    seed: int | None
    seconds: float
    peak_memory_bytes: int
    summary: Mapping[str, Fact]
    warnings: tuple[str, ...]
    files: Mapping[str, str]
    reused: bool = False


@dataclass(frozen=True)
class Progress:
    """What a run tells whoever watches it."""

    started: Callable[[Step, int, int], None] = lambda _step, _number, _count: None
    finished: Callable[[StepRecord], None] = lambda _record: None


@dataclass
class _State:
    """The slots while a plan runs: the hash of each, and the values that were made or read in this process."""

    hashes: dict[str, str] = field(default_factory=dict)
    values: dict[str, Artifact] = field(default_factory=dict)


@dataclass(frozen=True)
class RunResult:
    """The steps that ran or were reused, the metrics if any were measured, and whether the plan was finished."""

    steps: tuple[StepRecord, ...]
    metrics: Metrics | None
    seconds: float
    is_complete: bool

    @property
    def files(self) -> dict[str, str]:
        """The hash of each file that the stages wrote, by name."""
        return {name: digest for step in self.steps for name, digest in step.files.items()}


def execute(
    plan: Plan,
    out: Path,
    *,
    until: str | None = None,
    force: Collection[str] = (),
    progress: Progress | None = None,
) -> RunResult:
    """Run `plan` with its results stored in `out`, as far as the step labelled `until`.

    Steps whose labels are in `force` are run again though their results are stored. Raises `StageError` for a
    stage that fails; what was finished before it stays stored.
    """
    started = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(out / ".lock", timeout=0):
            store = Store(out / STORE)
            records, state = _run_steps(plan, store, until, frozenset(force), progress or Progress())
            metrics = _last_metrics(plan, state, store)
    except Timeout as error:
        raise PipelineError(f"{out}: another run is using this directory; wait for it or choose another --out") from error
    is_complete = len(records) == len(plan.steps)
    if is_complete:
        store.keep_only(record.key for record in records)
    return RunResult(tuple(records), metrics, time.monotonic() - started, is_complete)


def cached_labels(plan: Plan, out: Path) -> list[str]:
    """Return the labels of the leading steps that `execute` would not run again."""
    hashes: dict[str, str] = {}
    labels: list[str] = []
    if not (out / STORE).is_dir():
        return labels
    store = Store(out / STORE)
    for step in plan.steps:
        stored = store.result(_key(plan, step, hashes))
        if stored is None:
            return labels
        hashes[step.slot] = stored["output"]
        labels.append(step.label)
    return labels


def config_hash(plan: Plan) -> str:
    """Return the hash of what `plan` asks for: equal on every machine where the input files are equal."""
    steps = [{**step.resolved(), **_input_files(step)} for step in plan.steps]
    return hash_json({"seed": plan.seed, "stages": steps})


def _run_steps(
    plan: Plan, store: Store, until: str | None, force: frozenset[str], progress: Progress
) -> tuple[list[StepRecord], _State]:
    state, records = _State(), []
    for number, step in enumerate(plan.steps):
        progress.started(step, number + 1, len(plan.steps))
        try:
            record = _run_or_reuse(plan, step, state, store, is_forced=step.label in force)
        except DamagedStoreError as damage:
            warnings.warn(f"{damage}; the stages before are run again", PipelineWarning, stacklevel=1)
            for made in records:
                store.forget(made.key)
            return _run_steps(plan, store, until, force, progress)
        records.append(record)
        progress.finished(record)
        if step.label == until:
            break
        _drop_unread(plan, number, state)
    return records, state


def _drop_unread(plan: Plan, number: int, state: _State) -> None:
    """Free the values that no later step reads."""
    wanted = {slot for step in plan.steps[number + 1 :] for slot in step.sources.values()}
    state.values = {slot: value for slot, value in state.values.items() if slot in wanted}


def _run_or_reuse(plan: Plan, step: Step, state: _State, store: Store, *, is_forced: bool) -> StepRecord:
    key = _key(plan, step, state.hashes)
    stored = None if is_forced else store.result(key)
    if stored is not None:
        record = StepRecord(**{**stored, "warnings": tuple(stored["warnings"]), "label": step.label, "reused": True})
        state.values.pop(step.slot, None)
    else:
        record, state.values[step.slot] = _run_step(plan, step, key, state, store)
    state.hashes[step.slot] = record.output
    return record


def _value(slot: str, state: _State, store: Store) -> Artifact:
    if slot not in state.values:
        state.values[slot] = store.load(state.hashes[slot])
    return state.values[slot]


def _input_files(step: Step) -> dict[str, str]:
    """Return the hash of each file that the step's parameters name."""
    paths = {name: getattr(step.params, name) for name in step.params.marked(InputFileMark)}
    return {name: hash_file(path) for name, path in paths.items() if path is not None}


def _key(plan: Plan, step: Step, hashes: Mapping[str, str]) -> str:
    files = _input_files(step)
    parameters = {name: value for name, value in step.params.model_dump(mode="json").items() if name not in files}
    return hash_json(
        {
            "stage": step.stage.name,
            "version": step.stage.version,
            "parameters": parameters,
            "files": files,
            "suffixes": {name: getattr(step.params, name).suffix for name in files},
            "inputs": {argument: hashes[slot] for argument, slot in step.sources.items()},
            "seed": step.seed(plan.seed),
            "config": config_hash(plan) if "config_hash" in step.stage.engine_arguments else None,
        }
    )


def _run_step(
    plan: Plan, step: Step, key: str, state: _State, store: Store
) -> tuple[StepRecord, Artifact]:
    started = time.monotonic()
    inputs = {argument: _value(slot, state, store) for argument, slot in step.sources.items()}
    with TemporaryDirectory(dir=store.root, prefix=".out-") as folder, PeakMemory() as memory:
        offered = {
            "params": step.params,
            "rng": np.random.default_rng(step.seed(plan.seed)),
            "out": Path(folder),
            "config_hash": config_hash(plan),
        }
        engine = {name: offered[name] for name in step.stage.engine_arguments}
        output, messages = _call(step, {**inputs, **engine})
        files = {path.name: store.save_file(path) for path in sorted(Path(folder).iterdir())}
    record = StepRecord(
        label=step.label,
        stage=step.stage.name,
        version=step.stage.version,
        parameters=step.params.model_dump(mode="json"),
        inputs={argument: state.hashes[slot] for argument, slot in step.sources.items()},
        input_files=_input_files(step),
        slot=step.slot,
        key=key,
        output=store.save(output),
        seed=step.seed(plan.seed),
        seconds=round(time.monotonic() - started, 3),
        peak_memory_bytes=memory.peak,
        summary=output.summary(),
        warnings=messages,
        files=files,
    )
    store.save_result(record.key, asdict(record))
    return record, output


def _call(step: Step, arguments: Mapping[str, object]) -> tuple[Artifact, tuple[str, ...]]:
    """Call the stage; return its artifact and its warnings, every failure as one `PipelineError`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            output = step.stage.function(**arguments)
        except PipelineError as error:
            raise _told_of(error, step) from error
        except MemoryError as error:
            raise StageError(f"{step.label}: ran out of memory; use larger voxels or cells") from error
        except Exception as error:
            kind = f"{type(error).__name__}: {error}"
            raise StageError(f"{step.label}: failed unexpectedly: {kind}; --debug shows where") from error
    if not isinstance(output, step.stage.output):
        got, promised = type(output).__name__, step.stage.output.__name__
        raise StageDefinitionError(f"{step.label}: returned a {got}, but its annotation promises a {promised}")
    messages = [str(warning.message) for warning in caught if issubclass(warning.category, PipelineWarning)]
    return output, tuple(dict.fromkeys(messages))


def _told_of(error: PipelineError, step: Step) -> PipelineError:
    kind = type(error) if type(error) in {StageError, StageDefinitionError} else StageError
    return kind(f"{step.label}: {error}")


def _last_metrics(plan: Plan, state: _State, store: Store) -> Metrics | None:
    """Return the metrics that were measured last, or None."""
    slots = [step.slot for step in plan.steps if issubclass(step.stage.output, Metrics) and step.slot in state.hashes]
    value = _value(slots[-1], state, store) if slots else None
    return value if isinstance(value, Metrics) else None
