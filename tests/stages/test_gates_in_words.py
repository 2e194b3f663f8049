"""The page of a run tells each of our gates in words."""

import pytest

from scaffold_pipeline.stages.contract import Params
from scaffold_pipeline.stages.registry import load_stage
from scaffold_stages.measure import MeasureParams
from scaffold_stages.measure_plate import MeasurePlateParams


@pytest.mark.parametrize(("name", "params"), [("measure", MeasureParams), ("measure_plate", MeasurePlateParams)])
def test_each_gate_has_words(name: str, params: type[Params]):
    switches = {name for name in params.model_fields if name.startswith("gate_")}
    declared = load_stage(name).reports.gates
    assert switches
    assert switches <= {gate.switch for gate in declared}
    assert all(gate.passed for gate in declared)
