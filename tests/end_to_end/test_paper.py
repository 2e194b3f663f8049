"""What Liu, Guo and Yu found, checked on the solids that `configs/paper/` makes."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from end_to_end.solid_judge import faults_of
from scaffold_geometry.files.binary_stl import from_stl
from scaffold_pipeline.artifacts import Solid
from scaffold_pipeline.cli.app import main
from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import make_plan

PAPER = Path(__file__).parents[2] / "configs" / "paper"


@cache
def made(name: str, voxel_size: float) -> dict[str, object]:
    """Return what each slot of a config of the paper holds, as far as the clip, by plain calls of its stages."""
    slots: dict[str, object] = {}
    plan = make_plan(read_draft(PAPER / f"{name}.yaml", [f"arbf_field.voxel_size={voxel_size}"]))
    for step in plan.steps[: plan.labels.index("intersect_outer") + 1]:
        given = {argument: slots[slot] for argument, slot in step.sources.items()}
        chance = {"rng": np.random.default_rng(step.seed(plan.seed))} if "rng" in step.stage.engine_arguments else {}
        slots[step.slot] = step.stage.function(**given, **chance, params=step.params)
    return slots


def euler_number(faces: np.ndarray) -> int:
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(faces)) - len(edges) + len(faces)


def porosity(name: str) -> float:
    slots = made(name, 0.04)
    solid = slots["solid"]
    assert isinstance(solid, Solid)
    return 1.0 - solid.volume / slots["outer"].volume


def test_the_single_tetrahedron_opens_from_its_centre_to_its_four_faces(tmp_path: Path):
    settings = ["--set", "write_solid.preview=false", "--set", "arbf_field.voxel_size=0.08"]
    assert main(["run", str(PAPER / "tetrahedron.yaml"), "--out", str(tmp_path), "--quiet", *settings]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["channel_max"] < metrics["iso"] < metrics["strut_min"]
    assert (metrics["channels"], metrics["channels_closed"], metrics["channels_interrupted"]) == (4, 0, 0)
    assert faults_of(tmp_path / "solid.stl", metrics["outer_volume_mm3"], metrics["porosity"]) == []
    _, faces = from_stl((tmp_path / "solid.stl").read_bytes())
    assert euler_number(faces) == 2 - 2 * 3  # four openings that meet: a sphere with three handles


@pytest.mark.parametrize(("name", "openings"), [("hexahedron", 6), ("icosahedron", 20)])
def test_each_outer_face_has_its_opening(name: str, openings: int):
    solid = made(name, 0.08)["solid"]
    inner_faces = {"hexahedron": 0, "icosahedron": 30}[name]
    cells = {"hexahedron": 1, "icosahedron": 20}[name]
    loops = inner_faces - cells + 1  # of the pores, from cell to cell
    assert euler_number(solid.faces) == 2 - 2 * (openings + loops - 1)


def test_pores_grow_with_the_iso():
    low, middle, high = (porosity(name) for name in ("iso_low", "iso_middle", "iso_high"))
    assert 0.05 < low < middle - 0.1 < high - 0.2
    assert middle == porosity("cube")


def test_the_disturbed_meshes_differ_by_seed_alone_and_come_out_the_same_again():
    meshes = [made(f"disturbed_{n}", 0.1)["mesh"].vertices for n in (1, 2, 3)]
    again = made.__wrapped__("disturbed_1", 0.1)["mesh"].vertices
    assert meshes[0].tobytes() == again.tobytes()
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert np.linalg.norm(meshes[one] - meshes[other], axis=1).min() > 1e-3


@pytest.mark.filterwarnings("ignore:exact. no interpolant exists:scaffold_pipeline.errors.PipelineWarning")
@pytest.mark.filterwarnings("ignore:exact. .s. reaches:scaffold_pipeline.errors.PipelineWarning")
def test_the_notes_on_the_basis_functions_are_true():
    gaussian, multiquadric = (made(f"basis_{basis}", 0.1)["field"] for basis in ("gaussian", "multiquadric"))
    assert (gaussian.facts["rank"], gaussian.facts["unknowns"]) == (95, 119)
    assert gaussian.facts["residual"] == pytest.approx(0.6, abs=0.05)
    assert multiquadric.certificate.channel_max == pytest.approx(2.3, abs=0.1)
    assert multiquadric.certificate.channel_max > multiquadric.certificate.strut_min
