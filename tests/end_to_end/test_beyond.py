"""Where the published form ends, and that the normalised one does not: what the README's tables say."""

import json
from pathlib import Path

import pytest

from scaffold_pipeline.cli.app import main

BLOCK = Path(__file__).parents[2] / "configs" / "beyond" / "block.yaml"


def metrics_of(out, counts, interpolation):
    settings = {
        "make_mesh.counts": counts,
        "arbf_field.voxel_size": 0.125,
        "arbf_field.interpolation": interpolation,
        "measure_field.iso": 0.0,
        "measure_field.porosity": "null",
    }
    given = [f"--set={name}={value}" for name, value in settings.items()]
    assert main(["run", str(BLOCK), "--out", str(out), "--quiet", *given]) == 0
    return json.loads((out / "metrics.json").read_text())


@pytest.mark.parametrize(("counts", "whole"), [(2, 1.0), (6, 0.0)])
def test_exact_has_whole_struts_on_small_blocks_and_none_where_its_matrix_has_the_wrong_inertia(
    tmp_path, counts, whole
):
    found = metrics_of(tmp_path, counts, "exact")
    assert found["struts_whole_fraction"] == whole
    assert (found["negative_eigenvalues"] == found["expected_negative_eigenvalues"]) == (whole == 1.0)
    assert (found["porosity"] > 0.95) == (whole == 0.0)


def test_normalised_stays_as_it_is_while_the_block_grows(tmp_path):
    small, large = (metrics_of(tmp_path / str(counts), counts, "normalised") for counts in (2, 6))
    for found in (small, large):
        assert (found["channels_open_fraction"], found["struts_whole_fraction"]) == (1.0, 1.0)
        assert (found["solid_pieces"], found["pore_pieces"], found["quality"]) == (1, 1, "not measured")
    assert large["porosity"] == pytest.approx(small["porosity"], abs=0.05)
