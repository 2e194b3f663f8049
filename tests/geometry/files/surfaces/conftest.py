"""Polygons are cut in this process: a child for each of hundreds of small files would take minutes."""

from __future__ import annotations

import pytest

from scaffold_geometry.files.surfaces import reading


@pytest.fixture(autouse=True)
def _cut_polygons_here(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reading, "call_in_child", lambda function, arrays, scalars, **_: function(**arrays, **scalars))
