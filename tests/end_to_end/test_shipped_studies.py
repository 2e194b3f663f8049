"""Every study that ships: its points are sound, and no two of them would be one."""

from pathlib import Path

import pytest

from scaffold_pipeline.study_file import is_study, read_study

CONFIGS = Path(__file__).parents[2] / "configs"
STUDIES = [path for path in sorted(CONFIGS.glob("*/*.yaml")) if is_study(path)]


def test_there_are_studies_of_the_paper_and_beyond():
    assert {"paper", "hexahedra", "tetrahedra", "porosity_sweep"} <= {path.stem for path in STUDIES}


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_shipped_study_is_sound_and_says_what_it_is_for(path: Path):
    study = read_study(path)
    assert len(study.points) > 3
    assert study.caption


def test_every_config_of_the_paper_says_what_it_shows_and_is_in_the_study():
    points = read_study(CONFIGS / "paper" / "paper.yaml").points
    assert [point.name for point in points if not point.caption] == []
    assert {f"{point.name}.yaml" for point in points} == {path.name for path in CONFIGS.glob("paper/*.yaml")} - {
        "paper.yaml"
    }
