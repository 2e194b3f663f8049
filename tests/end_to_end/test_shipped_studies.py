"""Every study that ships: its points are sound, and it says what it is for."""

from functools import cache
from pathlib import Path

import pytest

from scaffold_pipeline.studies.file import Study, is_study, read_study

CONFIGS = Path(__file__).parents[2] / "configs"
STUDIES = [path for path in sorted(CONFIGS.glob("*/*.yaml")) if is_study(path)]


@cache
def study_at(path: Path) -> Study:
    return read_study(path)


def test_there_are_studies_of_the_paper_and_beyond():
    assert {"paper", "hexahedra", "tetrahedra", "porosity_sweep"} <= {path.stem for path in STUDIES}


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_shipped_study_is_sound_and_says_what_it_is_for(path: Path):
    study = study_at(path)
    assert len(study.points) > 3
    assert study.caption


def test_every_config_of_the_paper_says_what_it_shows_and_is_in_the_study():
    points = study_at(CONFIGS / "paper" / "paper.yaml").points
    assert [point.name for point in points if not point.caption] == []
    assert {point.name for point in points} == {path.stem for path in CONFIGS.glob("paper/*.yaml")} - {"paper"}
