from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import Field, ValidationError

from scaffold_pipeline.artifacts import Artifact, Metrics, SurfaceMesh
from scaffold_pipeline.errors import StageDefinitionError
from scaffold_pipeline.stages.contract import (
    Follows,
    InputFile,
    InputFileMark,
    Millimetres,
    Params,
    Unit,
    stage,
    stage_from_function,
)
from scaffold_pipeline.testing import check_stage


class ShapeParams(Params):
    """Parameters of the stages of this file."""

    length: Millimetres | None = None
    """A length."""

    ends: tuple[Millimetres, Millimetres] = (0.0, 1.0)
    """Two lengths."""

    skin: Annotated[Millimetres, Follows("shell", "skin")] = Field(default=0.0, ge=0.0)
    """A thickness."""

    source: InputFile | None = None
    """A file."""

    count: int = 3
    """A number."""


def test_the_contract_is_read_off_the_signature():
    @stage(writes="mesh", version=4)
    def shape(
        outer: SurfaceMesh,
        metrics: Metrics | None = None,  # noqa: ARG001 - only the signature counts
        *,
        params: ShapeParams,  # noqa: ARG001
        rng: np.random.Generator,  # noqa: ARG001
        out: Path,  # noqa: ARG001
    ) -> SurfaceMesh:
        """Shape it.

        At length.
        """
        return outer

    read = stage_from_function("shape", shape)
    assert (read.name, read.writes, read.version, read.summary) == ("shape", "mesh", 4, "Shape it.")
    assert {name: (slot.type, slot.optional) for name, slot in read.reads.items()} == {
        "outer": (SurfaceMesh, False),
        "metrics": (Metrics, True),
    }
    assert read.output is SurfaceMesh
    assert read.engine_arguments == {"params", "rng", "out"}


def test_a_stage_stays_a_plain_function():
    @stage(writes="metrics", version=1)
    def shape(*, params: ShapeParams) -> Metrics:
        return Metrics({"count": params.count})

    assert shape(params=ShapeParams(count=4)).values == {"count": 4}


def test_marks_are_found_inside_optional_and_compound_types():
    assert ShapeParams.marked(Unit) == {name: Unit("mm") for name in ("length", "ends", "skin")}
    assert ShapeParams.marked(Follows) == {"skin": Follows("shell", "skin")}
    assert list(ShapeParams.marked(InputFileMark)) == ["source"]


@pytest.mark.parametrize(
    "wrong", [{"nothing": 1}, {"length": float("nan")}, {"length": float("inf")}, {"skin": -1.0}, {"source": "no.stl"}]
)
def test_parameters_are_checked(wrong: dict[str, Any]):
    with pytest.raises(ValidationError):
        ShapeParams.model_validate(wrong)


def test_parameters_are_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        ShapeParams().count = 4  # type: ignore[misc]


class ManyFiles(Params):
    """A list of input files, where the runner would not see them."""

    paths: list[InputFile]
    """Files."""


def no_params() -> Metrics: ...
def other_params(*, params: dict[str, int]) -> Metrics: ...
def no_return(*, params: ShapeParams): ...
def other_return(*, params: ShapeParams) -> int: ...
def bare_slot(mesh, *, params: ShapeParams) -> Metrics: ...
def other_slot(mesh: int, *, params: ShapeParams) -> Metrics: ...
def two_types(mesh: SurfaceMesh | Metrics, *, params: ShapeParams) -> Metrics: ...
def unknown_name(mesh: NoSuchMesh, *, params: ShapeParams) -> Metrics: ...  # noqa: F821 - what is refused
def unknown_attribute(mesh: np.NoSuchMesh, *, params: ShapeParams) -> Metrics: ...
def many_files(*, params: ManyFiles) -> Metrics: ...


