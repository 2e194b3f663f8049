from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from threading import Barrier, Lock, Thread
from typing import Any

import pytest

from scaffold_pipeline.studies.schedule import Outcome, Schedule, Task

GIB = 2**30


class Ledger:
    """What a schedule did: what was started with what beside it, and what ended how."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.running: set[str] = set()
        self.started: list[str] = []
        self.together: list[frozenset[str]] = []
        self.ended: dict[str, Outcome] = {}

    def end(self, name: str, outcome: Outcome) -> None:
        assert name not in self.ended
        self.ended[name] = outcome

    def working(self, work: Callable[[str], Outcome]) -> Callable[[str], Outcome]:
        def do(name: str) -> Outcome:
            with self.lock:
                self.running.add(name)
                self.started.append(name)
                self.together.append(frozenset(self.running))
            try:
                return work(name)
            finally:
                with self.lock:
                    self.running.remove(name)

        return do


@contextmanager
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(8) as executor:
        yield executor


def tasks(**pieces: str) -> list[Task]:
    return [Task(name, frozenset(letters)) for name, letters in pieces.items()]


def run(todo: list[Task], work: Callable[[str], Outcome], **options: Any) -> Ledger:  # noqa: ANN401
    ledger = Ledger()
    Schedule(ledger.working(work), ledger.end, **options).run(todo, threads)
    return ledger


def test_all_tasks_are_done_in_their_order_by_one_worker():
    ledger = run(tasks(a="", b="", c=""), lambda _: Outcome(), workers=1)
    assert ledger.started == list(ledger.ended) == ["a", "b", "c"]
    assert max(map(len, ledger.together)) == 1


def test_so_many_work_at_once_and_no_more():
    meeting = Barrier(3, timeout=20.0)

    def meet(_: str) -> Outcome:
        meeting.wait()
        return Outcome()

    ledger = run([Task(str(number), frozenset()) for number in range(6)], meet, workers=3)
    assert max(map(len, ledger.together)) == 3
    assert len(ledger.ended) == 6


def test_what_would_wait_for_another_is_started_later():
    meeting = Barrier(2, timeout=20.0)

    def meet(name: str) -> Outcome:
        if name in {"a", "d"}:
            meeting.wait()
        return Outcome()

    ledger = run(tasks(a="xyz", b="xyz", c="xy", d="x"), meet, workers=2)
    assert set(ledger.started[:2]) == {"a", "d"}


def test_what_is_made_already_makes_nobody_wait():
    ledger = run(tasks(a="xy", b="xyz", c="x"), lambda _: Outcome(), workers=1)
    assert ledger.started == ["a", "b", "c"]


def test_no_more_are_started_than_fit_into_memory():
    ledger = run(
        [Task(str(number), frozenset()) for number in range(6)],
        lambda _: Outcome(peak_memory_bytes=3 * GIB),
        workers=4,
        memory=int(3.5 * GIB),
    )
    assert max(map(len, ledger.together[4:])) == 1
    assert len(ledger.ended) == 6


def test_what_is_expected_to_need_much_is_started_alone_from_the_beginning():
    todo = [Task(str(number), frozenset(), 3 * GIB) for number in range(4)]
    ledger = run(todo, lambda _: Outcome(), workers=4, memory=5 * GIB)
    assert (max(map(len, ledger.together)), len(ledger.ended)) == (1, 4)


@pytest.mark.parametrize(("expected", "most"), [(GIB, 2), (8 * GIB, 1)])
def test_what_is_expected_is_corrected_by_those_that_have_ended(expected: int, most: int):
    def work(_: str) -> Outcome:
        time.sleep(0.1)
        return Outcome(peak_memory_bytes=GIB // 2)

    first = Task("first", frozenset(), memory=GIB)
    others = [Task(str(number), frozenset(), memory=expected) for number in range(4)]
    ledger = run([first, *others], work, workers=2, memory=3 * GIB)
    assert max(map(len, ledger.together[2:])) == most


@pytest.mark.parametrize(("peak", "most"), [(GIB, 2), (2 * GIB, 1)])
def test_what_has_ended_before_corrects_too(peak: int, most: int):
    def work(_: str) -> Outcome:
        time.sleep(0.1)
        return Outcome()

    ledger = Ledger()
    schedule = Schedule(ledger.working(work), ledger.end, workers=2, memory=3 * GIB)
    schedule.calibrate(GIB, peak)
    schedule.run([Task(str(number), frozenset(), memory=GIB) for number in range(4)], threads)
    assert max(map(len, ledger.together)) == most


@pytest.mark.parametrize("second", [None, "no memory"])
def test_what_lacks_memory_beside_another_is_tried_again_alone_once(second: str | None):
    meeting = Barrier(2, timeout=20.0)
    lacks = Outcome("no memory", lacks_memory=True)
    outcomes = {"a": [Outcome()], "b": [lacks, Outcome(second, lacks_memory=bool(second))], "c": [Outcome()]}

    def work(name: str) -> Outcome:
        if name == "a" or (name == "b" and len(outcomes["b"]) == 2):
            meeting.wait()
        return outcomes[name].pop(0)

    ledger = Ledger()
    Schedule(ledger.working(work), ledger.end, workers=2, keep_going=True).run(tasks(a="", b="", c=""), threads)
    again = ledger.started.index("b", ledger.started.index("b") + 1)
    assert ledger.together[again] == {"b"}
    assert {name: outcome.error for name, outcome in ledger.ended.items()} == {"a": None, "b": second, "c": None}


def test_what_lacks_memory_alone_fails_at_once():
    ledger = run(tasks(a=""), lambda _: Outcome("no memory", lacks_memory=True), workers=2)
    assert (ledger.started, ledger.ended["a"].error) == (["a"], "no memory")


def test_one_is_started_however_little_memory_there_is():
    ledger = run(tasks(a="", b=""), lambda _: Outcome(), workers=2, memory=0)
    assert (max(map(len, ledger.together)), list(ledger.ended)) == (1, ["a", "b"])


@pytest.mark.parametrize(("keep_going", "done"), [(False, ["a", "b"]), (True, ["a", "b", "c"])])
def test_after_a_failure_the_others_wait_unless_told_to_go_on(keep_going: bool, done: list[str]):  # noqa: FBT001
    def work(name: str) -> Outcome:
        return Outcome("too few points" if name == "b" else None)

    ledger = run(tasks(a="", b="", c=""), work, workers=1, keep_going=keep_going)
    assert list(ledger.ended) == done
    assert ledger.ended["b"].error == "too few points"


def test_those_that_run_beside_a_failing_one_are_finished():
    ledger, meeting = Ledger(), Barrier(2, timeout=20.0)

    def work(name: str) -> Outcome:
        meeting.wait()
        while name == "b" and "a" not in ledger.ended:
            time.sleep(0.01)
        return Outcome("failed" if name == "a" else None)

    Schedule(ledger.working(work), ledger.end, workers=2).run(tasks(a="", b="", c=""), threads)
    assert {name: outcome.error for name, outcome in ledger.ended.items()} == {"a": "failed", "b": None}


def test_an_exception_in_the_schedule_itself_is_not_hidden():
    def stumble(_: str) -> Outcome:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tasks(a=""), stumble, workers=1)


# Workers that die


class Mortal(Executor):
    """An executor that breaks, with all that is in it, when it is given one of `deadly`; then it takes no more."""

    def __init__(self, deadly: list[str]) -> None:
        self.deadly = deadly
        self.inside: list[tuple[Future[Any], Callable[[str], Outcome], str]] = []
        self.is_broken = False

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> Future[Any]:  # noqa: ANN401
        if self.is_broken:
            raise BrokenProcessPool
        future: Future[Any] = Future()
        self.inside.append((future, function, arguments[0]))
        Thread(target=self._work).start() if len(self.inside) == 1 else None
        return future

    def _work(self) -> None:
        while self.inside:
            future, function, name = self.inside[0]
            if name in self.deadly:
                self.deadly.remove(name)
                self.is_broken = True
                for broken, *_ in self.inside:
                    broken.set_exception(BrokenProcessPool())
                return
            future.set_result(function(name))
            self.inside.pop(0)


def die(deadly: list[str], **options: Any) -> Ledger:  # noqa: ANN401
    @contextmanager
    def mortals() -> Iterator[Executor]:
        yield Mortal(deadly)

    ledger = Ledger()
    Schedule(ledger.working(lambda _: Outcome()), ledger.end, workers=2, **options).run(
        tasks(a="", b="", c=""), mortals
    )
    return ledger


def test_a_death_costs_a_retry_and_no_result():
    ledger = die(["b"])
    assert {name: outcome.error for name, outcome in ledger.ended.items()} == {"a": None, "b": None, "c": None}


def test_what_dies_twice_is_a_failure_and_the_innocent_is_not():
    ledger = die(["b", "b"], keep_going=True)
    assert ledger.ended["a"].error is None
    assert ledger.ended["c"].error is None
    assert ledger.ended["b"].error == "its process was ended from outside, twice; check the free memory"
