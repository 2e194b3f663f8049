"""Every metric that a stage tells in these tests is one that a stage declares."""

from __future__ import annotations

import sys
from functools import cache

import pytest

from scaffold_pipeline.artifacts import Declared, Metrics
from scaffold_pipeline.report.declared import declared_here

declared = cache(declared_here)


def undeclared_keys(metrics: Metrics, known: Declared) -> list[str]:
    return [key for key in metrics.values if known.metric(key) is None]


@pytest.fixture(autouse=True)
def _metrics_are_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    checked = Metrics.__post_init__

    def check(self: Metrics) -> None:
        checked(self)
        makers = {sys._getframe(depth).f_globals.get("__name__", "") for depth in (2, 3, 4)}
        if any(maker.startswith("scaffold_stages.") for maker in makers):
            missing = undeclared_keys(self, declared())
            assert not missing, f"declare {missing} beside what computes them: @stage(..., metrics=...)"

    monkeypatch.setattr(Metrics, "__post_init__", check)