@pytest.mark.parametrize(
    ("function", "rule"),
    [
        (no_params, "needs a keyword argument `params` annotated with a Params class"),
        (other_params, "needs a keyword argument `params` annotated with a Params class"),
        (no_return, "its return annotation must be an artifact type"),
        (other_return, "its return annotation must be an artifact type"),
        (bare_slot, "argument 'mesh' must be annotated with an artifact type"),
        (other_slot, "argument 'mesh' must be annotated with an artifact type"),
        (two_types, "argument 'mesh' must be annotated with an artifact type"),
        (unknown_name, "an annotation cannot be resolved"),
        (unknown_attribute, "an annotation cannot be resolved"),
        (many_files, "parameter 'paths' must be one InputFile, not several"),
    ],
)
def test_a_function_that_is_no_stage_is_refused_by_name(function: Callable[..., Artifact], rule: str):
    with pytest.raises(StageDefinitionError, match="stage 'odd'") as caught:
        stage_from_function("odd", stage(writes="x", version=1)(function))
    assert rule in str(caught.value)


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize("name", ["make_points", "scatter_points", "count_points", "write_points"])
def test_a_sound_stage_of_a_plug_in_passes_the_check(name: str):
    check_stage(name)


@pytest.mark.usefixtures("project")
def test_a_stage_that_is_not_there_or_cannot_be_loaded_fails_the_check():
    with pytest.raises(LookupError, match="no stage is called 'no_stage'"):
        check_stage("no_stage")
    with pytest.raises(StageDefinitionError, match="fake-plugin cannot be loaded from fake_stages:not_there"):
        check_stage("broken_stage")


@pytest.mark.usefixtures("project")
def test_the_check_names_every_rule_that_a_stage_breaks(install: Callable[..., None]):
    install(
        "untidy_package",
        """
        import scipy
        from pydantic import ConfigDict, Field
        from scaffold_pipeline.stages.contract import Params, stage
        from scaffold_pipeline.artifacts import Metrics

        class Untidy(Params):
            model_config = ConfigDict(extra="ignore")

            use: int = 3
            length: float | None = Field(default=None, gt=0.0)
            count: int = Field(default=-1, ge=0)
            "A number."
            choice: object = Field(default_factory=object)
            "Anything."
            needed: int
            "What must be given."

        @stage(writes="My Slot", version=0)
        def untidy(metrics: Metrics, /, *, params: Untidy) -> Metrics:
            "do things"
            return metrics
        """,
        "untidy",
    )
    with pytest.raises(StageDefinitionError) as caught:
        check_stage("untidy")
    faults = [line.removeprefix("stage 'untidy': ") for line in str(caught.value).splitlines()]
    assert faults == [
        "the first line of its docstring must be a sentence, got 'do things'",
        "writes: a slot's name must have lower-case letters, digits and underscores only, got 'My Slot'",
        "version: must be 1 or more, got 0",
        "argument 'metrics' must be usable as a keyword",
        "Untidy must be frozen and forbid unknown parameters",
        "parameter 'use' has the name of a key of the config; rename it",
        "parameter 'use' needs a docstring",
        "parameter 'length' needs a docstring",
        "parameter 'length' needs a Unit, as in Annotated[float, Unit('mm')]",
        "parameter 'count': its default -1 is refused: Input should be greater than or equal to 0",
        "importing untidy_package imports scipy; import them inside the stage's function",
    ]


@pytest.mark.usefixtures("project")
def test_the_check_refuses_parameters_without_a_schema(install: Callable[..., None]):
    install(
        "schemaless_package",
        """
        from collections.abc import Callable
        from scaffold_pipeline.stages.contract import Params, stage
        from scaffold_pipeline.artifacts import Metrics

        class Schemaless(Params):
            call: Callable[[], int]
            "A function."

        @stage(writes="metrics", version=1)
        def schemaless(*, params: Schemaless) -> Metrics:
            "Call."
            return Metrics({})
        """,
        "schemaless",
    )
    with pytest.raises(StageDefinitionError, match="Schemaless has no JSON schema"):
        check_stage("schemaless")


def test_a_pipe_or_a_device_is_named_as_what_it_is(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.stl")
    for path in (tmp_path / "pipe.stl", Path(os.devnull)):
        with pytest.raises(ValidationError, match=rf"must be a file, but {path} is a pipe or a device; write"):
            ShapeParams(source=path)
