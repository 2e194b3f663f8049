"""What a short chain makes of a file, as a user would start it, and whether that is allowed.

`python tests/corpus/outcome.py FILE ...` prints a table. Allowed: a solid that passes its gates and the judge from
outside, or clear lines with the right exit code. Never: a traceback, a crash, a hang, or exit code 0 with a bad solid.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from end_to_end.solid_judge import faults_of

POROSITY = 0.6
MOST_SECONDS = 600.0
CELLS, MOST_CELLS = 200, 5000  # of a surface, which has more where it is thinner than an edge
CELL_VOLUME = 0.109  # of such a cell, in cubes of its mean edge
FINENESS = 16.0  # voxels to a mean edge
MOST_VOXELS = 3e6  # of the bounding box: a volume mesh of tens of thousands of cells has coarser ones, and minutes
SMALLEST = 2.0  # mm: what is smaller is taken to be in metres
CLEAR = {1: "refused", 2: "refused", 3: "gate failed"}

Stage = dict[str, object]
VOLUMES = "volume"
"""Name of the folder whose files are meshes of cells."""


class Outcome(NamedTuple):
    """What happened: `verdict` a word, `is_allowed`, the seconds, and what the user read last."""

    verdict: str
    is_allowed: bool
    seconds: float
    said: str


def outcome_of(file: Path, folder: Path, repair: str = "safe") -> Outcome:
    """Run the chain on a file in an empty folder and judge what comes of it."""
    config = folder / "config.yaml"
    started = time.perf_counter()
    for units in ("mm", "m"):
        loading = _loading(file, units, repair)
        ended = _run(config, loading, folder / "out")
        if ended.code != 0:
            break
        if max(_sizes(folder / "out")) < SMALLEST:
            continue  # the judge merges vertices that lie 1e-8 mm apart
        ended = _run(config, [*loading, *_stages_after(folder / "out", file)], folder / "out")
        break
    return _judged(ended, folder / "out", time.perf_counter() - started)


def _sizes(out: Path) -> list[float]:
    """Return the sides of the outer shape, mm."""
    return [_fact(out, f"size_{axis}") for axis in "xyz"]


def _fact(out: Path, name: str) -> float:
    """Return the first fact of that name in a run's record."""
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    return next(stage["summary"][name] for stage in record["stages"] if name in stage["summary"])


class _Ended(NamedTuple):
    code: int
    lines: list[str]


def _run(config: Path, stages: list[Stage], out: Path) -> _Ended:
    config.write_text(json.dumps({"name": "corpus", "seed": 1, "stages": stages}), encoding="utf-8")  # JSON is YAML
    command = [sys.executable, "-m", "scaffold_pipeline", "run", str(config), "--out", str(out), "--quiet"]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return _Ended(124, [f"no end after {MOST_SECONDS:g} s"])
    return _Ended(ended.returncode, [line for line in ended.stderr.splitlines() if ": warning: " not in line])


def _judged(ended: _Ended, out: Path, seconds: float) -> Outcome:
    said = ended.lines[-1] if ended.lines else ""
    has_traceback = any("Traceback" in line for line in ended.lines)
    if ended.code == 0:
        metrics = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
        faults = faults_of(out / "solid.stl", metrics["outer_volume_mm3"], POROSITY)
        faults += [] if metrics["quality"] == "pass" else [f"quality {metrics['quality']}"]
        return Outcome("bad solid" if faults else "solid", not faults, seconds, "; ".join(faults))
    is_clear = ended.code in CLEAR and not has_traceback and 0 < len(ended.lines) <= 6
    is_clear &= (out / "solid.stl").exists() == (ended.code == 3)
    return Outcome(CLEAR.get(ended.code, f"exit code {ended.code}"), is_clear, seconds, said)


def _loading(file: Path, units: str, repair: str) -> list[Stage]:
    given: Stage = {"path": str(file.resolve()), "units": units}
    if file.parent.name == VOLUMES:
        return [{"use": "load_volume_mesh", **given}, {"use": "extract_outer"}]
    return [{"use": "load_surface", **given, "repair": repair}]


def _stages_after(out: Path, file: Path) -> list[Stage]:
    """Return the rest of the chain, its cells and voxels of a size that suits the shape."""
    finest = (math.prod(_sizes(out)) / MOST_VOXELS) ** (1.0 / 3.0)
    if file.parent.name == VOLUMES:
        return _stages_from_the_field(max(_fact(out, "edge_length_mean") / FINENESS, finest))
    volume = _fact(out, "volume_mm3")
    thickness = 2.0 * volume / _fact(out, "area_mm2")
    cells = round(min(max(CELLS, volume / (CELL_VOLUME * thickness**3)), MOST_CELLS))
    edge = (volume / (CELL_VOLUME * cells)) ** (1.0 / 3.0)
    mesh: Stage = {"use": "tetrahedralise", "cells": cells, "time_limit": 300}
    return [mesh, *_stages_from_the_field(max(edge / FINENESS, finest))]


def _stages_from_the_field(voxel_size: float) -> list[Stage]:
    return [
        {"use": "arbf_field", "voxel_size": voxel_size},
        {"use": "isosurface", "porosity": POROSITY},
        {"use": "clean_surface"},
        {"use": "intersect_outer"},
        {"use": "measure"},
        {"use": "write_solid", "formats": ["stl"], "preview": False},
    ]


def main(files: list[Path]) -> int:
    """Print what becomes of each file; return how many outcomes are not allowed."""
    print("| file | verdict | seconds | said |\n|---|---|---|---|")
    bad = 0
    for file in files:
        with tempfile.TemporaryDirectory() as folder:
            outcome = outcome_of(file, Path(folder))
        bad += not outcome.is_allowed
        mark = "" if outcome.is_allowed else " (NOT ALLOWED)"
        print(f"| {file.name} | {outcome.verdict}{mark} | {outcome.seconds:.0f} | {outcome.said} |", flush=True)
    return bad


if __name__ == "__main__":
    sys.exit(min(main([Path(name) for name in sys.argv[1:]]), 1))
