"""Commands on many runs: `study`, and `cache` for the results that they share."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.validators import Number

from scaffold_pipeline.cli.options import (
    FAILED,
    GATE_FAILED,
    CacheFolder,
    DryRun,
    Json,
    Quiet,
    Settings,
    answer,
    select_cache,
)
from scaffold_pipeline.errors import ConfigError, Fault

if TYPE_CHECKING:
    from scaffold_pipeline.runs.cache import Cache
    from scaffold_pipeline.studies.study import PointPlan
    from scaffold_pipeline.studies.table import PointState

CacheName = Annotated[Path | None, Parameter(help="The cache's folder; SCAFFOLD_PIPELINE_CACHE by default.")]

cache = App(name="cache", help="Show and prune the results that runs share.", default_parameter=Parameter(negative=()))


def study(  # noqa: PLR0913 - one argument an option
    study_file: Annotated[Path, Parameter(name="STUDY")],
    /,
    *,
    out: Path | None = None,
    settings: Settings = [],  # noqa: B006 - never modified
    workers: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    scheduler: str | None = None,
    keep_going: bool = False,
    dry_run: DryRun = False,
    yes: bool = False,
    cache_folder: CacheFolder = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Run every point of a study; finished points are not run again.

    Parameters
    ----------
    study_file
        The study, a YAML file.
    out
        The study's folder; studies/NAME by default.
    workers
        Points to run at the same time, sharing the cores; by default one per core, as far as memory allows.
    scheduler
        Address of a Dask scheduler; its workers run the points, by default one each, and need the study's folder.
    keep_going
        Continue with the other points after one has failed.
    dry_run
        Print the points, which results are stored and which are not, without running anything.
    yes
        Do not ask for confirmation above 2,000 points.
    """
    from scaffold_pipeline.cli.console import watch_study
    from scaffold_pipeline.studies.cluster import cluster_pool
    from scaffold_pipeline.studies.file import read_study
    from scaffold_pipeline.studies.study import plan_points, run_study
    from scaffold_pipeline.studies.workers import local_pool

    points = read_study(study_file, settings, may_be_large=yes)
    folder, shared = out or Path("studies", points.name), select_cache(cache_folder)
    if dry_run:
        return _print_plan(plan_points(points, folder, shared), as_json=as_json)
    pool_factory = partial(cluster_pool, scheduler, count=workers) if scheduler else partial(local_pool, count=workers)
    with watch_study(quiet=quiet or as_json) as watcher:
        states = run_study(
            points, folder, cache=shared, pool_factory=pool_factory, keep_going=keep_going, watcher=watcher
        )
    if shared is not None:
        shared.prune()
    return _print_results(folder, states, quiet=quiet, as_json=as_json)


def _print_plan(plans: list[PointPlan], *, as_json: bool) -> int:
    from scaffold_pipeline.studies.study import work_left

    points = [
        {
            "point": plan.point.name,
            "done": plan.is_done,
            "unchanged": [label for label in plan.recipes if label in plan.unchanged],
            "to_run": [label for label in plan.recipes if label not in plan.unchanged],
        }
        for plan in plans
    ]
    lines = [f"{point['point']}: {_plan_text(point)}" for point in points]
    left, done = work_left(plans), sum(plan.is_done for plan in plans)
    lines.append(f"{len(points)} points, {done} done; {left} results to compute, shared ones once")
    return answer({"points": points, "results_to_compute": left}, "\n".join(lines), as_json=as_json)


def _plan_text(point: dict[str, object]) -> str:
    if point["done"]:
        return "done"
    to_run = point["to_run"]
    return f"to run: {', '.join(to_run)}" if isinstance(to_run, list) and to_run else "computed, files to be written"


def _print_results(folder: Path, states: list[PointState], *, quiet: bool, as_json: bool) -> int:
    failed = [state for state in states if state.status == "failed"]
    gated = [state for state in states if state.gates]
    done = sum(state.status == "done" for state in states)
    saved = sum(state.seconds[1] for state in states)
    text = f"{folder}: {done} of {len(states)} points done, {saved:.0f} s saved by sharing; see {folder / 'study.html'}"
    points = [{"point": state.name, "status": state.status, "error": state.error} for state in states]
    answer({"out": str(folder), "points": points}, "" if quiet else text, as_json=as_json)
    for state in failed:
        print(f"{state.name}: {state.error}", file=sys.stderr)
    for state in gated:
        print(f"{state.name}: quality gate failed: {'; '.join(state.gates)}", file=sys.stderr)
    return FAILED if failed else GATE_FAILED if gated else 0


@cache.command(name="size")
def cache_size(folder: CacheName = None, *, as_json: Json = False) -> int:
    """Show the number of results in the cache, and its size."""
    from scaffold_pipeline.report.wording import to_size

    used = _cache_named(folder)
    count, size = len(used.entries()), used.size()
    return answer({"results": count, "bytes": size}, f"{used.root}: {count} results, {to_size(size)}", as_json=as_json)


@cache.command(name="list")
def cache_list(folder: CacheName = None, *, as_json: Json = False) -> int:
    """List the results in the cache, the most recently used first."""
    from datetime import UTC, datetime

    from scaffold_pipeline.report.wording import to_duration, to_size

    payload, lines = [], []
    for entry in _cache_named(folder).entries():
        count, used = sum(entry.files.values()), datetime.fromtimestamp(entry.used, UTC).isoformat(timespec="seconds")
        facts = {"key": entry.key, "stage": entry.stage, "version": entry.version, "seconds": entry.seconds}
        payload.append({**facts, "bytes": count, "used": used})
        made = f"{to_size(count)}, made in {to_duration(entry.seconds)}, used {used}"
        lines.append(f"{entry.key[:12]}  {entry.stage} (version {entry.version}): {made}")
    return answer(payload, "\n".join(lines), as_json=as_json)


@cache.command(name="prune")
def cache_prune(folder: CacheName = None, *, keep: str | None = None, as_json: Json = False) -> int:
    """Delete the least recently used results.

    Parameters
    ----------
    keep
        Size to keep, such as 5 GB; by default SCAFFOLD_PIPELINE_CACHE_LIMIT or 20 GB. 0 B deletes everything.
    """
    from scaffold_pipeline.report.wording import to_size
    from scaffold_pipeline.runs.cache import parse_size

    used = _cache_named(folder)
    freed = used.prune(None if keep is None else parse_size(keep, "--keep"))
    return answer({"freed_bytes": freed}, f"{used.root}: {to_size(freed)} freed", as_json=as_json)


def _cache_named(folder: Path | None) -> Cache:
    used = select_cache(folder)
    if used is None:
        message = "no cache is named; give its folder, or set SCAFFOLD_PIPELINE_CACHE; a study has STUDY_FOLDER/cache"
        raise ConfigError([Fault(0, 0, message, "cache")])
    if not used.root.is_dir():
        raise ConfigError([Fault(0, 0, "no such folder", str(used.root))])
    return used
