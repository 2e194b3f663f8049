"""Exit codes, options and output that the commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from scaffold_pipeline.runs.cache import Cache

INTERRUPTED = 130
GATE_FAILED = 3
USAGE = 2
FAILED = 1

Settings = Annotated[list[str], Parameter(name="--set", help="Override a value: stage.key=value; may be repeated.")]
Quiet = Annotated[bool, Parameter(help="Print errors only.")]
Json = Annotated[bool, Parameter(name="--json", help="Print one JSON object on standard output and nothing else.")]
DryRun = Annotated[bool, Parameter(name=["--dry-run", "-n"])]
CacheFolder = Annotated[
    Path | None,
    Parameter(name="--cache", help="Share results with other runs in this folder; SCAFFOLD_PIPELINE_CACHE by default."),
]


def answer(value: object, text: str, *, as_json: bool) -> int:
    """Print a command's result, as JSON or as text, and return exit code 0."""
    if as_json:
        import json

        print(json.dumps(value, indent=2, ensure_ascii=False))
    elif text:
        print(text)
    return 0


def select_cache(folder: Path | None) -> Cache | None:
    """Return the cache in `folder`, or the one named in the environment, with the environment's size limit, or None."""
    from scaffold_pipeline.runs.cache import choose_cache

    return choose_cache(folder)
