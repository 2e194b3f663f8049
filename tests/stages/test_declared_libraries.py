"""The libraries of a stage are those that its code imports, itself or through what stages share, as grimp sees them."""

from __future__ import annotations

import sys
from importlib.metadata import packages_distributions

import grimp
import pytest

from scaffold_pipeline.stages.registry import load_stage, stage_owners
from scaffold_pipeline.stages.registry import stage_names as names

SHAPE_NO_OUTPUT = {"pydantic"}
"""It checks parameters."""


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    ours = ("scaffold_stages", "scaffold_geometry", "scaffold_pipeline")
    return grimp.build_graph(*ours, include_external_packages=True)


def libraries_of(module: str, graph: grimp.ImportGraph) -> set[str]:
    distributions = packages_distributions()
    seen: set[str] = set()
    found: set[str] = set()
    todo = {module}
    while todo:
        at = todo.pop()
        seen.add(at)
        for imported in graph.find_modules_directly_imported_by(at):
            top = imported.partition(".")[0]
            if top in {"scaffold_stages", "scaffold_geometry"}:
                todo |= {imported} - seen
            elif top != "scaffold_pipeline" and top not in sys.stdlib_module_names:
                found |= set(distributions.get(top, [top]))
    return found - SHAPE_NO_OUTPUT


@pytest.mark.parametrize("name", [name for name in names() if stage_owners([name]).keys() == {"scaffold-pipeline"}])
def test_the_libraries_of_a_stage_are_those_that_its_code_imports(name: str, graph: grimp.ImportGraph):
    stage = load_stage(name)
    assert stage.libraries.keys() == libraries_of(stage.function.__module__, graph) | {"numpy"}
    assert not stage.unseen_libraries
