"""How to repeat a run, and how to cite the software."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scaffold_pipeline import __version__

AUTHORS = "scaffold-pipeline contributors"
TITLE = "scaffold-pipeline"
ABOUT = "From an anatomical surface to a printable porous scaffold, a staged, reproducible ARBF pipeline"
PAPER_AUTHORS = "Liu, Y., Guo, Y., Yu, Z."
PAPER = "Porous Structure Design in Tissue Engineering Using Anisotropic Radial Basis Function"
"""As in `CITATION.cff`; a test compares them."""

CITATIONS = (f"{AUTHORS}: {TITLE} (version {__version__}). {ABOUT}.", f"{PAPER_AUTHORS}: {PAPER}.")
"""The software, and the paper whose field it computes."""


def needed_files(record: Mapping[str, Any]) -> list[str]:
    """Return the input files of a run, each with its hash."""
    return sorted(
        f"{(stage.get('parameters') or {}).get(name)}: SHA-256 {digest}"
        for stage in record.get("stages") or ()
        for name, digest in (stage.get("input_files") or {}).items()
    )
