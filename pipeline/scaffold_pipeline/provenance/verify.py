"""Repeat a finished run and compare the hash of every result with the record, up to the first difference.

Results that are not deterministic are taken from the run's store; all others are computed again in a temporary folder.
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
from scaffold_pipeline.runs.records import StepRecord, input_files, step_key
from scaffold_pipeline.runs.runner import STORE, Progress, execute
from scaffold_pipeline.runs.store import DamagedStoreError, Store, hash_file


@dataclass(frozen=True)
class Difference:
    """The first result that differs: `what` is `output` or a file of the stage `label`; a missing hash is None."""

    label: str
    what: str
    recorded: str | None
    found: str | None


@dataclass(frozen=True)
class Verification:
    """The number of stages and files that agree with the record, and the first difference.

    `stored` are the labels of stages that are not deterministic, whose results were taken from the store; `versions`
    are the recorded and the present version of each library where they differ, by name.
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
    """Repeat the run in `folder` and compare the hash of every stage's output and files, in order.

    Stops at the first difference. Raises `PipelineError` if there is nothing to compare with: no record, a file that
    was changed since, or a stored result that is missing.
    """
    record = read_record(folder)
    require_files(folder, record)
    plan = make_plan(read_draft(folder / "config.yaml"))
    stages = {stage["label"]: stage for stage in record["stages"]}
    if list(stages) != plan.labels:
        raise PipelineError(f"{folder / RECORD}: its stages differ from those of config.yaml; run the config again")
    for step in plan.steps:
        _require_inputs(step, stages[step.label])
    agreed: dict[str, int] = {}

    def compare(repeated: StepRecord) -> None:
        shown.finished(repeated)
        agreed[repeated.label] = _require_equal_results(repeated, stages[repeated.label])

    shown, difference = progress or Progress(), None
    with TemporaryDirectory(prefix="scaffold-verify-") as scratch:
        stored = _copy_unrepeatable(plan, stages, Store(folder / STORE), Store(Path(scratch, STORE)))
        try:
            execute(plan, Path(scratch), progress=replace(shown, finished=compare))
        except _DifferenceError as error:
            difference = error.difference
    versions = _changed_versions(record, [step.stage.name for step in plan.steps])
    return Verification(len(agreed), sum(agreed.values()), stored, versions, difference)


def require_files(folder: Path, record: Mapping[str, Any]) -> None:
    """Require that the files in `folder` have the recorded hashes."""
    for name, facts in record["files"].items():
        path = folder / name
        digest = hash_file(path) if path.is_file() else None
        if digest != facts["sha256"]:
            raise PipelineError(
                f"{path}: {_difference_message('is not the file that the run wrote', facts['sha256'], digest)}"
            )


def _require_inputs(step: Step, recorded: Mapping[str, Any]) -> None:
    """Require that the input files of a step have the recorded hashes."""
    for name, digest in input_files(step).items():
        earlier = recorded["input_files"].get(name)
        if digest != earlier:
            rule = f"{step.label}: {name}: {getattr(step.params, name)} was changed since the run"
            raise PipelineError(f"{_difference_message(rule, earlier, digest)}; put the original file back")


def _difference_message(rule: str, recorded: str | None, found: str | None) -> str:
    """Return `rule` with the two hashes, shortened."""
    return f"{rule}: recorded {(recorded or 'nothing')[:12]}, found {(found or 'nothing')[:12]}"


def _copy_unrepeatable(plan: Plan, stages: Mapping[str, Any], source: Store, target: Store) -> tuple[str, ...]:
    """Copy the results that are not deterministic to `target`, under their present keys; return their labels."""
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
            raise PipelineError(
                f"{step.label}: is not deterministic, and its stored result is damaged: {error}"
            ) from error
        if result is None:
            rule = f"is not deterministic, and its result is no longer in {source.root}"
            raise PipelineError(f"{step.label}: {rule}; run the config again and verify the new run")
        key = step_key(plan, step, recorded["inputs"])  # differs from the recorded key if versions of libraries do
        target.save_result(key, {**result, "key": key})
    return tuple(step.label for step in fixed)


def _require_equal_results(repeated: StepRecord, recorded: Mapping[str, Any]) -> int:
    """Return the number of the step's files; raises `_DifferenceError` at the first result that differs."""
    files: Mapping[str, str] = recorded["files"]
    pairs: dict[str, tuple[str | None, str | None]] = {"output": (recorded["output"], repeated.output)}
    pairs |= {name: (files.get(name), repeated.files.get(name)) for name in sorted({*files, *repeated.files})}
    for what, (earlier, now) in pairs.items():
        if earlier != now:
            raise _DifferenceError(Difference(repeated.label, what, earlier, now))
    return len(files)


def _changed_versions(record: Mapping[str, Any], stages: Collection[str]) -> dict[str, tuple[str | None, str | None]]:
    present = environment(stages)
    earlier: dict[str, str] = {"python": record["platform"].get("python"), **record["versions"]}
    current: dict[str, str] = {"python": present["platform"]["python"], **present["versions"]}
    both = {name: (earlier.get(name), current.get(name)) for name in sorted({*earlier, *current})}
    return {name: (then, now) for name, (then, now) in both.items() if then != now}
