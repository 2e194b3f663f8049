"""The page of a run tells each of our gates in words."""

import pytest

from scaffold_pipeline.report.gates import WORDS
from scaffold_pipeline.stages.contract import Params
from scaffold_stages.measure import MeasureParams
from scaffold_stages.measure_plate import MeasurePlateParams


@pytest.mark.parametrize("params", [MeasureParams, MeasurePlateParams])
def test_each_gate_has_words(params: type[Params]):
    gates = {name.removeprefix("gate_") for name in params.model_fields if name.startswith("gate_")}
    assert gates
    assert gates <= set(WORDS)
