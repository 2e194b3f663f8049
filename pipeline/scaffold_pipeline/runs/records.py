"""The record of a step, and the key under which its result is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.config.plan import Plan, Step
from scaffold_pipeline.runs.store import hash_input, hash_json
from scaffold_pipeline.stages.contract import InputFileMark


@dataclass(frozen=True)
class StepRecord:
    """The record of one step: its stage and parameters, its inputs and its results."""

    label: str
    stage: str
    version: int
    libraries: Mapping[str, str]
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


def step_key(plan: Plan, step: Step, inputs: Mapping[str, str]) -> str:
    """Return the hash of everything the result of `step` depends on; `inputs` are the hashes of its arguments."""
    files = input_files(step)
    parameters = {name: value for name, value in step.params.model_dump(mode="json").items() if name not in files}
    return hash_json(
        {
            "stage": step.stage.name,
            "version": step.stage.version,
            "libraries": step.stage.libraries,
            "parameters": parameters,
            "files": files,
            "suffixes": {name: getattr(step.params, name).suffix for name in files},
            "inputs": inputs,
            "record": sorted(entry.name for entry in fields(StepRecord)),
            "seed": step.seed(plan.seed),
            "config": config_hash(plan) if "config_hash" in step.stage.engine_arguments else None,
        }
    )


def recipes(plan: Plan) -> dict[str, str]:
    """Return for each label the hash of everything its result depends on, back to the input files, before any run."""
    known: dict[str, str] = {}
    hashes: dict[str, str] = {}
    for step in plan.steps:
        inputs = {argument: hashes[slot] for argument, slot in step.sources.items()}
        known[step.label] = hashes[step.slot] = step_key(plan, step, inputs)
    return known


def config_hash(plan: Plan) -> str:
    """Return the hash of the configuration in `plan`: equal on all machines with equal input files."""
    steps = [{**step.resolved(), **input_files(step)} for step in plan.steps]
    return hash_json({"seed": plan.seed, "stages": steps})


def input_files(step: Step) -> dict[str, str]:
    """Return the hash of each input file among the step's parameters."""
    paths = {name: getattr(step.params, name) for name in step.params.marked(InputFileMark)}
    return {name: hash_input(path) for name, path in paths.items() if path is not None}
