"""A finished run made again, beside its record: every result has its hash of then, or the first that has not is told.

What a library cannot repeat is taken from the run's store; all else is computed anew, in a folder of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import Plan, Step, make_plan
from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.report.publish import environment
from scaffold_pipeline.report.sources import RECORD, read_record
from scaffold_pipeline.run.records import StepRecord, input_files, step_key
from scaffold_pipeline.run.runner import STORE, Progress, execute
from scaffold_pipeline.run.store import DamagedStoreError, Store, hash_file


@dataclass(frozen=True)
class Difference:
    """The first result that is another: the `output` or a file of the stage with that label; a hash may be missing."""

    label: str
    what: str
    recorded: str | None
    found: str | None


@dataclass(frozen=True)
class Verification:
    """How much of a run agrees with its record, and the first thing that does not.

    `stored` are the labels of what cannot be repeated and was taken as it is stored; `versions` are those of then and
    now where they differ, by name.
    """

    stages: int
    files: int
    stored: tuple[str, ...]
    versions: Mapping[str, tuple[str | None, str | None]]
    difference: Difference | None = None


class _DifferenceError(Exception):
    """Ends the run at its first difference."""

    def __init__(self, difference: Difference) -> None:
        super().__init__(difference)
        self.difference = difference


def verify_run(folder: Path, progress: Progress | None = None) -> Verification:
    """Run again what the record in `folder` says and compare the hash of every stage's output and files in order.

    Ends at the first that differs. Raises `PipelineError` where there is nothing to compare with: no record, a file
    that was changed since, or a stored result that is gone.
    """
    record = read_record(folder)
    require_files(folder, record)
    plan = make_plan(read_draft(folder / "config.yaml"))
    stages = {stage["label"]: stage for stage in record["stages"]}
    if list(stages) != plan.labels:
        raise PipelineError(f"{folder / RECORD}: has other stages than config.yaml; run the config again")
    for step in plan.steps:
        _require_inputs(step, stages[step.label])
    agreed: dict[str, int] = {}

    def compare(found: StepRecord) -> None:
        told.finished(found)
        agreed[found.label] = _files_that_agree(found, stages[found.label])

    told, difference = progress or Progress(), None
    with TemporaryDirectory(prefix="scaffold-verify-") as scratch:
        stored = _copy_unrepeatable(plan, stages, Store(folder / STORE), Store(Path(scratch, STORE)))
        try:
            execute(plan, Path(scratch), progress=replace(told, finished=compare))
        except _DifferenceError as error:
            difference = error.difference
    versions = _changed_versions(record, [step.stage.name for step in plan.steps])
    return Verification(len(agreed), sum(agreed.values()), stored, versions, difference)


def require_files(folder: Path, record: Mapping[str, Any]) -> None:
    """Require that the files in `folder` are those that its record names."""
    for name, facts in record["files"].items():
        path = folder / name
        found = hash_file(path) if path.is_file() else None
        if found != facts["sha256"]:
            raise PipelineError(
                f"{path}: {_difference_message('is not the file that the run wrote', facts['sha256'], found)}"
            )


def _require_inputs(step: Step, recorded: Mapping[str, Any]) -> None:
    """Require that the input files of a step are those that its record names."""
    for name, digest in input_files(step).items():
        earlier = recorded["input_files"].get(name)
        if digest != earlier:
            rule = f"{step.label}: {name}: {getattr(step.params, name)} was changed since the run"
            raise PipelineError(f"{_difference_message(rule, earlier, digest)}; put the file back that was used")


def _difference_message(rule: str, recorded: str | None, found: str | None) -> str:
    """Return a line that says how two hashes differ."""
    return f"{rule}: recorded {(recorded or 'nothing')[:12]}, found {(found or 'nothing')[:12]}"


def _copy_unrepeatable(plan: Plan, stages: Mapping[str, Any], source: Store, target: Store) -> tuple[str, ...]:
    """Let `target` have what cannot be repeated, under the keys of today; return the labels."""
    target.make_folders()
    fixed = [step for step in plan.steps if not step.stage.is_repeatable]
    for step in fixed:
        recorded = stages[step.label]
        try:
            result = source.result(recorded["key"])
            if result is not None:
                source.require_whole(result)
                source.share(recorded["key"], target)
        except DamagedStoreError as error:
            raise PipelineError(f"{step.label}: cannot be repeated, and what it gave is damaged: {error}") from error
        if result is None:
            rule = f"cannot be repeated, and what it gave is no longer in {source.root}"
            raise PipelineError(f"{step.label}: {rule}; run the config again and verify that")
        key = step_key(plan, step, recorded["inputs"])  # another one where libraries are of other versions
        target.save_result(key, {**result, "key": key})
    return tuple(step.label for step in fixed)


def _files_that_agree(found: StepRecord, recorded: Mapping[str, Any]) -> int:
    """Return the number of the step's files; raises `_DifferenceError` at the first result that is another."""
    files: Mapping[str, str] = recorded["files"]
    pairs: dict[str, tuple[str | None, str | None]] = {"output": (recorded["output"], found.output)}
    pairs |= {name: (files.get(name), found.files.get(name)) for name in sorted({*files, *found.files})}
    for what, (earlier, now) in pairs.items():
        if earlier != now:
            raise _DifferenceError(Difference(found.label, what, earlier, now))
    return len(files)


def _changed_versions(record: Mapping[str, Any], stages: Collection[str]) -> dict[str, tuple[str | None, str | None]]:
    present = environment(stages)
    earlier: dict[str, str] = {"python": record["platform"].get("python"), **record["versions"]}
    found: dict[str, str] = {"python": present["platform"]["python"], **present["versions"]}
    both = {name: (earlier.get(name), found.get(name)) for name in sorted({*earlier, *found})}
    return {name: (then, now) for name, (then, now) in both.items() if then != now}
