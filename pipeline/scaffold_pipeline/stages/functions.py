"""Installed stages as functions: slots are arguments, parameters are keywords, every fault is one line."""

from __future__ import annotations

import inspect
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from pydantic import ValidationError

from scaffold_pipeline.artifacts import Artifact
from scaffold_pipeline.errors import (
    ConfigError,
    Fault,
    MemoryShortageError,
    PipelineError,
    PipelineWarning,
    StageDefinitionError,
    StageError,
    did_you_mean,
    no_folder,
    warn,
)
from scaffold_pipeline.processes.threads import computing
from scaffold_pipeline.stages.catalogue import describe_parameters
from scaffold_pipeline.stages.contract import Params, Stage, Unit
from scaffold_pipeline.stages.faults import format_value, parameter_fault, to_plain, with_article, without_consequences
from scaffold_pipeline.stages.registry import load_stage
from scaffold_pipeline.stages.seeds import derive_seed, seed_fault

_PACKAGE = __name__.rpartition(".")[0]

_SEED = inspect.Parameter("seed", inspect.Parameter.KEYWORD_ONLY, default=0, annotation=int)
_OUT = inspect.Parameter("out", inspect.Parameter.KEYWORD_ONLY, annotation=str | Path)
_EXECUTOR = inspect.Parameter("executor", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Executor | None)

_ENGINE = {"rng": _SEED, "out": _OUT, "executor": _EXECUTOR}
"""Arguments of the caller that replace those of the engine."""

_MEANINGS = {
    "seed": "Seed of all random numbers: a config with this seed gives the same result.",
    "out": "Folder for the written files; created if missing.",
    "executor": "Computes parts of a large field in other processes; the result is the same to the bit.",
}
_ABSENT = {"seed": "the stage is not random", "out": "the stage writes no files", "executor": "the stage has no parts"}

_FUNCTIONS: dict[str, tuple[Stage, Callable[..., Any]]] = {}


def stage_function(name: str) -> Callable[..., Any]:
    """Return the installed stage `name` as a function of its slots and parameters, the same at every call.

    Raises `LookupError` with the most similar name if there is none, and `StageDefinitionError` if the stage breaks the
    contract or has a slot and a parameter of the same name.
    """
    stage = load_stage(name)
    if _FUNCTIONS.get(name, (None,))[0] is not stage:
        _FUNCTIONS[name] = (stage, _make_function(stage))
    return _FUNCTIONS[name][1]


def _make_function(stage: Stage) -> Callable[..., Any]:
    signature = _signature(stage)

    def function(*arguments: object, **keywords: object) -> Artifact:
        return _call(stage, arguments, keywords)

    function.__name__ = function.__qualname__ = stage.name
    function.__module__ = _PACKAGE
    function.__doc__ = _document(stage)
    function.__annotations__ = {entry.name: entry.annotation for entry in signature.parameters.values()}
    function.__annotations__["return"] = stage.output
    function.__signature__ = signature  # type: ignore[attr-defined]
    return function


def _signature(stage: Stage) -> inspect.Signature:
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    slots = [
        inspect.Parameter(name, kind, default=None, annotation=read.type | None)
        if read.optional
        else inspect.Parameter(name, kind, annotation=read.type)
        for name, read in stage.reads.items()
    ]
    types, units = typing.get_type_hints(stage.params), stage.params.marked(Unit)
    parameters = [
        entry.replace(
            annotation=Annotated[types[name], units[name].name] if name in units else types.get(name, entry.annotation)
        )
        for name, entry in inspect.signature(stage.params).parameters.items()
    ]
    taken = [*stage.reads, *(entry.name for entry in parameters), *(entry.name for entry in _engine(stage))]
    twice = sorted({name for name in taken if taken.count(name) > 1})
    if twice:
        raise StageDefinitionError(f"stage {stage.name!r}: {', '.join(twice)} would be two arguments; rename one")
    return inspect.Signature([*slots, *parameters, *_engine(stage)], return_annotation=stage.output)


def _engine(stage: Stage) -> list[inspect.Parameter]:
    return [_ENGINE[name] for name in _ENGINE if name in stage.engine_arguments]


def _document(stage: Stage) -> str:
    """Return the stage's docstring with numpydoc sections for its parameters, result and errors."""
    slots = [
        (name, read.type.__name__ + (", optional" if read.optional else ""), _first_line(read.type))
        for name, read in stage.reads.items()
    ]
    parameters = [
        (name, f"{text['type']}, {text['default'].replace(', or as ', '; in a config, as ')}", text["meaning"])
        for name, text in describe_parameters(stage).items()
    ]
    engine = [
        (entry.name, "path" if entry is _OUT else f"default {entry.default}", _MEANINGS[entry.name])
        for entry in _engine(stage)
    ]
    raises = [
        ("ConfigError", "", "An argument is missing, has another type, or breaks its rule; one line for each fault."),
        ("StageError", "", "There is no valid result for these values."),
    ]
    given = [(stage.output.__name__, "", _first_line(stage.output))]
    sections = {"Parameters": [*slots, *parameters, *engine], "Returns": given, "Raises": raises}
    text = [inspect.getdoc(stage.function) or ""]
    for title, entries in sections.items():
        if entries:
            text.append("\n".join([title, "-" * len(title), *_entries(entries)]))
    return "\n\n".join(text)


