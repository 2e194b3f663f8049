"""The order in which tasks that share work are given to an executor, and what becomes of those whose worker dies."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from scaffold_pipeline.study.memory_forecast import USUAL

MOST_DEATHS = 2
"""A task whose worker dies is tried again, alone, once: it may have been the memory that another task took. So is one
that has not had the memory that it needs while another ran beside it."""


@dataclass(frozen=True)
class Task:
    """Something to do, and the hashes of all pieces of work in it: a piece that two have in common is done once.

    `memory` are the bytes that it is expected to need, before any other has ended and shown how far such numbers are
    off.
    """

    name: str
    pieces: frozenset[str]
    memory: int = USUAL


@dataclass(frozen=True)
class Outcome:
    """What became of a task: the error that ended it, or None, the most memory that it had, bytes, and warnings.

    `lacks_memory` tells that the error was one of too little memory.
    """

    error: str | None = None
    peak_memory_bytes: int = 0
    warnings: tuple[str, ...] = ()
    lacks_memory: bool = False


@dataclass
class Schedule:
    """Tasks on their way through an executor: `workers` at once at most, and no more than fit into `memory` bytes.

    `do` is what a worker calls with a task's name; `ended` is told each outcome. After a failure nothing new is
    started unless `keep_going`. The memory that a task is expected to need is multiplied by the most that any that has
    ended had for a byte expected.
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
        """Take into account that a task which was expected to need `expected` bytes had `peak`."""
        self._factor = max(self._factor, peak / expected)

    def run(self, tasks: Iterable[Task], start: Callable[[], AbstractContextManager[Executor]]) -> None:
        """Do all `tasks`, in executors that `start` makes: another whenever one is broken by a worker's death."""
        pending = list(tasks)
        while pending and not self._is_stopped:
            with start() as executor:
                pending = self._drain(pending, executor)

    def _drain(self, pending: list[Task], executor: Executor) -> list[Task]:
        """Work on `pending` until all are done or the executor is broken; return what is left."""
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
        """Return whether `task`, which is chosen to be next, may start beside those that run."""
        if self._is_stopped or len(running) >= self.workers:
            return False
        needed = (self._factor or 1.0) * sum(each.memory for each in (task, *running))
        return not running or (not self._deaths[task.name] and needed <= self.memory)

    def _may_fit_alone(self, task: Task, outcome: Outcome) -> bool:
        return outcome.lacks_memory and task.name in self._accompanied and not self._deaths[task.name]

    def _choose(self, pending: list[Task], running: Collection[Task]) -> Task:
        """Return the task that would have to wait least for pieces that are being made, the first of equals."""
        suspects = [task for task in pending if self._deaths[task.name]]
        being_made = frozenset[str]().union(*(task.pieces for task in running)) - self._made
        return min(suspects or pending, key=lambda task: len(task.pieces & being_made))

    def _after_death(self, task: Task) -> list[Task]:
        """Return the task to be tried again, or end it."""
        self._deaths[task.name] += 1
        if self._deaths[task.name] < MOST_DEATHS:
            return [task]
        self._end(task, Outcome("the process that worked on it was ended from outside, twice; is memory short?"))
        return []

    def _end(self, task: Task, outcome: Outcome) -> None:
        self.calibrate(task.memory, outcome.peak_memory_bytes)
        if outcome.error is None:
            self._made |= task.pieces
        elif not self.keep_going:
            self._is_stopped = True
        self.ended(task.name, outcome)
