"""How a run is made again, and how the software is cited, in words."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from scaffold_pipeline import __version__
from scaffold_pipeline.report.markup import items, text_of

AUTHORS = "scaffold-pipeline contributors"
TITLE = "scaffold-pipeline"
ABOUT = "From an anatomical surface to a printable porous scaffold, a staged, reproducible ARBF pipeline"
PAPER_AUTHORS = "Liu, Y., Guo, Y., Yu, Z."
PAPER = "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function"
"""As `CITATION.cff` has them: a test compares."""


def how_to_run(record: Mapping[str, Any]) -> str:
    """Return the commands that make a run again, and what they need."""
    version = (record.get("versions") or {}).get(TITLE)
    inputs = sorted(
        f"{(stage.get('parameters') or {}).get(name)}: SHA-256 {digest}"
        for stage in record.get("stages") or ()
        for name, digest in (stage.get("input_files") or {}).items()
    )
    needed = f"<p>Input files, which must be the same:</p>\n{items(inputs)}" if inputs else ""
    return (
        f"<p>In the run's own folder, with scaffold-pipeline {text_of(version)}:</p>\n<pre>{escape(_COMMANDS)}</pre>\n"
        f'{needed}<p class="meaning">{_WHAT_THEY_DO}</p>'
    )


def how_to_cite() -> str:
    """Return the references to the software and to the paper whose field it computes."""
    lines = (f"{AUTHORS}: {TITLE} (version {__version__}). {ABOUT}.", f"{PAPER_AUTHORS}: {PAPER}.")
    return f"<p>If you use what this run made, please cite:</p>\n{items(lines)}"


_COMMANDS = """scaffold-pipeline run config.yaml --out again
scaffold-pipeline verify .
scaffold-pipeline report ."""

_WHAT_THEY_DO = (
    "The first runs the resolved configuration in a folder of its own. The second makes every result again from the "
    "mesh that is stored here and compares it with run.json, hash by hash. The third writes this page again from the "
    "record."
)
