"""What stages tell is declared: the check of `conftest`, under which all tests here run, finds what is not."""

from __future__ import annotations

import pytest

from scaffold_pipeline.artifacts import Metrics
from scaffold_pipeline.report.declared import declared_here
from scaffold_pipeline.stages.registry import load_stage
from stages.conftest import undeclared_keys

MEASURING = ("inspect_surface", "measure", "measure_field", "measure_plate")


def test_a_key_that_no_stage_declares_is_found():
    known = declared_here()
    assert undeclared_keys(Metrics({"porosity": 0.5, "tortuosity_x": 1.0, "curvature": 2.0}), known) == ["curvature"]


@pytest.mark.parametrize("name", MEASURING)
def test_a_stage_declares_each_key_once_and_in_words(name: str):
    metrics = load_stage(name).reports.metrics
    keys = [metric.key for metric in metrics]
    assert len(set(keys)) == len(keys)
    assert all(metric.title and metric.meaning.endswith(".") for metric in metrics)


def test_one_key_has_one_name_and_unit_wherever_a_solid_is_measured():
    by_key: dict[str, set[tuple[str, str]]] = {}
    for name in MEASURING[1:]:
        for metric in load_stage(name).reports.metrics:
            by_key.setdefault(metric.key, set()).add((metric.title, metric.unit))
    assert {key: names for key, names in by_key.items() if len(names) > 1} == {}
