"""A plate is measured as its file holds it, and each gate fails on a planted fault alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scaffold_geometry.planar.regions import prism
from scaffold_pipeline.artifacts import Certificate, Contour, Metrics, Polygons, ScalarField, Solid
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.measure_plate import MeasurePlateParams, measure_plate
from shapes import box, squares, together

OUTLINE = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)])
HOLES = [np.array([(x, 2.0), (x, 6.0), (x + 2.0, 6.0), (x + 2.0, 2.0)]) for x in (1.0, 4.0)]
CONTOUR = Contour(Polygons.of([OUTLINE, *HOLES]), Polygons.of([OUTLINE]), 1.0, 0.1, 0.2)


def plate(*more: tuple[np.ndarray, np.ndarray]) -> Solid:
    """Return the plate, 3 mm high, with two square holes of 24 mm^3 each, and more bodies."""
    return Solid(*together(prism(CONTOUR.solid.rings, 1.0, 4.0), *more), pore_volumes=np.array([24.0, 24.0]))


def field(strut_min: float = 0.4, *, is_certified: bool = True) -> ScalarField:
    certificate = Certificate(np.array([-0.5, 0.3]), np.array([strut_min, 0.9, 0.95]))
    return ScalarField(np.zeros((3, 4, 1)), np.zeros(3), 0.5, certificate if is_certified else None, {"elements": 5})


def measured(solid: Solid, contour: Contour = CONTOUR, given: ScalarField | None = None, **params: object) -> Metrics:
    return measure_plate(
        solid, contour, given or field(), squares((2, 1)), params=MeasurePlateParams.model_validate(params)
    )


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("measure_plate", measure_plate)
    assert declared.writes == "metrics"
    assert {name for name, read in declared.reads.items() if read.optional} == {"mesh"}


def test_a_known_plate_is_measured_exactly_and_passes_though_its_channels_are_closed():
    metrics = measured(plate())
    expected = {
        "porosity": pytest.approx(0.2, abs=1e-12),
        "porosity_requested": 0.2,
        "iso": 0.1,
        "channels_closed": 1,
        "struts_broken": 0,
        "is_manifold": True,
        "solid_pieces": 1,
        "closed_pores": 0,
        "holes": 2,
        "pore_pieces": 2,
        "size_x_mm": 10.0,
        "size_y_mm": 8.0,
        "size_z_mm": 3.0,
        "volume_mm3": pytest.approx(192.0),
        "area_mm2": pytest.approx(2 * 64.0 + 3 * 36.0 + 2 * 3 * 12.0),
        "outer_volume_mm3": pytest.approx(240.0),
        "cells": 2,
        "elements": 5,
        "voxels": 12,
    }
    assert {name: metrics.values[name] for name in expected} == expected
    assert "under_resolved" not in metrics.values
    assert metrics.failed_gates == ()


def test_without_a_certificate_its_gate_is_silent():
    assert measured(plate(), given=field(is_certified=False)).failed_gates == ()


def opened() -> Solid:
    whole = plate()
    return replace(whole, faces=whole.faces[:-1])


FAULTS = {
    "manifold": (lambda: {"solid": opened(), "porosity_tolerance": 0.1}, "manifold: the plate has open, non-manifold"),
    "one_piece": (
        lambda: {"solid": plate(box((20.0, 0.0, 1.0), (20.1, 0.1, 1.1)))},
        "one_piece: 2 pieces instead of 1; lower porosity or iso, or let contour drop",
    ),
    "porosity": (
        lambda: {"solid": plate(), "contour": replace(CONTOUR, porosity_requested=0.206)},
        "porosity: 0.2000 differs from the 0.206 requested by more than 0.005; smaller voxels",
    ),
    "struts_whole": (
        lambda: {"solid": plate(), "given": field(-0.2)},
        "struts_whole: iso 0.1000 is 0.3000 above strut_min: 1 of 3 struts may be broken; lower porosity or iso",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_fails_its_gate_alone_and_the_gate_has_a_switch(name: str):
    plant, said = FAULTS[name]
    (failure,) = measured(**plant()).failed_gates
    assert failure.startswith(said)
    assert measured(**plant(), **{f"gate_{name}": False}).failed_gates == ()


def test_with_an_iso_given_no_porosity_is_missed():
    assert measured(plate(), replace(CONTOUR, porosity_requested=None)).failed_gates == ()
