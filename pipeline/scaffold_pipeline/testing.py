"""The contract of a stage as a test: call `check_stage` in the tests of each stage.

def test_the_stage_keeps_the_contract():
    check_stage("my_stage", inputs={"outer": a_small_shape}, params={"amount": 0.2})
"""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import typing
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.runs.trial import run_faults
from scaffold_pipeline.stages.contract import Params, Stage, Unit
from scaffold_pipeline.stages.registry import load_stage

SLOW_TO_IMPORT = (
    *("igl", "lib3mf", "manifold3d", "matplotlib", "numba", "pymeshlab", "pytetwild", "pyvista"),
    *("scipy", "skimage", "torch", "trimesh", "vtk", "vtkmodules"),
)
"""Slow imports, allowed only inside a stage's function, so that listing stages and checking a config stay fast."""

_CONFIG_WORDS = frozenset({"use", "as", "from"})
_BY_KEYWORD = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def check_stage(
    name: str,
    inputs: Mapping[str, Artifact] | None = None,
    params: Mapping[str, Any] | Params | None = None,
    seed: int = 0,
) -> None:
    """Require that the installed stage `name` keeps the contract of `scaffold_pipeline.stages.contract`.

    Its declaration is always checked. With inputs or parameters the stage is also run twice, the second time with an
    executor if it takes one. Then both results must be equal to the bit, unless the stage is declared not repeatable;
    the result must be equal after a round trip through the store; inputs, the working directory and numpy's global
    random state must not change; files may be written only to `out`; and only `scaffold_pipeline.errors.warn` may warn.

    Parameters
    ----------
    name
        The stage's name in configs: its entry point.
    inputs
        A small artifact for each slot that it reads, by the name of the argument; `{}` for a stage without inputs.
    params
        Its parameters as in a config, files relative to the working directory, or an instance of its `Params` class.
    seed
        Seed of its random numbers, if it is random.

    Raises
    ------
    LookupError
        No such stage is installed.
    StageDefinitionError
        The stage breaks rules; one line for each. Errors of the stage itself are passed on.

    Notes
    -----
    An audit hook, added to the process at the first run, sees the files that are opened; it stays, inactive, as
    Python cannot remove it. Caches are ignored: `__pycache__`, `.cache` and the folders in `NUMBA_CACHE_DIR`,
    `MPLCONFIGDIR` and `XDG_CACHE_HOME`. Files written by compiled code are seen only in the working directory and
    among the temporary files.

    Examples
    --------
    >>> check_stage("make_mesh", params={"shape": "tetrahedron"})
    """
    stage = load_stage(name)
    faults = [*_function_faults(stage), *_parameter_faults(stage), *_import_faults(stage)]
    if not faults and (inputs is not None or params is not None):
        faults = run_faults(stage, inputs or {}, {} if params is None else params, seed)
    if faults:
        raise StageDefinitionError("\n".join(f"stage {name!r}: {fault}" for fault in faults))


def _function_faults(stage: Stage) -> Iterator[str]:
    if not (stage.summary[:1].isupper() and stage.summary.endswith(".")):
        yield f"the first line of its docstring must be a sentence, got {stage.summary!r}"
    if not stage.writes.isidentifier() or not stage.writes.islower():
        yield f"writes: a slot's name must have lower-case letters, digits and underscores only, got {stage.writes!r}"
    if stage.version < 1:
        yield f"version: must be 1 or more, got {stage.version}"
    for argument in inspect.signature(stage.function).parameters.values():
        if argument.kind not in _BY_KEYWORD:
            yield f"argument {argument.name!r} must be usable as a keyword"


def _parameter_faults(stage: Stage) -> Iterator[str]:
    params = stage.params
    if not params.model_config.get("frozen") or params.model_config.get("extra") != "forbid":
        yield f"{params.__name__} must be frozen and forbid unknown parameters"
    units = params.marked(Unit)
    for name, info in params.model_fields.items():
        if name in _CONFIG_WORDS:
            yield f"parameter {name!r} has the name of a key of the config; rename it"
        if not info.description:
            yield f"parameter {name!r} needs a docstring"
        if name not in units and _has_float(info.annotation):
            yield f"parameter {name!r} needs a Unit, as in Annotated[float, Unit('mm')]"
    yield from _default_faults(stage)
    try:
        json.dumps(params.model_json_schema())
    except Exception as error:  # noqa: BLE001 - whatever a plug-in's own types raise
        yield f"{params.__name__} has no JSON schema: {error}"


def _has_float(annotation: object) -> bool:
    return annotation is float or any(_has_float(part) for part in typing.get_args(annotation))


def _default_faults(stage: Stage) -> Iterator[str]:
    """Yield the defaults that break the parameters' own rules; required parameters have none."""
    infos = stage.params.model_fields.items()
    defaults: dict[str, Any] = {
        name: info.get_default(call_default_factory=True, validated_data={})
        for name, info in infos
        if not info.is_required()
    }
    try:
        stage.params.model_validate(defaults)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            place = detail["loc"][0] if detail["loc"] else None
            if place in defaults:
                yield f"parameter {place!r}: its default {defaults[str(place)]!r} is refused: {detail['msg']}"


def _import_faults(stage: Stage) -> Iterator[str]:
    """Yield the faults of importing the stage's module alone, in a new interpreter."""
    module = stage.function.__module__
    code = "import importlib, sys; importlib.import_module(sys.argv[1]); print(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", code, module], capture_output=True, text=True, check=False)
    if result.returncode:
        yield f"{module} cannot be imported alone: {result.stderr.strip().splitlines()[-1]}"
        return
    slow = sorted({name.partition(".")[0] for name in result.stdout.split()} & set(SLOW_TO_IMPORT))
    if slow:
        yield f"importing {module} imports {', '.join(slow)}; import them inside the stage's function"
