"""The contract of a stage: a typed function, the slots that it reads and writes, and its parameters.

    class JitterParams(Params):
        amount: Annotated[float, Unit("mean edge lengths")] = Field(default=0.2, ge=0.0, lt=0.5)

    @stage(writes="mesh", version=1)
    def jitter(mesh: VolumeMesh, *, params: JitterParams, rng: np.random.Generator) -> VolumeMesh: ...

The names of the positional arguments are the slots read, and their annotations are the types; `X | None = None` reads a
slot that may be absent. The engine passes the keyword arguments: `params`; `rng` if the stage is random; `out`, a
folder, if it writes files; `config_hash` if its files name their configuration; `executor`, an `Executor` or None, if
other processes can compute parts of it; the result must be the same to the bit with and without it.
"""

from __future__ import annotations

import inspect
import os
import typing
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from scaffold_pipeline.artifacts import Artifact, Drawing, Gate, Metric
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.stages.libraries import imported_libraries

_DECLARATION = "__scaffold_stage__"
_ENGINE_ARGUMENTS = frozenset({"params", "rng", "out", "config_hash", "executor"})

StageFunction = TypeVar("StageFunction", bound=Callable[..., Artifact])


@dataclass(frozen=True)
class Unit:
    """The unit of a parameter, for help texts: `Annotated[float, Unit("mm")]`."""

    name: str


@dataclass(frozen=True)
class Follows:
    """A parameter that by default has the value of another stage's parameter: `Follows("intersect_outer", "skin")`."""

    stage: str
    parameter: str


Millimetres = Annotated[float, Unit("mm")]
Share = Annotated[float, Unit("share of 1")]


def _require_each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        raise ValueError(f"must name each format once, got {', '.join(names)}")
    return names


EachOnce = AfterValidator(_require_each_once)
"""For a list of formats: `Annotated[tuple[Format, ...], EachOnce]` refuses duplicates."""


def _require_printable(title: str) -> str:
    if not title.isprintable():
        raise ValueError(f"must have printable characters only, got {title!r}")
    return title


Title = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_require_printable)]
"""The title inside a file: one line of text."""


def _resolve_input_file(path: Path, info: ValidationInfo) -> Path:
    """Resolve `path` against the folder of its configuration and require that the file exists."""
    base = (info.context or {}).get("base")
    try:
        resolved = Path(base or Path(), path.expanduser()).resolve()
        is_directory, is_file, is_there = resolved.is_dir(), resolved.is_file(), resolved.exists()
    except (OSError, RuntimeError) as error:  # a name too long for the system, or an unknown `~user`
        raise ValueError(f"cannot be a file's path: {error}") from error
    if is_directory:
        raise ValueError(f"must be a file, but {resolved} is a directory")
    if is_there and not is_file:
        raise ValueError(f"must be a file, but {resolved} is a pipe or a device; write what it gives to a file first")
    if not is_file:
        remedy = "; paths in a config are relative to the config" if base else ""
        raise ValueError(f"no such file: {resolved}{remedy}")
    if not os.access(resolved, os.R_OK):
        raise ValueError(f"cannot be read: {resolved}; change its permissions")
    return resolved


@dataclass(frozen=True)
class InputFileMark:
    """Marks a parameter as an input file: its content, not its name, determines whether a stage is run again."""


InputFile = Annotated[Path, AfterValidator(_resolve_input_file), InputFileMark()]


class Params(BaseModel):
    """Base of every stage's parameters: frozen, without unknown keys or infinite values; docstrings describe fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)

    @classmethod
    def marked(cls, kind: type) -> dict[str, Any]:
        """Return the marks of `kind` (`Unit`, `Follows`, `InputFileMark`) by the name of their field."""
        return {
            name: mark
            for name, info in cls.model_fields.items()
            for mark in (*info.metadata, *_marks_within(info.annotation))
            if isinstance(mark, kind)
        }


def _marks_within(annotation: object) -> list[object]:
    """Return the marks inside a type: those of `float` in `Annotated[float, Unit("mm")] | None`."""
    inner = [mark for part in typing.get_args(annotation) for mark in _marks_within(part)]
    return [*getattr(annotation, "__metadata__", ()), *inner]


@dataclass(frozen=True)
class Read:
    """A slot that a stage reads: its type, and whether it is optional."""

    type: type[Artifact]
    optional: bool


@dataclass(frozen=True)
class Reports:
    """The declarations of a stage's results, for pages and the README."""

    metrics: tuple[Metric, ...] = ()
    gates: tuple[Gate, ...] = ()
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True)
class Stage:
    """A checked stage, as the plan and the runner use it."""

    name: str
    function: Callable[..., Artifact]
    version: int
    params: type[Params]
    reads: dict[str, Read]
    writes: str
    output: type[Artifact]
    engine_arguments: frozenset[str]
    unseen_libraries: tuple[str, ...]
    is_repeatable: bool
    reports: Reports = Reports()

    @property
    def requires(self) -> set[str]:
        """The slots that it requires."""
        return {argument for argument, read in self.reads.items() if not read.optional}

    @property
    def summary(self) -> str:
        """The first line of the stage's docstring."""
        return (inspect.getdoc(self.function) or "").partition("\n")[0]

    @cached_property
    def libraries(self) -> dict[str, str]:
        """The version of each distribution that can affect the result of the stage, always including numpy.

        They are found from the imports of its sources, at the first use by a run; a listing does not need them. Raises
        `StageDefinitionError` if a source has a syntax error.
        """
        module = self.function.__module__
        try:
            imported = imported_libraries(module)
        except SyntaxError as error:
            raise StageDefinitionError(f"stage {self.name!r}: {error.filename}:{error.lineno}: {error.msg}") from error
        return {name: _version(self.name, name) for name in sorted({*imported, *self.unseen_libraries, "numpy"})}


