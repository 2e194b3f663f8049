"""From a draft and the stages' contracts to a plan: each slot is written before it is read, with the right type.

A stage that reads the slot it writes transforms it; any other slot is written once, or renamed with `as:`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.config.draft import Draft, StageDraft
from scaffold_pipeline.errors import ConfigError, Fault, StageDefinitionError, did_you_mean
from scaffold_pipeline.stages.contract import Follows, Params, Stage
from scaffold_pipeline.stages.registry import load_stage, stage_names
from scaffold_pipeline.stages.seeds import derive_seed


@dataclass(frozen=True)
class Step:
    """One stage of a plan: its parameters, the slot it writes and the slot that each argument reads."""

    label: str
    stage: Stage
    params: Params
    slot: str
    sources: Mapping[str, str]

    def resolved(self) -> dict[str, Any]:
        """Return the equivalent entry of `stages:` with every default written out."""
        renamed = {argument: slot for argument, slot in self.sources.items() if slot != argument}
        return {
            "use": self.stage.name,
            **({"as": self.slot} if self.slot != self.stage.writes else {}),
            **({"from": renamed} if renamed else {}),
            **self.params.model_dump(mode="json"),
        }

    def seed(self, root: int) -> int | None:
        """Return this step's own seed, derived from the run's, or None where the stage is not random."""
        if "rng" not in self.stage.engine_arguments:
            return None
        return derive_seed(root, self.label)


@dataclass(frozen=True)
class Plan:
    """Steps that can run in this order."""

    name: str
    seed: int
    steps: tuple[Step, ...]

    @cached_property
    def labels(self) -> list[str]:
        """The steps' labels, in order."""
        return [step.label for step in self.steps]

    def resolved(self) -> dict[str, Any]:
        """Return the whole configuration, every default written out; `run` accepts it again."""
        return {"name": self.name, "seed": self.seed, "stages": [step.resolved() for step in self.steps]}

    def require_label(self, label: str, option: str) -> str:
        """Return `label` if a step has it; raises `ConfigError` with the most similar label otherwise."""
        if label not in self.labels:
            message = f"the config has no stage {label!r}{did_you_mean(label, self.labels)}"
            raise ConfigError([Fault(0, 0, message, f"--{option} {label}")])
        return label


def make_plan(draft: Draft) -> Plan:
    """Return the plan of `draft`; raises `ConfigError` with all faults of the draft and of the plan."""
    faults = [*draft.faults, *_slot_faults(draft)]
    if faults:
        raise ConfigError(faults)
    labels = _labels(draft)
    given = {entry.use: entry for entry in draft.stages}
    steps = tuple(_step(entry, label, given, draft) for entry, label in zip(draft.stages, labels, strict=True))
    return Plan(draft.name, draft.seed, steps)


def _step(entry: StageDraft, label: str, given: Mapping[str, StageDraft], draft: Draft) -> Step:
    if entry.stage is None or entry.params is None or entry.slot is None:
        raise AssertionError(f"{label}: a draft without faults has every stage and its parameters")
    followed = {
        name: getattr(given[mark.stage].params, mark.parameter)
        for name, mark in entry.stage.params.marked(Follows).items()
        if name not in entry.given and mark.stage in given
    }
    written = {earlier.slot for earlier in draft.stages[: entry.index]}
    sources = {argument: entry.sources.get(argument, argument) for argument in entry.stage.reads}
    bound = {argument: slot for argument, slot in sources.items() if slot in written}
    return Step(label, entry.stage, entry.params.model_copy(update=followed), entry.slot, bound)


def _labels(draft: Draft) -> list[str]:
    """Name each entry by its `as:` or its stage; the second of the same name is `name.2`."""
    labels: list[str] = []
    for entry in draft.stages:
        renamed = entry.stage is not None and entry.slot != entry.stage.writes
        base = str(entry.slot) if renamed else entry.use
        count = sum(label == base or label.startswith(f"{base}.") for label in labels)
        labels.append(f"{base}.{count + 1}" if count else base)
    return labels


@dataclass(frozen=True)
class _Written:
    type: type[Artifact]
    by: StageDraft


def _slot_faults(draft: Draft) -> Iterator[Fault]:
    slots: dict[str, _Written] = {}
    is_complete = all(entry.stage for entry in draft.stages)
    for entry in draft.stages:
        if entry.stage is None or entry.slot is None:
            continue
        sources = {argument: entry.sources.get(argument, argument) for argument in entry.stage.reads}
        for argument, slot in sources.items():
            message = _read_fault(entry, argument, slot, slots, draft)
            if message and (is_complete or slot in slots):
                place = ("from", argument) if argument in entry.sources else ("use",)
                yield draft.fault((*entry.path, *place), entry.prefix(message))
        if entry.slot in slots and entry.slot not in sources.values():
            by = slots[entry.slot].by
            message = (
                f"writes slot {entry.slot!r}, which stages.{by.index} ({by.use}) writes too; rename it with `as: NAME`"
            )
            place = ("use",) if entry.slot == entry.stage.writes else ("as",)
            yield draft.fault((*entry.path, *place), entry.prefix(message))
        if entry.slot in slots or entry.slot not in sources.values():  # a missing slot cannot be transformed
            slots[entry.slot] = _Written(entry.stage.output, entry)


def _read_fault(entry: StageDraft, argument: str, slot: str, slots: Mapping[str, _Written], draft: Draft) -> str | None:
    """Return the fault of one read of one entry, or None."""
    read = entry.stage.reads[argument] if entry.stage else None
    if read is None or (slot not in slots and read.optional and argument not in entry.sources):
        return None
    if slot not in slots:
        later = [other for other in draft.stages[entry.index + 1 :] if other.slot == slot]
        if later:
            by = later[0]
            return f"reads slot {slot!r}, which stages.{by.index} ({by.use}) writes only later; move that stage up"
        return f"reads slot {slot!r}, which no stage before it writes; add one of: {', '.join(_writers(slot)) or '-'}"
    written = slots[slot]
    if not issubclass(written.type, read.type):
        got, by = written.type.__name__, written.by
        others = ", ".join(_writers(slot, read.type))
        remedy = f"write it with one of: {others}, or leave this stage out" if others else "leave this stage out"
        return f"reads slot {slot!r} as {read.type.__name__}, but stages.{by.index} ({by.use}) writes a {got}; {remedy}"
    return None


def _writers(slot: str, kind: type[Artifact] = Artifact) -> list[str]:
    """Return the installed stages that write `slot` as a `kind` without reading it."""
    writers = []
    for name in stage_names():
        try:
            stage = load_stage(name)
        except StageDefinitionError:
            continue  # a broken plug-in is reported only when it is used
        if stage.writes == slot and slot not in stage.reads and issubclass(stage.output, kind):
            writers.append(name)
    return writers
