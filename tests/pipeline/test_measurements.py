import json

import numpy as np
import pytest

from scaffold_pipeline.artifacts import Curve, Finding, Histogram, Metrics
from scaffold_pipeline.errors import StageError


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (
            lambda: Histogram("a", "A", "mm", np.array([0.0, 1.0]), np.zeros(2)),
            r"Histogram.shares: must .* \(1,",
        ),
        (
            lambda: Histogram("a", "A", "mm", np.array([0.0, 0.0]), np.zeros(1)),
            "Histogram.edges: must be ascending, those of a",
        ),
        (lambda: Curve("b", "B", "x", "y", np.array([0.0, 1.0]), np.zeros(3)), r"Curve.y: must have shape \(2,\)"),
        (lambda: Curve("b", "B", "x", "y", np.array([1.0, 0.0]), np.zeros(2)), "Curve.x: must be ascending, that of b"),
        (lambda: Finding("c", "C", np.zeros((1, 2))), r"Finding.places: must have shape \('n', 3\)"),
        (lambda: Metrics({}, strut_thickness=np.array([np.nan])), "Metrics.strut_thickness: must be finite"),
    ],
)
def test_what_was_measured_is_checked_when_it_is_made(make, rule):
    with pytest.raises(StageError, match=rule):
        make()


def test_details_are_json_and_keep_every_number():
    metrics = Metrics(
        {"porosity": 0.5},
        histograms=(Histogram("strut", "Struts", "mm", np.array([0.0, 0.1]), np.array([1.0])),),
        curves=(Curve("access", "Access", "diameter, mm", "share", np.array([0.0, 0.3]), np.array([1.0, 0.5])),),
        findings=(Finding("island", "floats", np.array([[1.0, 2.0, 0.1]])),),
    )
    assert json.loads(json.dumps(metrics.details())) == {
        "histograms": [{"name": "strut", "title": "Struts", "unit": "mm", "edges": [0.0, 0.1], "shares": [1.0]}],
        "curves": [
            {"name": "access", "title": "Access", "x_title": "diameter, mm", "y_title": "share"}
            | {"x": [0.0, 0.3], "y": [1.0, 0.5]}
        ],
        "findings": [{"rule": "island", "message": "floats", "places": [[1.0, 2.0, 0.1]]}],
    }
