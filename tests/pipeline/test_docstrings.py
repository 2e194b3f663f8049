from __future__ import annotations

import doctest
import importlib
import pkgutil

import scaffold_geometry
import scaffold_pipeline
import scaffold_stages


def test_the_examples_of_docstrings_give_what_they_say():
    names = [
        module.name
        for package in (scaffold_pipeline, scaffold_geometry, scaffold_stages)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not module.name.endswith(".__main__")
    ]
    results = {name: doctest.testmod(importlib.import_module(name)) for name in names}
    assert sum(result.attempted for result in results.values()) > 10
    assert [name for name, result in results.items() if result.failed] == []
