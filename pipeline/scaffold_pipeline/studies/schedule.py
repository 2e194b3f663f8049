"""Scheduling of tasks that share work: their order on an executor, and retries after the death of a worker."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from scaffold_pipeline.studies.memory_forecast import USUAL

MOST_DEATHS = 2
"""A task whose worker dies is tried again once, alone: other tasks may have taken the memory. So is a task that ran out
of memory beside others."""


@dataclass(frozen=True)
class Task:
    """A task, with the hashes of its pieces of work: a piece that two tasks share is done once.

    `memory` is the expected memory, bytes; tasks that have ended correct it.
    """

    name: str
    pieces: frozenset[str]
    memory: int = USUAL


@dataclass(frozen=True)
class Outcome:
    """The result of a task: the error that ended it or None, its peak memory in bytes, and its warnings.

    `lacks_memory` is true if the error was a lack of memory.
    """

    error: str | None = None
    peak_memory_bytes: int = 0
    warnings: tuple[str, ...] = ()
    lacks_memory: bool = False


@dataclass
class Schedule:
    """Run tasks on an executor: at most `workers` at once, and no more than fit into `memory` bytes.

    A worker calls `do` with a task's name; `ended` is called with each outcome. After a failure no new task is started
    unless `keep_going`. The expected memory of a task is multiplied by the greatest ratio of peak to expected memory
    of all tasks that have ended.
    """

    do: Callable[[str], Outcome]
    ended: Callable[[str, Outcome], None]
    workers: int
    keep_going: bool = False
    memory: int = sys.maxsize
    _factor: float = 0.0
    _made: set[str] = field(default_factory=set)
    _deaths: Counter[str] = field(default_factory=Counter)
    _accompanied: set[str] = field(default_factory=set)
    _is_stopped: bool = False

    def calibrate(self, expected: int, peak: int) -> None:
        """Correct the expected memory by a task that was expected to need `expected` bytes and took `peak`."""
        self._factor = max(self._factor, peak / expected)

    def run(self, tasks: Iterable[Task], start: Callable[[], AbstractContextManager[Executor]]) -> None:
        """Run all `tasks` in executors made by `start`: a new one whenever a worker's death has broken the last."""
        pending = list(tasks)
        while pending and not self._is_stopped:
            with start() as executor:
                pending = self._drain(pending, executor)

    def _drain(self, pending: list[Task], executor: Executor) -> list[Task]:
        """Run `pending` until all are done or the executor is broken; return the tasks that are left."""
        running: dict[Future[Outcome], Task] = {}
        is_broken = False
        while running or (pending and not is_broken and not self._is_stopped):
            while pending and not is_broken:
                task = self._choose(pending, running.values())
                if not self._may_start(task, running.values()):
                    break
                try:
                    running[executor.submit(self.do, task.name)] = task
                    pending.remove(task)
                except BrokenExecutor:
                    is_broken = True
            if len(running) > 1:
                self._accompanied.update(task.name for task in running.values())
            done = wait(running, return_when=FIRST_COMPLETED).done
            for future in [future for future in running if future in done]:
                task = running.pop(future)
                if isinstance(future.exception(), BrokenExecutor):
                    is_broken = True
                    pending += self._after_death(task)
                elif self._may_fit_alone(task, future.result()):
                    self._deaths[task.name] += 1
                    pending.append(task)
                else:
                    self._end(task, future.result())
        return pending

    def _may_start(self, task: Task, running: Collection[Task]) -> bool:
        """Return whether `task`, the next one, may start beside those that are running."""
        if self._is_stopped or len(running) >= self.workers:
            return False
        needed = (self._factor or 1.0) * sum(each.memory for each in (task, *running))
        return not running or (not self._deaths[task.name] and needed <= self.memory)

    def _may_fit_alone(self, task: Task, outcome: Outcome) -> bool:
        return outcome.lacks_memory and task.name in self._accompanied and not self._deaths[task.name]

    def _choose(self, pending: list[Task], running: Collection[Task]) -> Task:
        """Return the task with the fewest pieces that running tasks are computing; of equal ones the first."""
        suspects = [task for task in pending if self._deaths[task.name]]
        being_made = frozenset[str]().union(*(task.pieces for task in running)) - self._made
        return min(suspects or pending, key=lambda task: len(task.pieces & being_made))

    def _after_death(self, task: Task) -> list[Task]:
        """Return the task if it may be tried again; otherwise end it."""
        self._deaths[task.name] += 1
        if self._deaths[task.name] < MOST_DEATHS:
            return [task]
        self._end(task, Outcome("its process was ended from outside, twice; check the free memory"))
        return []

    def _end(self, task: Task, outcome: Outcome) -> None:
        self.calibrate(task.memory, outcome.peak_memory_bytes)
        if outcome.error is None:
            self._made |= task.pieces
        elif not self.keep_going:
            self._is_stopped = True
        self.ended(task.name, outcome)
