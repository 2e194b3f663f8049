"""The installed stages: entry points of the group `scaffold_pipeline.stages`, loaded when they are used."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from scaffold_pipeline.errors import StageDefinitionError, did_you_mean
from scaffold_pipeline.stages.contract import Stage, stage_from_function

GROUP = "scaffold_pipeline.stages"


def stage_names() -> list[str]:
    """Return the names of all installed stages, sorted; none of them is loaded."""
    return sorted(_installed())


def load_stage(name: str) -> Stage:
    """Return the stage called `name`.

    Raises `LookupError` with the most similar name if there is none, and `StageDefinitionError` if its plug-in cannot
    be imported or breaks the contract.
    """
    installed = _installed()
    if name not in installed:
        raise LookupError(f"no stage is called {name!r}{did_you_mean(name, installed)}")
    return _load_one(name, installed[name])


def installed_stages() -> Iterator[Stage | StageDefinitionError]:
    """Yield every installed stage in the order of names, or the error of one that cannot be loaded."""
    for name, points in sorted(_installed().items()):  # looked up once: it takes 20 ms
        try:
            yield _load_one(name, points)
        except StageDefinitionError as error:
            yield error


def _load_one(name: str, points: list[EntryPoint]) -> Stage:
    if len({point.value for point in points}) > 1:
        owners = ", ".join(sorted(f"{point.value} ({_owner(point)})" for point in points))
        raise StageDefinitionError(f"stage {name!r} is defined by more than one package: {owners}; uninstall one")
    return _load(points[0])


def stage_owners(names: Collection[str]) -> dict[str, str]:
    """Return the packages that define the stages `names`, with their versions."""
    points = (point for name, points in _installed().items() if name in names for point in points)
    return {point.dist.name: point.dist.version for point in points if point.dist}


def _installed() -> dict[str, list[EntryPoint]]:
    found: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=GROUP):
        found.setdefault(point.name, []).append(point)
    return found


def _owner(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "unknown package"


@cache
def _load(point: EntryPoint) -> Stage:
    try:
        function = point.load()
    except (Exception, SystemExit) as error:  # a plug-in can fail in any way while it is imported
        raise StageDefinitionError(
            f"stage {point.name!r}: {_owner(point)} cannot be loaded from {point.value}: "
            f"{type(error).__name__}: {error}"
        ) from error
    return stage_from_function(point.name, function)
