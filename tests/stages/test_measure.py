"""What is measured is exact on solids of known form, and each gate fails on a planted fault alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from scaffold_geometry.measures.gates import _failed_interruptions, _failed_sizes
from scaffold_geometry.surfaces import booleans
from scaffold_pipeline import stages
from scaffold_pipeline.artifacts import Certificate, IsoSurface, Metrics, ScalarField, Solid
from scaffold_pipeline.errors import PipelineWarning
from scaffold_pipeline.stages.contract import stage_from_function
from scaffold_stages.measure import MeasureParams, measure
from shapes import box, hexahedra, inverted, outer_of, tetrahedra, together

OUTER = outer_of(box((0.0, 0.0, 0.0), (10.0, 8.0, 6.0)))
POROSITY = 4.0 * 3.0 * 6.0 / 480.0


def pierced():
    """Return the outer box with a square channel of 4 x 3 mm along z through it."""
    block = booleans.to_manifold(OUTER.vertices, OUTER.faces, "box")
    channel = booleans.to_manifold(*box((2.0, 2.0, -1.0), (6.0, 5.0, 7.0)), "channel")
    return booleans.from_manifold(block - channel)


def solid_of(*surfaces: tuple[np.ndarray, np.ndarray], pores: tuple[float, ...] = (72.0,)):
    return Solid(*together(*surfaces), pore_volumes=np.array(pores))


def porous(iso: float = 0.1, porosity: float | None = POROSITY, skin: float = 0.0):
    return IsoSurface(OUTER.vertices, OUTER.faces, iso=iso, porosity_requested=porosity, skin=skin)


def field(channel_max: float = -0.2, strut_min: float = 0.4):
    certificate = Certificate(np.array([-0.5, channel_max]), np.array([strut_min, 0.9, 0.95]))
    return ScalarField(np.zeros((3, 4, 5)), np.zeros(3), 0.5, certificate, {"elements": 5})


def measured(solid: Solid, **given: object) -> Metrics:
    inputs = {"porous": porous(), "field": field(), **{k: given.pop(k) for k in ("porous", "field") if k in given}}
    return measure(solid, OUTER, **inputs, params=MeasureParams.model_validate({"morphometry": False, **given}))


def test_it_keeps_the_contract_of_a_stage():
    declared = stage_from_function("measure", measure)
    assert declared.writes == "metrics"
    assert {name for name, read in declared.reads.items() if read.optional} == {"mesh"}


def test_a_known_solid_is_measured_exactly_and_passes():
    metrics = measured(solid_of(pierced()))
    expected = {
        "porosity": pytest.approx(POROSITY, abs=1e-12),
        "porosity_requested": POROSITY,
        "iso": 0.1,
        "channel_max": -0.2,
        "strut_min": 0.4,
        "channels": 2,
        "channels_closed": 0,
        "struts": 3,
        "struts_broken": 0,
        "solid_pieces": 1,
        "solid_largest_fraction": 1.0,
        "closed_pores": 0,
        "pore_pieces": 1,
        "pore_largest_fraction": 1.0,
        "is_manifold": True,
        "volume_mm3": pytest.approx(480.0 - 72.0),
        "area_mm2": pytest.approx(2 * (80 + 60 + 48) - 2 * 12 + 2 * (4 + 3) * 6),
        "outer_volume_mm3": pytest.approx(480.0),
        "cells": None,
        "elements": 5,
        "voxels": 60,
        "voxel_size": 0.5,
    }
    assert {name: metrics.values[name] for name in expected} == expected
    assert metrics.failed_gates == ()
    assert metrics.summary()["quality"] == "pass"


def test_the_cells_are_those_of_the_mesh():
    mesh = tetrahedra((1, 2, 3))
    assert (
        measure(solid_of(pierced()), OUTER, porous(), field(), mesh, params=MeasureParams(morphometry=False)).values[
            "cells"
        ]
        == 36
    )


def test_what_was_done_to_the_outer_shape_is_told():
    repaired = replace(OUTER, facts={"repair_distance_mm": 0.25})
    metrics = measure(solid_of(pierced()), repaired, porous(), field(), params=MeasureParams(morphometry=False))
    assert metrics.values["repair_distance_mm"] == 0.25


def test_without_a_certificate_its_gate_is_not_applied_and_says_so():
    bare = ScalarField(np.zeros((2, 2, 2)), np.zeros(3), 0.5)
    metrics = measured(solid_of(pierced()), field=bare)
    assert metrics.failed_gates == ()
    assert "channel_max" not in metrics.values
    gates = ["certificate", "interrupted"]
    assert [line.partition(":")[0] for line in metrics.values["gates_not_applied"]] == gates
    off = {f"gate_{name}": False for name in gates}
    assert measured(solid_of(pierced()), field=bare, **off).values["gates_not_applied"] == []


def test_without_a_mesh_interrupted_struts_are_not_looked_for_and_it_says_so():
    assert measured(solid_of(pierced())).values["gates_not_applied"] == [
        "interrupted: there is no mesh, so no struts and channels to check"
    ]


def test_a_field_of_two_networks_may_have_its_pores_in_two_pieces_and_no_more():
    two = ScalarField(np.zeros((2, 2, 2)), np.zeros(3), 0.5, pore_networks=2)
    parted = solid_of(pierced(), pores=(40.0, 31.5, 0.5))
    metrics = measured(parted, field=two)
    assert metrics.failed_gates == ()
    assert metrics.values["pore_largest_fraction"] == pytest.approx(40.0 / 72.0)
    assert metrics.values["pore_networks_fraction"] == pytest.approx(71.5 / 72.0)
    (failure,) = measured(parted).failed_gates
    assert failure.startswith("pores_connected: 55.56 % of the pore volume is connected; at least 99 %")
    (failure,) = measured(solid_of(pierced(), pores=(30.0, 30.0, 12.0)), field=two).failed_gates
    assert failure.startswith("pores_connected: 83.33 % of the pore volume is connected in 2 networks; at least 99 %")
    (failure,) = measured(solid_of(pierced()), field=two).failed_gates
    assert "100.00 % of the pore volume is connected instead of forming 2 networks" in failure


TINY = box((2.0, 2.0, 2.0), (3.0, 3.0, 3.0))
OFF = porous(porosity=POROSITY - 0.02)
FAULTS = {
    "two pieces": (
        "one_piece",
        lambda: {"solid": solid_of(pierced(), box((3.0, 3.0, 1.0), (4.0, 4.0, 2.0))), "porosity_tolerance": 0.1},
        "one_piece: 2 pieces and 0 closed pores instead of 1 and 0",
    ),
    "a closed pore": (
        "one_piece",
        lambda: {"solid": solid_of(pierced(), inverted(box((8, 6, 1), (9, 7, 2)))), "porosity_tolerance": 0.1},
        "one_piece: 1 pieces and 1 closed pores instead of 1 and 0",
    ),
    "pores apart": (
        "pores_connected",
        lambda: {"solid": solid_of(pierced(), pores=(60.0, 12.0))},
        "pores_connected: 83.33 % of the pore volume is connected; at least 99 % is required",
    ),
    "another porosity": (
        "porosity",
        lambda: {"solid": solid_of(pierced()), "porous": OFF},
        "porosity: 0.1500 differs from the 0.13 requested by more than 0.005",
    ),
    "iso too low": (
        "certificate",
        lambda: {"solid": solid_of(pierced()), "field": field(channel_max=0.3)},
        "certificate: iso 0.1000 is 0.2000 below channel_max: 1 of 2 channels may be closed",
    ),
    "iso too high": (
        "certificate",
        lambda: {"solid": solid_of(pierced()), "field": field(strut_min=-0.1)},
        "certificate: iso 0.1000 is 0.2000 above strut_min: 1 of 3 struts may be broken",
    ),
    "touching in single precision": (
        "manifold",
        lambda: (
            {"solid": solid_of(pierced(), box((10.0 + 1e-8, 8.0, 6.0), (11, 9, 7))), "gate_one_piece": False}
            | {"porosity_tolerance": 0.1}
        ),
        "manifold: the solid has open, non-manifold or touching parts",
    ),
    "open": (
        "manifold",
        lambda: {"solid": solid_of((pierced()[0], pierced()[1][1:])), "porosity_tolerance": 0.1},
        "manifold: the solid has open, non-manifold or touching parts",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_fails_its_gate_alone_and_says_so(fault: str):
    name, plant, said = FAULTS[fault]
    planted = SimpleNamespace(**plant())
    metrics = measured(**vars(planted))
    assert len(metrics.failed_gates) == 1
    assert metrics.failed_gates[0].startswith(said)
    assert metrics.failed_gates[0].startswith(f"{name}: ")
    assert "\n" not in metrics.failed_gates[0]
    assert "; " in metrics.failed_gates[0]  # a remedy
    assert metrics.summary()["quality"] == list(metrics.failed_gates)


@pytest.mark.parametrize("fault", FAULTS)
def test_every_gate_has_its_switch(fault: str):
    name, plant, _ = FAULTS[fault]
    assert measured(**plant(), **{f"gate_{name}": False}).failed_gates == ()


def test_a_skin_closes_one_pore_of_necessity():
    hollow = solid_of(box((0.0, 0.0, 0.0), (10.0, 8.0, 6.0)), inverted(box((2, 2, 2), (6, 5, 4))), pores=(24.0,))
    assert measured(hollow, porous=porous(porosity=0.05, skin=2.0)).failed_gates == ()
    assert len(measured(hollow, porous=porous(porosity=0.05)).failed_gates) == 1


def test_a_skin_closes_both_pores_of_a_sheet():
    pores = [inverted(box((x, 2.0, 2.0), (x + 1.0, 3.0, 3.0))) for x in (2.0, 5.0)]
    hollow = solid_of((OUTER.vertices, OUTER.faces), *pores, pores=(1.0, 1.0))
    given = {"porous": porous(porosity=2.0 / 480.0, skin=2.0)}
    two = ScalarField(np.zeros((2, 2, 2)), np.zeros(3), 0.5, pore_networks=2)
    assert measured(hollow, field=two, **given).failed_gates == ()
    failures = [line.partition(":")[0] for line in measured(hollow, **given).failed_gates]
    assert failures == ["one_piece", "pores_connected"]


def test_a_mesh_that_the_field_is_not_made_of_is_not_measured():
    bare = ScalarField(np.zeros((2, 2, 2)), np.zeros(3), 0.5)
    metrics = measure(
        solid_of(pierced()), OUTER, porous(), bare, tetrahedra((1, 2, 3)), params=MeasureParams(morphometry=False)
    )
    assert metrics.values["cells"] is None
    assert "thinnest_strut_mm" not in metrics.values


def test_faults_add_up():
    bad = solid_of(pierced(), TINY, pores=(30.0, 30.0))
    metrics = measured(bad, porous=porous(iso=0.5, porosity=0.9))
    assert [line.partition(":")[0] for line in metrics.failed_gates] == [
        "one_piece",
        "pores_connected",
        "porosity",
        "certificate",
    ]


def test_a_porosity_within_its_tolerance_passes():
    near = porous(porosity=POROSITY + 0.0049)
    assert measured(solid_of(pierced()), porous=near).failed_gates == ()
    assert len(measured(solid_of(pierced()), porous=near, porosity_tolerance=0.004).failed_gates) == 1


def test_with_an_iso_given_no_porosity_is_missed():
    assert measured(solid_of(pierced()), porous=porous(porosity=None)).failed_gates == ()


def test_slivers_of_pores_pass():
    assert measured(solid_of(pierced(), pores=(71.8, 0.1, 0.1))).failed_gates == ()


def test_a_solid_without_pores_has_none_to_connect():
    whole = solid_of((OUTER.vertices, OUTER.faces), pores=())
    metrics = measured(whole, porous=porous(porosity=None))
    assert (metrics.values["pore_pieces"], metrics.values["porosity"]) == (0, pytest.approx(0.0, abs=1e-12))
    assert [line.partition(":")[0] for line in metrics.failed_gates] == ["pores_connected"]


def struts_and_throats(**asked: object) -> Metrics:
    """Measure a block of two cells, a slit of 1 mm cut between them but for a bar of 2 x 2 mm in the middle."""
    outer = outer_of(box((0.0, 0.0, 0.0), (20.0, 10.0, 10.0)))
    slit = booleans.to_manifold(*box((9.5, -1.0, -1.0), (10.5, 11.0, 11.0)), "slit")
    bar = booleans.to_manifold(*box((9.0, 4.0, 4.0), (11.0, 6.0, 6.0)), "bar")
    block = booleans.to_manifold(outer.vertices, outer.faces, "block") - (slit - bar)
    solid = Solid(*booleans.from_manifold(block), pore_volumes=np.array([1.0]))
    off = {"gate_porosity": False, "gate_interrupted": False, "morphometry": False}
    params = MeasureParams.model_validate({**off, **asked})
    return measure(solid, outer, porous(), field(), hexahedra((2, 1, 1), edge=10.0), params=params)


def test_struts_and_throats_are_measured_in_the_file_where_there_is_a_mesh():
    values = struts_and_throats().values
    assert values["channels_interrupted"] == 12  # the middle of the cells is solid, and so is the bar between them
    assert values["narrowest_throat_mm"] is None  # there is none
    assert values["narrowest_throat_at"] is None
    assert (values["size_x_mm"], values["size_y_mm"], values["size_z_mm"]) == (20.0, 10.0, 10.0)
    assert "thinnest_strut_mm" not in measured(solid_of(pierced())).values


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"min_throat": 0.3}, "min_throat: 12 channels are closed in the file, where at least 0.3 mm is required"),
        ({"build_volume": (10.0, 10.0, 19.0)}, "build_volume: 20 x 10 x 10 mm do not fit into 10 x 10 x 19 mm"),
        ({"build_volume": (30.0, 9.0, 30.0)}, "build_volume: 20 x 10 x 10 mm do not fit into 30 x 9 x 30 mm"),
    ],
)
def test_what_is_too_narrow_or_too_large_fails_where_it_is_asked_for(asked: dict[str, object], said: str):
    (failure,) = struts_and_throats(**asked).failed_gates
    assert failure.startswith(said)
    assert "; " in failure


def test_a_strut_thinner_than_asked_for_fails_and_one_as_thick_passes():
    values = {"thinnest_strut_mm": 0.4, "thinnest_strut_at": "1, 2, 3"}
    sizes = {f"size_{axis}_mm": 1.0 for axis in "xyz"}
    (failure,) = _failed_sizes(values | sizes, MeasureParams(min_strut=0.5))
    assert failure.startswith("min_strut: 0.4 mm at (1, 2, 3), at least 0.5 mm is required; ")
    assert list(_failed_sizes(values | sizes, MeasureParams(min_strut=0.4))) == []
    (failure,) = _failed_sizes(values | sizes | {"struts_interrupted": 1}, MeasureParams(min_strut=0.4))
    assert failure.startswith("min_strut: 1 struts are broken in the file, where at least 0.4 mm is required; ")


def test_without_a_mesh_a_thickness_that_is_asked_for_fails():
    (failure,) = measured(solid_of(pierced()), min_strut=0.1).failed_gates
    assert failure.startswith("min_strut: nothing to measure")


def test_a_solid_that_fits_when_it_is_turned_passes():
    assert struts_and_throats(build_volume=(10.0, 20.0, 10.0)).failed_gates == ()


@pytest.mark.parametrize("room", [(1.0, 0.0, 1.0), (1.0, -1.0, 1.0)])
def test_a_room_without_room_is_no_parameter(room: tuple[float, float, float]):
    with pytest.raises(ValueError, match="above 0 mm"):
        MeasureParams(build_volume=room)


def test_a_file_with_too_many_interrupted_struts_or_channels_fails():
    values = {"struts": 200, "struts_interrupted": 5, "channels": 400, "channels_interrupted": 4}
    (failure,) = _failed_interruptions(values, MeasureParams())
    assert failure.startswith("interrupted: 5 of 200 struts are broken in the file, more than the share of 0.02")
    assert list(_failed_interruptions(values, MeasureParams(most_interrupted=0.025))) == []
    (failure,) = _failed_interruptions({**values, "struts_interrupted": 0}, MeasureParams(most_interrupted=0.005))
    assert failure.startswith("interrupted: 4 of 400 channels are closed in the file")


def test_interrupted_channels_fail_their_gate_in_the_stage_and_it_has_a_switch():
    (failure,) = struts_and_throats(gate_interrupted=True).failed_gates
    assert failure.startswith("interrupted: 12 of 2 channels")  # the planted certificate counts two


def test_the_morphometry_of_a_square_channel_is_that_of_its_sides():
    metrics = measured(solid_of(pierced()), morphometry=True, voxel_size=0.25, probes=[2.0, 3.6])
    expected = {
        "porosity_open": pytest.approx(POROSITY),
        "porosity_closed": 0.0,
        "loops": 1,
        "euler_number": 0,
        "connectivity_density_per_mm3": pytest.approx(1.0 / 480.0),
        "pore_surface_mm2": pytest.approx(84.0),
        "surface_per_solid_per_mm": pytest.approx((376.0 - 24.0 + 84.0) / 408.0),
        "surface_per_total_per_mm": pytest.approx((376.0 - 24.0 + 84.0) / 480.0),
        "pore_surface_per_total_per_mm": pytest.approx(84.0 / 480.0),
        "anisotropy_degree": pytest.approx(1.0, abs=0.01),
        "measure_voxel_size": 0.25,
        "pore_size_median": pytest.approx(3.0, abs=0.25),
        "strut_thickness_p75": pytest.approx(4.0, abs=0.25),
        "throat_50": pytest.approx(3.0, abs=0.25),
        "accessible_to_2_mm": pytest.approx(1.0, abs=0.03),
        "accessible_to_3.6_mm": 0.0,
        "relative_diffusivity_z": pytest.approx(POROSITY),
        "tortuosity_z": pytest.approx(1.0),
        "relative_diffusivity_x": 0.0,
        "tortuosity_x": None,
    }
    assert {name: metrics.values[name] for name in expected} == expected
    axis, throat = (
        [float(part) for part in metrics.values[name].split(", ")] for name in ("anisotropy_axis", "throat_50_at")
    )
    assert throat[:2] == pytest.approx([4.0, 3.5], abs=2.0)  # in the channel, 3 mm wide
    assert axis == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
    for place, text in (("anisotropy_direction", "anisotropy_axis"), ("throat_50_place", "throat_50_at")):
        assert ", ".join(f"{number:.4g}" for number in metrics.values[place]) == metrics.values[text]
    low, high = (metrics.values[f"diffusion_box_{end}"] for end in ("low", "high"))
    assert all(start < end for start, end in zip(low, high, strict=True))
    assert [histogram.name for histogram in metrics.histograms] == ["strut_thickness", "pore_size"]
    assert [histogram.shares.sum() for histogram in metrics.histograms] == pytest.approx([1.0, 1.0])
    (curve,) = metrics.curves
    assert curve.y[0] == pytest.approx(1.0)
    assert metrics.strut_thickness.shape == (len(pierced()[0]),)
    assert metrics.strut_thickness.min() > 0.5


def test_a_closed_pore_is_closed_porosity():
    body = solid_of(pierced(), inverted(box((8, 6, 1), (9, 7, 2))))
    values = measured(body, porosity_tolerance=0.1).values
    assert (values["porosity_open"], values["porosity_closed"]) == (pytest.approx(POROSITY), pytest.approx(1.0 / 480.0))


def thin():
    """Return two plates of 0.5 mm, and one of 0.5 mm that joins them."""
    plates = [box((x, 0.0, 0.0), (x + 0.5, 8.0, 6.0)) for x in (0.0, 9.5)]
    bodies = [booleans.to_manifold(*plate, "plate") for plate in (*plates, box((0.0, 0.0, 0.0), (10.0, 8.0, 0.5)))]
    return booleans.from_manifold(bodies[0] + bodies[1] + bodies[2])


def test_voxels_are_refined_until_struts_have_three():
    values = measured(solid_of(thin()), morphometry=True, diffusion=False).values
    assert values["strut_thickness_mean"] >= 3.0 * values["measure_voxel_size"]
    assert values["strut_thickness_median"] == pytest.approx(0.5, abs=0.15)
    assert "tortuosity_x" not in values


def test_what_given_voxels_cannot_resolve_is_not_told_and_it_says_what_would_do():
    with pytest.warns(
        PipelineWarning, match=r"strut_thickness: not measured, .* of 0.5 mm, where 3 .* measure to 0\.\d+ mm"
    ):
        metrics = measured(solid_of(thin()), morphometry=True, diffusion=False, voxel_size=0.5)
    assert metrics.values["strut_thickness_mean"] is None
    assert metrics.values["pore_size_mean"] > 5.0
    assert [histogram.name for histogram in metrics.histograms] == ["pore_size"]


def test_a_solid_that_is_no_manifold_has_no_morphometry_and_it_says_so():
    touching = solid_of(pierced(), box((10.0, 8.0, 6.0), (11.0, 9.0, 7.0)))
    with pytest.warns(PipelineWarning, match="morphometry: left out, as the solid is not a closed manifold"):
        metrics = measured(touching, morphometry=True)
    assert "strut_thickness_mean" not in metrics.values


def test_print_rules_that_are_broken_are_findings_with_places_and_no_failed_gates():
    rules = {"min_wall": 2.5, "build_direction": [1.0, 0.0, 0.0]}
    metrics = measured(solid_of(pierced()), printing=rules)
    assert metrics.failed_gates == ()
    found = {finding.rule: finding for finding in metrics.findings}
    assert set(found) == {"thin_wall", "overhang"}
    assert all(len(finding.places) for finding in found.values())
    assert metrics.values["overhang_area_mm2"] == pytest.approx(3.0 * 6.0)


def test_no_channel_is_closed_by_the_slivers_that_a_clip_leaves():
    mesh = stages.make_mesh(shape="block", cell="tetrahedron", counts=2, edge=4.0)
    outer = stages.extract_outer(mesh)
    field = stages.arbf_field(mesh, outer, voxel_size=0.2)
    porous = stages.isosurface(field, outer, porosity=0.65)
    solid = stages.intersect_outer(porous, outer)
    measured = stages.measure(solid, outer, porous, field, mesh, morphometry=False, diffusion=False)
    assert measured.values["channels_interrupted"] == 0
    assert measured.failed_gates == ()