def _entries(entries: list[tuple[str, str, str]]) -> Iterator[str]:
    for name, kind, meaning in entries:
        yield f"{name} : {kind}" if kind else name
        yield f"    {meaning}"


def _first_line(kind: type) -> str:
    return (inspect.getdoc(kind) or "").partition("\n")[0]


def _call(stage: Stage, arguments: tuple[object, ...], keywords: Mapping[str, object]) -> Artifact:
    given, slots = dict(keywords), list(stage.reads)
    faults = []
    if len(arguments) > len(slots):
        takes = f"takes {len(slots)} by position ({', '.join(slots) or 'none'}), got {len(arguments)}"
        faults.append(f"{takes}; give parameters by name")
    for name, value in zip(slots, arguments, strict=False):
        if name in given:
            faults.append(f"{name}: is given both by position and by name")
        given[name] = value
    read = {name: given.pop(name, None) for name in slots}
    faults += [fault for name, value in read.items() if (fault := _slot_fault(stage, name, value))]
    engine = {entry.name: given.pop(entry.name, entry.default) for entry in _engine(stage)}
    faults += _engine_faults(engine)
    params, more = _params(stage, given)
    faults += more
    if faults or params is None:
        raise ConfigError(Fault(0, 0, f"{stage.name}: {fault}") for fault in faults)
    return _compute(stage, {**read, "params": params}, engine)


def _slot_fault(stage: Stage, name: str, value: object) -> str | None:
    """Return the fault of the value given for a slot, or None."""
    read = stage.reads[name]
    if isinstance(value, read.type) or (value is None and read.optional):
        return None
    if value is None:
        return f"{name}: is required, as {with_article(read.type)}"
    library = type(value).__module__.partition(".")[0]
    convert = f"from_{library}"
    remedy = f"; make one by {read.type.__name__}.{convert}(...)" if hasattr(read.type, convert) else ""
    return f"{name}: must be {with_article(read.type)}, got {with_article(type(value))}{remedy}"


def _engine_faults(engine: Mapping[str, object]) -> Iterator[str]:
    for name, value in engine.items():
        fault = seed_fault(to_plain(value)) if name == "seed" else None
        if name == "out" and value is inspect.Parameter.empty:
            fault = "out: is required, the folder to write to"
        elif name == "out" and not isinstance(value, str | Path):
            fault = f"out: must be the path of a folder, got {format_value(value)}"
        elif name == "executor" and not isinstance(value, Executor | None):
            fault = f"executor: must be a concurrent.futures.Executor, got {format_value(value)}"
        if fault:
            yield fault


def _params(stage: Stage, given: Mapping[str, object]) -> tuple[Params | None, list[str]]:
    """Return the parameters of a call, or their faults."""
    try:
        return stage.params.model_validate({name: to_plain(value) for name, value in given.items()}), []
    except ValidationError as error:
        return None, [
            _parameter_line(detail, stage) for detail in without_consequences(error.errors(include_url=False))
        ]


def _parameter_line(detail: Any, stage: Stage) -> str:  # noqa: ANN401 - pydantic's own mapping
    name = str(detail["loc"][0]) if detail["loc"] else ""
    if detail["type"] == "extra_forbidden":
        known = [*stage.reads, *stage.params.model_fields, *(entry.name for entry in _engine(stage))]
        return f"unknown parameter {name!r}" + (f"; {_ABSENT[name]}" if name in _ABSENT else did_you_mean(name, known))
    return parameter_fault(detail, stage)


def _compute(stage: Stage, arguments: dict[str, object], engine: Mapping[str, Any]) -> Artifact:
    if "rng" in stage.engine_arguments:
        arguments["rng"] = np.random.default_rng(derive_seed(int(engine["seed"]), stage.name))
    if "executor" in stage.engine_arguments:
        arguments["executor"] = engine["executor"]
    if "config_hash" in stage.engine_arguments:
        arguments["config_hash"] = None  # there is no config whose hash the files could have
    if "out" not in stage.engine_arguments:
        return _guarded(stage, arguments)
    out = Path(engine["out"]).expanduser()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StageError(f"{stage.name}: {no_folder(out, error)}") from error
    with TemporaryDirectory(dir=out, prefix=".out-") as folder:
        result = _guarded(stage, {**arguments, "out": Path(folder)})
        for path in Path(folder).iterdir():  # complete, or not there
            path.replace(out / path.name)
    return result


def _guarded(stage: Stage, arguments: Mapping[str, object]) -> Artifact:
    """Call the stage; its errors and warnings start with its name, and warnings of libraries are not shown."""
    with computing(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = stage.function(**arguments)
        except MemoryError as error:
            raise MemoryShortageError(f"{stage.name}: ran out of memory; use larger voxels or cells") from error
        except PipelineError as error:
            kind = type(error) if isinstance(error, StageError | StageDefinitionError) else StageError
            raise kind(f"{stage.name}: {error}") from error
    for message in dict.fromkeys(str(each.message) for each in caught if issubclass(each.category, PipelineWarning)):
        warn(f"{stage.name}: {message}")
    return result
