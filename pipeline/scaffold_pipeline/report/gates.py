"""The quality gates in words: which passed, which failed and by how much, which were not applied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from scaffold_pipeline.artifacts import Declared, Fact
from scaffold_pipeline.report.wording import failed_gates

State = Literal["passed", "failed", "not applied", "switched off"]

_SIGNS: Mapping[State, str] = {
    "failed": "\u2717",
    "passed": "\u2713",
    "not applied": "\u2013",
    "switched off": "\u2013",
}


@dataclass(frozen=True)
class JudgedGate:
    """A gate, what became of it, and what is to be said of that; its line may begin with its name."""

    name: str
    state: State
    about: str

    @property
    def title(self) -> str:
        """Its name for people."""
        return self.name.replace("_", " ")

    @property
    def sign(self) -> str:
        """A sign for what became of it."""
        return _SIGNS[self.state]

    @property
    def words(self) -> str:
        """What is to be said beside its name."""
        return self.about.removeprefix(f"{self.name}:").strip()


def list_gates(record: Mapping[str, Any], metrics: Mapping[str, Fact], declared: Declared) -> list[JudgedGate]:
    """Return the gates of a run, those that failed first; none where nothing was judged."""
    quality = metrics.get("quality")
    failures = failed_gates(record.get("quality") if quality is None else quality)
    if failures is None:
        return []
    skipped = metrics.get("gates_not_applied")
    failed = [_gate(line, "failed") for line in failures]
    without = [_gate(str(line), "not applied") for line in (skipped if isinstance(skipped, list) else [])]
    named = {gate.name for gate in (*failed, *without)}
    others = [gate for gate in _gates_by_parameters(record, declared) if gate.name not in named]
    passed, off = ([gate for gate in others if gate.state == state] for state in ("passed", "switched off"))
    return [*failed, *passed, *without, *off]


def _gate(line: str, state: State) -> JudgedGate:
    """Return the gate that a line, `name: what; remedy`, is about."""
    return JudgedGate(line.partition(":")[0], state, line)


def _gates_by_parameters(record: Mapping[str, Any], declared: Declared) -> Iterator[JudgedGate]:
    """Yield the declared gates of the stages that judged, as passed or switched off by their parameters."""
    parameters = {
        stage.get("label"): stage.get("parameters") or {}
        for stage in record.get("stages") or ()
        if "quality" in (stage.get("summary") or {})
    }
    for label, gate in declared.gates:
        value = parameters.get(label, {}).get(gate.switch)
        if value is not None:
            yield JudgedGate(gate.name, "passed" if value else "switched off", gate.passed)
