"""A folder to work in, and installed plug-ins: the fake one of the tree and those a test makes."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.stages import registry

PLUGIN = Path(__file__).with_name("fake_plugin")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Project:
    """An empty project folder, made the current one, with the fake plug-in installed."""
    monkeypatch.chdir(tmp_path)
    _install(PLUGIN, monkeypatch)
    return Project(tmp_path, capsys)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that installs a package: its name, its one module's text, its stages' names."""

    def install_package(name: str, text: str, *stages: str) -> None:
        site = tmp_path / f"site-{name}"
        (site / f"{name}-1.0.dist-info").mkdir(parents=True, exist_ok=True)
        points = "".join(f"{stage} = {name}:{stage}\n" for stage in stages)
        (site / f"{name}-1.0.dist-info" / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (site / f"{name}-1.0.dist-info" / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{points}")
        (site / f"{name}.py").write_text(dedent(text))
        sys.modules.pop(name, None)
        _install(site, monkeypatch)

    return install_package


def _install(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(site)
    earlier = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), *([earlier] if earlier else [])]))
    registry._load.cache_clear()
