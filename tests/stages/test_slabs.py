"""The field in slabs, that others compute, and at once."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest

from geometry.fields.shepard_oracle import graded
from scaffold_geometry.fields import slabs
from scaffold_pipeline.errors import StageError
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from stages.test_arbf_field import boundary, volume


class Elsewhere(Executor):
    """Works at once on copies, as another process would."""

    def __init__(self) -> None:
        self.calls = 0

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> Future[Any]:  # noqa: ANN401
        self.calls += 1
        future: Future[Any] = Future()
        function, arguments = pickle.loads(pickle.dumps((function, arguments)))  # noqa: S301 - made a moment ago
        future.set_result(function(*arguments))
        return future


@pytest.mark.parametrize(("most", "calls"), [(1, 7), (100_000, 4), (10**9, 1)])
def test_slabs_give_the_field_to_the_bit(monkeypatch: pytest.MonkeyPatch, most: int, calls: int):
    mesh, params = graded(), ArbfFieldParams(voxel_size=0.35)
    whole = arbf_field(volume(mesh), boundary(mesh), params=params)
    monkeypatch.setattr(slabs, "VOXELS_AT_ONCE", most)
    others = Elsewhere()
    parts = arbf_field(volume(mesh), boundary(mesh), params=params, executor=others)
    assert others.calls == calls
    assert np.array_equal(parts.values, whole.values)
    assert (parts.values[:, :, 0] == -1.0).all()
    assert np.unique(whole.values).size > 10_000


def test_samples_that_a_slab_finds_half_reached_are_told(monkeypatch: pytest.MonkeyPatch):
    mesh, params = graded(), ArbfFieldParams(voxel_size=0.35, support=0.1)
    monkeypatch.setattr(slabs, "VOXELS_AT_ONCE", 1)
    told = []
    for executor in (None, Elsewhere()):
        with pytest.raises(StageError, match=r"support: \d+ of \d+ samples") as caught:
            arbf_field(volume(mesh), boundary(mesh), params=params, executor=executor)
        told.append(str(caught.value))
    assert told[0] == told[1]
