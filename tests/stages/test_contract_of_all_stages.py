from __future__ import annotations

import pytest

from scaffold_pipeline.registry import stage_names
from scaffold_pipeline.testing import check_stage


@pytest.mark.parametrize("name", stage_names())
def test_the_stage_keeps_the_contract(name: str):
    check_stage(name)
