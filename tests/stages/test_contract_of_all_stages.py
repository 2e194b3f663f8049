from __future__ import annotations

import pytest

from scaffold_pipeline.stages.registry import load_stage, stage_names
from scaffold_pipeline.testing import check_stage


@pytest.mark.parametrize("name", stage_names())
def test_the_stage_keeps_the_contract(name: str):
    check_stage(name)


def test_what_ftetwild_gives_is_known_not_to_be_repeated():
    unrepeatable = {name for name in stage_names() if not load_stage(name).is_repeatable}
    assert unrepeatable == {name for name in stage_names() if "pytetwild" in load_stage(name).libraries} != set()
