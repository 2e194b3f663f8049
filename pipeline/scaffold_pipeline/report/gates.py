"""The quality gates in words: which passed, which failed and by how much, which were not applied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.report.markup import text_of
from scaffold_pipeline.report.wording import failed_gates

State = Literal["passed", "failed", "not applied", "switched off"]

WORDS = {
    "manifold": "The surface is closed, with two triangles at each edge.",
    "one_piece": "The solid is one piece without closed pores.",
    "pores_connected": "The pores hang together.",
    "interrupted": "Struts are whole and channels open in the file itself.",
    "porosity": "The porosity is the one asked for.",
    "certificate": "The iso-value lies in the window of the certificate.",
    "struts_whole": "All struts are whole.",
    "min_strut": "The thinnest strut is as thick as asked for.",
    "min_throat": "The narrowest throat is as wide as asked for.",
    "build_volume": "The solid fits into the printer.",
}
"""What is so where a gate is passed. One that is not here is told by its name."""

_SIGNS: Mapping[State, str] = {
    "failed": "\u2717",
    "passed": "\u2713",
    "not applied": "\u2013",
    "switched off": "\u2013",
}
_SWITCH = "gate_"
_ON_REQUEST = ("min_strut", "min_throat", "build_volume")
"""Gates that a value switches on."""


@dataclass(frozen=True)
class Gate:
    """A gate, what became of it, and what is to be said of that."""

    name: str
    state: State
    about: str


def list_gates(record: Mapping[str, Any], metrics: Mapping[str, Fact]) -> list[Gate]:
    """Return the gates of a run, those that failed first; none where nothing was judged."""
    quality = metrics.get("quality")
    failures = failed_gates(record.get("quality") if quality is None else quality)
    if failures is None:
        return []
    skipped = metrics.get("gates_not_applied")
    failed = [_gate(line, "failed") for line in failures]
    without = [_gate(str(line), "not applied") for line in (skipped if isinstance(skipped, list) else [])]
    told = {gate.name for gate in (*failed, *without)}
    others = [gate for gate in _gates_by_parameters(record) if gate.name not in told]
    passed, off = ([gate for gate in others if gate.state == state] for state in ("passed", "switched off"))
    return [*failed, *passed, *without, *off]


def _gate(line: str, state: State) -> Gate:
    """Return the gate that a line, `name: what; remedy`, is about."""
    return Gate(line.partition(":")[0], state, line)


def _gates_by_parameters(record: Mapping[str, Any]) -> Iterator[Gate]:
    """Yield the gates that the parameters of the judging stage name, as passed or switched off."""
    judges = [stage for stage in record.get("stages") or () if "quality" in (stage.get("summary") or {})]
    parameters = (judges[-1].get("parameters") or {}) if judges else {}
    for key, value in parameters.items():
        name = key.removeprefix(_SWITCH) if key.startswith(_SWITCH) else key if key in _ON_REQUEST else None
        if name is not None and (key.startswith(_SWITCH) or value is not None):
            yield Gate(name, "passed" if value else "switched off", WORDS.get(name, ""))


def gate_list(gates: list[Gate]) -> str:
    """Return the gates as a list, each with a sign and a word for what became of it."""
    lines = "".join(
        f'<li class="{gate.state.replace(" ", "-")}"><span class="sign" aria-hidden="true">{_SIGNS[gate.state]}</span> '
        f"<strong>{text_of(gate.name.replace('_', ' '))}</strong> {gate.state}{_said(gate)}</li>"
        for gate in gates
    )
    return f'<ul class="gates">{lines}</ul>' if lines else ""


def _said(gate: Gate) -> str:
    """Return what is to be said beside the name of the gate, which its line begins with."""
    about = gate.about.removeprefix(f"{gate.name}:").strip()
    return f": {text_of(about)}" if about else ""
