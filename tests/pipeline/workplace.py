"""A folder to work in and the command, as a test uses them."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from scaffold_pipeline import cli


@dataclass(frozen=True)
class Answer:
    """What a command left: its exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
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

    def command(self, *arguments: object) -> Answer:
        """Run the command in this process."""
        self.capture.readouterr()
        code = cli.main([str(argument) for argument in arguments])
        told = self.capture.readouterr()
        return Answer(code, told.out, told.err)

    def start(self, *arguments: object, **options: Any) -> subprocess.Popen[str]:
        """Start the command in a process of its own."""
        command = [sys.executable, "-m", "scaffold_pipeline", *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, cwd=self.folder, **{**pipes, **options})

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
