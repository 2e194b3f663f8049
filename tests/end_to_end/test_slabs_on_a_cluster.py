"""A field computed in slabs by a real cluster's workers: the command's own way to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pipeline.test_cluster import needs_dask, scheduler, wait_for_workers, worker
from scaffold_geometry.fields import slabs
from scaffold_pipeline.cli.app import main

CONFIG = """
name: block
seed: 1
stages:
  - {use: make_mesh, shape: block, counts: [3, 2, 2], edge: 4.0}
  - {use: jitter, amount: 0.2}
  - {use: extract_outer}
  - {use: arbf_field, voxel_size: 0.2}
"""


@needs_dask
def test_a_field_that_a_cluster_computed_is_the_local_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(slabs, "VOXELS_AT_ONCE", 60_000)
    (tmp_path / "block.yaml").write_text(CONFIG)
    run = ["run", str(tmp_path / "block.yaml"), "--quiet"]
    with scheduler(tmp_path) as (address, _), worker(address, "--no-nanny"), worker(address, "--no-nanny"):
        wait_for_workers(address, 2)
        assert main([*run, "--out", str(tmp_path / "there"), "--scheduler", address]) == 0
    assert main([*run, "--out", str(tmp_path / "here")]) == 0
    here, there = (field_of(tmp_path / name) for name in ("here", "there"))
    assert (here["key"], here["output"]) == (there["key"], there["output"])
    assert (here["reused"], there["reused"]) == (False, False)


def field_of(out: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((out / "run.json").read_text())["stages"][-1]
    return record
