"""Checks of every input file, before and after it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from scaffold_pipeline.errors import StageError, warn

Content = TypeVar("Content")

_SMALLEST, _LARGEST = 1.0, 2000.0
"""mm: from a bone of the ear to a whole body; other sizes most probably have the wrong unit."""

_FARTHEST = 1e9
"""mm: a thousand kilometres; anything farther is damage."""


def reader_of(path: Path, readers: Mapping[str, Callable[[Path], Content]], thing: str) -> Callable[[Path], Content]:
    """Return the reader for a file's suffix; raises `StageError` if there is none, or the file is empty."""
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise StageError(
            f"{path.name}: cannot read files of type {path.suffix or '(no suffix)'}; "
            f"export the {thing} as one of {', '.join(sorted(readers))}"
        )
    if not path.stat().st_size:
        raise StageError(f"{path.name}: is an empty file (0 bytes); export or download it again")
    return reader


def warn_of_odd_size(vertices: NDArray[np.float64], name: str) -> None:
    """Warn if the longest side of `vertices` (n, 3), mm, is not that of a bone; to be called by the stage itself."""
    longest = float(np.ptp(vertices, axis=0).max())
    # A surface scaled to the unit cube has no unit.
    if not _SMALLEST < longest <= _LARGEST:
        warn(
            f"{name}: its longest side is {longest:.4g} mm, not between {_SMALLEST:g} and {_LARGEST:g} mm: "
            "is `units` right?"
        )


def require_near_origin(vertices: NDArray[np.float64], name: str) -> None:
    """Require that no vertex (n, 3) is absurdly far from the origin, mm, from damage or a wrong unit."""
    farthest = float(np.abs(vertices).max(initial=0.0))
    if not farthest <= _FARTHEST:
        raise StageError(
            f"{name}: a vertex is {farthest:.3g} mm from the origin, at most {_FARTHEST:g} mm is accepted; check "
            "`units`, or export it again"
        )
