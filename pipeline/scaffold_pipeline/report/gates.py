"""The quality gates of a run: passed, failed and by how much, or not applied."""

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
    """A gate, its state, and a line about it, which may begin with its name."""

    name: str
    state: State
    about: str

    @property
    def title(self) -> str:
        """Its name for people."""
        return self.name.replace("_", " ")

    @property
    def sign(self) -> str:
        """A symbol for its state."""
        return _SIGNS[self.state]

    @property
    def words(self) -> str:
        """The line about it, without its name."""
        return self.about.removeprefix(f"{self.name}:").strip()


def list_gates(record: Mapping[str, Any], metrics: Mapping[str, Fact], declared: Declared) -> list[JudgedGate]:
    """Return the gates of a run, failed ones first; none if no stage has gates."""
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
    """Return the gate of a line `name: fault; remedy`."""
    return JudgedGate(line.partition(":")[0], state, line)


def _gates_by_parameters(record: Mapping[str, Any], declared: Declared) -> Iterator[JudgedGate]:
    """Yield the declared gates of the stages with a verdict: passed, or switched off by a parameter."""
    parameters = {
        stage.get("label"): stage.get("parameters") or {}
        for stage in record.get("stages") or ()
        if "quality" in (stage.get("summary") or {})
    }
    for label, gate in declared.gates:
        value = parameters.get(label, {}).get(gate.switch)
        if value is not None:
            yield JudgedGate(gate.name, "passed" if value else "switched off", gate.passed)