@dataclass(frozen=True)
class _Declaration:
    writes: str
    version: int
    libraries: tuple[str, ...]
    is_repeatable: bool
    reports: Reports


def stage(  # noqa: PLR0913 - all by name, independent of each other
    *,
    writes: str,
    version: int,
    libraries: Collection[str] = (),
    repeatable: bool = True,
    metrics: Collection[Metric] = (),
    gates: Collection[Gate] = (),
    drawings: Collection[Drawing] = (),
) -> Callable[[StageFunction], StageFunction]:
    """Declare a function as a stage that writes slot `writes`; it can still be called as a function.

    Raise `version` whenever the function may return a different result for the same input: results of other versions
    are not used again, nor are those of other versions of the libraries that its sources import (`Stage.libraries`).
    `libraries` names further installed distributions that no import statement shows, such as one loaded by a computed
    name. A stage that is not deterministic is declared with `repeatable=False`: only its stored result is the same.
    `metrics` are those that it measures or passes on as facts, `gates` its quality gates, `drawings` its files that
    pages show; these three do not affect stored results.
    """
    reports = Reports(tuple(metrics), tuple(gates), tuple(drawings))
    declaration = _Declaration(writes, version, (*libraries,), repeatable, reports)

    def declare(function: StageFunction) -> StageFunction:
        setattr(function, _DECLARATION, declaration)
        return function

    return declare


def stage_from_function(name: str, function: object) -> Stage:
    """Return the stage of a declared function; raises `StageDefinitionError` if it breaks the contract."""
    declaration = getattr(function, _DECLARATION, None)
    if declaration is None or not callable(function):
        raise StageDefinitionError(f"stage {name!r}: {function!r} is not a function decorated with @stage(...)")
    hints = _hints(name, function)
    arguments = inspect.signature(function).parameters
    params = hints.get("params")
    if not (isinstance(params, type) and issubclass(params, Params)):
        raise StageDefinitionError(f"stage {name!r}: needs a keyword argument `params` annotated with a Params class")
    if not (isinstance(hints.get("return"), type) and issubclass(hints["return"], Artifact)):
        raise StageDefinitionError(f"stage {name!r}: its return annotation must be an artifact type")
    _require_single_files(name, params)
    for library in declaration.libraries:
        _version(name, library)
    _require_switches(name, params, declaration.reports.gates)
    return Stage(
        name=name,
        function=function,
        version=declaration.version,
        params=params,
        reads={argument: _read(name, argument, hints) for argument in arguments if argument not in _ENGINE_ARGUMENTS},
        writes=declaration.writes,
        output=hints["return"],
        engine_arguments=_ENGINE_ARGUMENTS & set(arguments),
        unseen_libraries=declaration.libraries,
        is_repeatable=declaration.is_repeatable,
        reports=declaration.reports,
    )


def _version(name: str, library: str) -> str:
    try:
        return version_of(library)
    except PackageNotFoundError as error:
        raise StageDefinitionError(
            f"stage {name!r}: its declared library {library!r} is not installed; name a distribution"
        ) from error


def _hints(name: str, function: Callable[..., Any]) -> dict[str, Any]:
    try:
        return typing.get_type_hints(function)
    except Exception as error:  # an annotation is any expression and can fail in any way
        raise StageDefinitionError(
            f"stage {name!r}: an annotation cannot be resolved ({error}); import its type outside TYPE_CHECKING"
        ) from error


def _require_single_files(name: str, params: type[Params]) -> None:
    """Require that each `InputFile` is a parameter by itself or in a union with None, as the runner expects."""
    for parameter in params.marked(InputFileMark):
        annotation = params.model_fields[parameter].annotation
        members = typing.get_args(annotation) if _is_union(annotation) else (annotation,)
        if not set(members) <= {InputFile, Path, NoneType}:
            raise StageDefinitionError(f"stage {name!r}: parameter {parameter!r} must be one InputFile, not several")


def _require_switches(name: str, params: type[Params], gates: Collection[Gate]) -> None:
    for gate in gates:
        if gate.switch not in params.model_fields:
            raise StageDefinitionError(
                f"stage {name!r}: gate {gate.name!r} is switched by {gate.switch!r}, which is not one of its parameters"
            )


def _read(name: str, argument: str, hints: dict[str, Any]) -> Read:
    hint = hints.get(argument)
    members = [member for member in typing.get_args(hint) if member is not NoneType] if _is_union(hint) else [hint]
    if len(members) != 1 or not (isinstance(members[0], type) and issubclass(members[0], Artifact)):
        raise StageDefinitionError(
            f"stage {name!r}: argument {argument!r} must be annotated with an artifact type, got {hint!r}"
        )
    return Read(type=members[0], optional=_is_union(hint))


def _is_union(annotation: object) -> bool:
    return typing.get_origin(annotation) in {typing.Union, UnionType}
