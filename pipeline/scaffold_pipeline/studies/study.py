"""Run the points of a study, several at once, and write one table; a study can be stopped and continued at any time.

studies/NAME/                 the study's folder
    points/POINT/             the run directory of each point, with its resolved config
    cache/                    results that the points share, unless another cache is named
    table.csv  study.json     the result and the record
    study.html  sheet.png     the same with pictures

These folders are the only state: the same command continues from them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from scaffold_pipeline.artifacts import Fact
from scaffold_pipeline.config.draft import read_draft
from scaffold_pipeline.config.plan import make_plan
from scaffold_pipeline.config.yaml_source import to_yaml
from scaffold_pipeline.errors import MemoryShortageError, PipelineError, lines_and_code
from scaffold_pipeline.report.publish import environment, publish
from scaffold_pipeline.runs.cache import Cache
from scaffold_pipeline.runs.records import config_hash, recipes
from scaffold_pipeline.runs.runner import STORE, execute, locked, unchanged_labels
from scaffold_pipeline.runs.store import Store, first_result, write_atomically
from scaffold_pipeline.studies.file import Point, Study
from scaffold_pipeline.studies.memory_forecast import Grids, expected_peak, grids_of
from scaffold_pipeline.studies.page import write_page
from scaffold_pipeline.studies.schedule import Outcome, Schedule, Task
from scaffold_pipeline.studies.table import FAILURE, PointState, read_state, write_json, write_results
from scaffold_pipeline.studies.workers import WorkerPool, interruptible, local_pool

POINTS = "points"
OWN_CACHE = "cache"

_WRITE_EVERY = 5.0
"""Seconds between two writings of the results while a study runs."""


@dataclass(frozen=True)
class PointPlan:
    """A point before it runs: its resolved config, and for each label the hash of everything its result depends on.

    `unchanged` are the labels whose results are stored.
    """

    point: Point
    folder: Path
    config: str
    config_sha256: str
    recipes: Mapping[str, str]
    unchanged: frozenset[str]
    grids: Grids

    @property
    def state(self) -> PointState:
        """The present state of the point's folder."""
        return read_state(self.point.name, self.point.varied, self.folder, self.config_sha256)

    @property
    def source(self) -> str:
        """The key of the first stage's result, which is the shape or a mesh of it."""
        return next(iter(self.recipes.values()))

    def shape(self, cache: Cache) -> Mapping[str, Fact]:
        """Return the facts of the first stage's result, none if it is not stored."""
        stored = first_result([cache.store, Store(self.folder / STORE)], self.source)
        return stored["summary"] if stored else {}

    def memory(self, cache: Cache) -> int:
        """Return the bytes that the point may need."""
        return expected_peak(self.grids, self.shape(cache))

    @property
    def work(self) -> frozenset[str]:
        """The hashes of all results that are not stored."""
        return frozenset(recipe for label, recipe in self.recipes.items() if label not in self.unchanged)

    @property
    def is_done(self) -> bool:
        """Whether all results and files of the point exist."""
        return not self.work and self.state.status == "done"


@dataclass(frozen=True)
class Watcher:
    """Callbacks of a study: `ended` with each point that has ended, their number and that of all points; `warned`."""

    ended: Callable[[PointState, int, int], None] = lambda _state, _number, _count: None
    warned: Callable[[str], None] = lambda _message: None


def plan_points(study: Study, out: Path, cache: Cache | None = None) -> list[PointPlan]:
    """Return all points, each with its stored results; reads the folders and writes nothing."""
    used = cache or own_cache(out)
    return [_plan_point(point, out, used) for point in study.points]


def own_cache(out: Path) -> Cache:
    """Return the study's own cache, for a study that shares none with others."""
    return Cache(out.resolve() / OWN_CACHE)


def work_left(plans: Iterable[PointPlan]) -> int:
    """Return the number of results that are not stored; one that several points share counts once."""
    return len(frozenset[str]().union(*(plan.work for plan in plans)))


def _plan_point(point: Point, out: Path, cache: Cache) -> PointPlan:
    plan, folder = point.plan(), out.resolve() / POINTS / point.name
    unchanged = frozenset(unchanged_labels(plan, folder, cache=cache))
    return PointPlan(
        point, folder, to_yaml(plan.resolved()), config_hash(plan), recipes(plan), unchanged, grids_of(plan)
    )


