"""The contract of stages, the installed stages, and each of them as a function.

`scaffold_pipeline.stages.NAME` is the installed stage `NAME`, also of a plug-in: slots are arguments and parameters are
keywords; a random stage also takes `seed`, a stage that writes files `out`.

Examples
--------
>>> from scaffold_pipeline import stages
>>> mesh = stages.make_mesh(shape="block", counts=2, edge=3.0)
>>> outer = stages.extract_outer(mesh)
>>> round(outer.volume)
216
>>> stages.jitter(mesh, amount=0.7)
Traceback (most recent call last):
scaffold_pipeline.errors.ConfigError: jitter: amount: must be less than 0.5, got 0.7
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def __getattr__(name: str) -> Callable[..., Any]:
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from scaffold_pipeline.stages.functions import stage_function

    try:
        return stage_function(name)
    except LookupError as error:
        raise AttributeError(str(error.args[0])) from None


def __dir__() -> list[str]:
    from scaffold_pipeline.stages.registry import stage_names

    return stage_names()
