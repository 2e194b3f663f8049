from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from textwrap import dedent

import pytest

from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.stages.libraries import DISTRIBUTION, imported_libraries, imports_in
from scaffold_pipeline.stages.registry import load_stage


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that makes importable files of a plug-in: their texts by their paths."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(**texts: str) -> None:
        for name, text in texts.items():
            path = tmp_path / f"{name.replace('__in__', '/')}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(dedent(text))

    return make


def test_imports_at_the_top_and_inside_functions_count(package: Callable[..., None]):
    package(
        leaning_a="""
        import json, numpy as np
        from scipy.spatial import cKDTree

        def work():
            if True:
                import trimesh.graph
        """
    )
    assert imported_libraries("leaning_a") == {"numpy", "scipy", "trimesh"}


def test_a_distribution_is_named_as_it_is_installed_and_the_parameters_library_left_out(package: Callable[..., None]):
    package(leaning_b="import skimage.measure, igl, vtkmodules.all, pydantic")
    assert imported_libraries("leaning_b") == {"scikit-image", "libigl", "vtk"}


def test_other_modules_of_a_plug_in_are_followed_by_absolute_and_relative_imports(package: Callable[..., None]):
    package(
        leaning_c__in__stages="""
            from . import kernels
            from .shapes import cube
            from leaning_c import far
            """,
        leaning_c__in__kernels="import numba\nfrom . import stages",
        leaning_c__in__shapes="import trimesh",
        leaning_c__in__far="import lxml",
        leaning_c__in__unused="import igl",
    )
    assert imported_libraries("leaning_c.stages") == {"numba", "trimesh", "lxml"}


def test_packages_of_no_distribution_are_followed(package: Callable[..., None]):
    package(leaning_d="import leaning_e", leaning_e="from leaning_f import thing", leaning_f="import scipy")
    assert imported_libraries("leaning_d") == {"scipy"}


def test_what_is_not_installed_is_left_out_and_nothing_is_imported(package: Callable[..., None]):
    package(leaning_g="raise AssertionError\nimport cupy_of_another_world, scipy, leaning_h.inner", leaning_h="")
    assert imported_libraries("leaning_g") == {"scipy"}
    assert "leaning_g" not in sys.modules


def test_a_plug_in_that_computes_with_our_geometry_depends_on_this_package_and_what_that_imports(
    package: Callable[..., None],
):
    package(leaning_i="from scaffold_geometry.voxels.grids import distance_inside")
    assert imported_libraries("leaning_i") >= {DISTRIBUTION, "numpy", "numba"}
    package(leaning_j="from scaffold_pipeline.artifacts import SurfaceMesh")
    assert imported_libraries("leaning_j") == set()


def test_a_changed_source_is_read_again(package: Callable[..., None]):
    package(leaning_k="import scipy")
    assert imported_libraries("leaning_k") == {"scipy"}
    package(leaning_k="import numba, scipy")
    assert imported_libraries("leaning_k") == {"numba", "scipy"}


def test_a_module_without_source_imports_nothing():
    assert imported_libraries("no_such_module") == imported_libraries("__main__.odd") == set()
    assert imported_libraries("math") == set()


def test_relative_imports_are_resolved_from_their_package():
    lines = ast.parse("from . import a; from ..b import c; from d import e; import f.g").body
    assert list(imports_in(lines, "p.q")) == [("p.q", "a"), ("p.b", "c"), ("d", "e"), ("f.g", "")]


STAGE = """
    from scaffold_pipeline.stages.contract import Params, stage
    from scaffold_pipeline.artifacts import Metrics

    class Nothing(Params):
        pass

    @stage(writes="metrics", version=1{more})
    def {name}(*, params: Nothing) -> Metrics:
        "Do nothing."
        {body}
        return Metrics({{}})
    """


@pytest.mark.usefixtures("project")
def test_a_stage_knows_its_libraries_with_their_versions(install: Callable[..., None]):
    install("thrifty_package", STAGE.format(name="thrifty", more="", body="import scipy"), "thrifty")
    assert load_stage("thrifty").libraries == {name: version(name) for name in ("numpy", "scipy")}


@pytest.mark.usefixtures("project")
def test_declared_libraries_are_added_to_those_that_are_imported(install: Callable[..., None]):
    text = STAGE.format(name="declaring", more=", libraries=['trimesh', 'numpy']", body="import scipy")
    install("declaring_package", text, "declaring")
    assert list(load_stage("declaring").libraries) == ["numpy", "scipy", "trimesh"]


@pytest.mark.usefixtures("project")
def test_a_declared_library_that_is_not_installed_is_refused_when_the_stage_is_loaded(install: Callable[..., None]):
    install("amiss_package", STAGE.format(name="amiss", more=", libraries=['no_such']", body="pass"), "amiss")
    with pytest.raises(StageDefinitionError, match="stage 'amiss': its declared library 'no_such' is not"):
        load_stage("amiss")


@pytest.mark.usefixtures("project")
def test_a_source_that_is_no_python_is_named(install: Callable[..., None], tmp_path: Path):
    install("torn_package", STAGE.format(name="torn", more="", body="from torn_part import nothing"), "torn")
    (tmp_path / "site-torn_package" / "torn_part.py").write_text("\nimport :")
    with pytest.raises(StageDefinitionError, match=r"stage 'torn': .*torn_part.py:2: "):
        _ = load_stage("torn").libraries


def test_libraries_are_looked_for_only_when_they_are_asked_for(monkeypatch: pytest.MonkeyPatch):
    def fail(_module: str) -> frozenset[str]:
        raise AssertionError

    monkeypatch.setattr("scaffold_pipeline.stages.contract.imported_libraries", fail)
    stage = load_stage("jitter")
    vars(stage).pop("libraries", None)
    assert stage.summary
    with pytest.raises(AssertionError):
        _ = stage.libraries