def run_study(
    study: Study,
    out: Path,
    *,
    cache: Cache | None = None,
    pool_factory: Callable[[int], WorkerPool] = local_pool,
    keep_going: bool = False,
    watcher: Watcher | None = None,
) -> list[PointState]:
    """Run the points that are not done in the pool that `pool_factory` makes for their number; return all states.

    The table and the record are written while points run, and at the end, also after an error; the page at the end.
    After a failed point the running ones are finished and no other is started, unless `keep_going`.
    """
    with locked(out):
        runner = _StudyRunner(study, out, plan_points(study, out, cache), watcher or Watcher())
        pool = pool_factory(len(runner.left))
        shared = cache or own_cache(out)
        runner.prepare(shared, pool.size)
        do = partial(run_point, out.resolve() / POINTS, shared.root)
        schedule = Schedule(do, runner.ended, pool.size, keep_going, pool.memory)
        try:
            if pool.size > 1:
                runner.load_shapes(shared, pool)
                runner.calibrate(shared, schedule)
            schedule.run(runner.tasks(shared), pool.start)
        finally:
            runner.write()
        states = list(runner.states.values())
        write_page(out, study, states, POINTS)
    return states


def run_point(points: Path, cache: Path, name: str, *, first_only: bool = False) -> Outcome:
    """Run the point `name` in the folder `points`, or its first stage, in a worker; an error becomes the outcome."""
    folder = points / name
    try:
        with interruptible(), locked(folder):
            plan = make_plan(read_draft(folder / "config.yaml"))
            result = execute(plan, folder, until=plan.labels[0] if first_only else None, cache=Cache(cache))
            if result.is_complete:
                publish(plan, result, folder)
    except Exception as error:  # noqa: BLE001 - one point never ends the others
        return Outcome(lines_and_code(error)[0], lacks_memory=isinstance(error, MemoryShortageError))
    return Outcome(None, max(step.peak_memory_bytes for step in result.steps), result.warnings)


@dataclass
class _StudyRunner:
    """A running study: the states of all points by name, and the points that are not done."""

    study: Study
    out: Path
    plans: Sequence[PointPlan]
    watcher: Watcher
    left: dict[str, PointPlan] = field(init=False)
    states: dict[str, PointState] = field(init=False)
    _warnings: set[str] = field(default_factory=set)
    _facts: dict[str, Any] = field(default_factory=dict)
    _started: float = field(default_factory=time.monotonic)
    _written: float = 0.0

    def __post_init__(self) -> None:
        self.left = {plan.point.name: plan for plan in self.plans if not plan.is_done}
        self.states = {plan.point.name: plan.state for plan in self.plans}

    def prepare(self, cache: Cache, workers: int) -> None:
        """Write the config of each point that is left, and restore missing results of finished points to `cache`."""
        for plan in self.plans:
            _restore_to_cache(Store(plan.folder / STORE), cache)
        for plan in self.left.values():
            plan.folder.mkdir(parents=True, exist_ok=True)
            write_atomically(plan.folder / "config.yaml", partial(_write_text, plan.config))
        self._facts = {"name": self.study.name, "workers": workers, "cache": str(cache.root), **environment()}
        self.write()

    def load_shapes(self, cache: Cache, pool: WorkerPool) -> None:
        """Run the first stage of the points whose shape is unknown, once for all points that share it."""
        unknown = {plan.source: name for name, plan in self.left.items() if plan.grids.any and not plan.shape(cache)}
        do = partial(run_point, self.out.resolve() / POINTS, cache.root, first_only=True)
        schedule = Schedule(do, lambda _name, _outcome: None, pool.size, keep_going=True, memory=pool.memory)
        schedule.run([Task(name, frozenset()) for name in unknown.values()], pool.start)

    def calibrate(self, cache: Cache, schedule: Schedule) -> None:
        """Correct the expected memory of `schedule` by the peak memory of the finished points."""
        for plan in self.plans:
            if plan.point.name not in self.left:
                schedule.calibrate(plan.memory(cache), plan.state.record["peak_memory_bytes"])

    def tasks(self, cache: Cache) -> list[Task]:
        """Return the tasks that are left."""
        return [Task(name, plan.work, plan.memory(cache)) for name, plan in self.left.items()]

    def ended(self, name: str, outcome: Outcome) -> None:
        """Record the outcome of a point."""
        plan = self.left.pop(name)
        if outcome.error is None:
            (plan.folder / FAILURE).unlink(missing_ok=True)
        else:
            write_json(plan.folder / FAILURE, {"error": outcome.error, "config_sha256": plan.config_sha256})
        self.states[name] = plan.state
        for message in set(outcome.warnings) - self._warnings:
            self.watcher.warned(message)
        self._warnings.update(outcome.warnings)
        self.watcher.ended(self.states[name], len(self.plans) - len(self.left), len(self.plans))
        if time.monotonic() - self._written > _WRITE_EVERY:
            self.write()

    def write(self) -> None:
        """Write the present results."""
        self._facts["seconds"] = round(time.monotonic() - self._started, 3)
        write_results(self.out, self.study.columns, self.states.values(), self._facts)
        self._written = time.monotonic()


def _restore_to_cache(store: Store, cache: Cache) -> None:
    for key in store.stored_keys():
        if not cache.store.path("results", key).exists():
            with suppress(PipelineError, OSError):
                cache.publish(key, store)


def _write_text(text: str, stream: BinaryIO) -> None:
    stream.write(text.encode())
