"""The front door: its names, and that it costs nothing until it is used."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys

import pytest

import scaffold_pipeline as sp


def fresh(code):
    """Return what a fresh interpreter prints as JSON."""
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(made.stdout)


def test_there_are_about_twenty_public_names_each_documented():
    assert 15 <= len(sp.__all__) <= 25
    assert set(sp.__all__) < set(dir(sp))
    bare = [name for name in sp.__all__ if not inspect.getdoc(getattr(sp, name))]
    assert bare == []
    with pytest.raises(AttributeError, match="has no attribute 'rum'"):
        sp.rum  # noqa: B018


@pytest.mark.parametrize(
    "name",
    [
        "Run",
        "StudyRun",
        "open_run",
        "run",
        "study",
        "SurfaceMesh",
        "OuterShape",
        "VolumeMesh",
        "PlanarMesh",
        "IsoSurface",
        "Solid",
        "ScalarField",
        "Certificate",
        "Contour",
    ],
)
def test_docstrings_have_numpydoc_sections(name):
    text = inspect.getdoc(getattr(sp, name))
    assert "Parameters\n----------\n" in text


def test_importing_it_imports_no_library():
    code = "import scaffold_pipeline, sys, json; print(json.dumps(sorted(sys.modules)))"
    loaded = fresh(code)
    assert [name for name in loaded if name.startswith("scaffold_pipeline")] == ["scaffold_pipeline"]
    assert not {"numpy", "pydantic", "trimesh", "typing"} & set(loaded)


@pytest.mark.parametrize("name", ["run", "study"])
@pytest.mark.parametrize("first", ["pass", "import scaffold_pipeline.api.{0}", "import scaffold_pipeline.cli.app"])
def test_run_and_study_are_functions_whatever_was_imported_before(name, first):
    code = f"""
import json, types
import scaffold_pipeline as sp
{first.format(name)}
from scaffold_pipeline import {name} as function
print(json.dumps([isinstance(sp.{name}, types.FunctionType), function is sp.{name}]))
"""
    assert fresh(code) == [True, True]
