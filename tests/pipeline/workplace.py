"""A folder to work in and the command, as a test uses them."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from scaffold_pipeline.cli import app
from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import Plan, make_plan
from scaffold_pipeline.runs.cache import Cache
from scaffold_pipeline.runs.runner import Progress, RunResult, execute


@dataclass(frozen=True)
class Answer:
    """What a command left: its exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:  # noqa: ANN401 - what JSON holds
        return json.loads(self.out)


@dataclass(frozen=True)
class Project:
    """A current folder with configs and runs in it."""

    folder: Path
    capture: pytest.CaptureFixture[str]

    def write(self, text: str, name: str = "config.yaml") -> Path:
        """Write a file and return its path, relative to the folder as a user would give it."""
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(dedent(text).lstrip("\n"), encoding="utf-8")
        return Path(name)

    def plan(self, text: str, *settings: str) -> Plan:
        """Write a config and return its plan."""
        return make_plan(read_draft(self.write(text), settings))

    def execute(
        self,
        text: str,
        *settings: str,
        out: str = "out",
        until: str | None = None,
        force: Collection[str] = (),
        progress: Progress | None = None,
        cache: Cache | None = None,
    ) -> RunResult:
        """Write a config and run it, publishing nothing."""
        plan = self.plan(text, *settings)
        return execute(plan, Path(out), until=until, force=force, progress=progress, cache=cache)

    def command(self, *arguments: object) -> Answer:
        """Run the command in this process."""
        self.capture.readouterr()
        code = app.main([str(argument) for argument in arguments])
        told = self.capture.readouterr()
        return Answer(code, told.out, told.err)

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        """Start the command in a process of its own, the first of a group as a terminal makes one for a command."""
        command = [sys.executable, "-m", "scaffold_pipeline", *map(str, arguments)]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, cwd=self.folder, stdout=pipe, stderr=pipe, text=True, encoding="utf-8", process_group=0
        )

    def record(self, out: str = "runs/config") -> dict[str, Any]:
        """Return what the run in `out` recorded."""
        record: dict[str, Any] = json.loads((self.folder / out / "run.json").read_text(encoding="utf-8"))
        return record

    def reused(self, out: str = "runs/config") -> dict[str, bool]:
        """Return for each stage of the last run in `out` whether it was reused."""
        return {stage["label"]: stage["reused"] for stage in self.record(out)["stages"]}

    def files(self, out: str = "runs/config") -> dict[str, bytes]:
        """Return the content of each published file."""
        return {path.name: path.read_bytes() for path in (self.folder / out).iterdir() if path.is_file()}


def ran(result: RunResult) -> list[str]:
    """Return the labels of the steps that were not reused."""
    return [step.label for step in result.steps if not step.reused]


def harm(path: Path, how: str) -> None:
    """Damage a file: it is `gone`, `empty`, has lost a `half` of its content, or one `bit` of it is another."""
    content = path.read_bytes()
    if how == "gone":
        path.unlink()
    elif how == "bit":
        path.write_bytes(content[:-3] + bytes([content[-3] ^ 1]) + content[-2:])
    else:
        path.write_bytes(content[: len(content) // 2] if how == "half" else b"")


def wait_for(is_so: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    """Wait until `is_so`, for half a minute at most and while `process` runs."""
    limit = time.monotonic() + 30.0
    while not is_so():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < limit
        time.sleep(0.02)
