from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from scaffold_geometry import jit


def test_machine_code_is_kept_by_the_sources_of_all_that_a_kernel_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "kept_kernels"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "formula.py").write_text("from scaffold_geometry import arrays")
    (folder / "other.py").touch()
    (folder / "loops.py").write_text("import kept_kernels.other\nfrom .formula import arrays")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("kept_kernels.loops")
    assert jit._sources_of("kept_kernels.loops") - {"kept_kernels"} == {
        *("kept_kernels.loops", "kept_kernels.formula", "kept_kernels.other"),
        *("scaffold_geometry", "scaffold_geometry.arrays", "scaffold_geometry.jit"),
    }
