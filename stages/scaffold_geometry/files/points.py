"""Read points from a text file."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from scaffold_geometry.arrays import Floats
from scaffold_geometry.files.text import read_text
from scaffold_pipeline.errors import StageError


def read_points(path: Path) -> Floats:
    """Read points (n, 3), mm, from comma-separated text with three columns, with or without a header line."""
    try:
        lines = read_text(path).decode("utf-8", "replace").splitlines()
        is_named = not any(_is_number(cell) for cell in lines[0].split(",")) if lines else True
        points = np.array([[float(cell) for cell in line.split(",")] for line in lines[is_named:] if line.strip()])
    except ValueError as error:
        raise StageError(f"points: {path.name} is not comma-separated numbers: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():  # x, y, z
        raise StageError(f"points: {path.name} must hold rows of finite x, y, z in mm, got shape {points.shape}")
    return points


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        float(text)
        return True
    return False
