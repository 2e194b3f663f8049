"""What a person at a terminal sees of a run: a live bar a stage, or plain lines where there is no terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from scaffold_pipeline.config.plan import Step
from scaffold_pipeline.run import runner
from scaffold_pipeline.run.records import StepRecord
from scaffold_pipeline.study.study import Watcher
from scaffold_pipeline.study.table import PointState

_GIB = 2**30


@contextmanager
def watch(*, quiet: bool) -> Iterator[runner.Progress]:
    """Show the stages of a run on standard error as they start and finish; nothing where `quiet`."""
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    if quiet:
        yield runner.Progress()
    elif console.is_terminal:
        with _live(console) as progress:
            yield progress
    else:
        yield _telling(console)


@contextmanager
def _live(console: Console) -> Iterator[runner.Progress]:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=None)

        def started(step: Step, number: int, count: int) -> None:
            bars.reset(task, description=f"{step.label} ({number} of {count})", total=None)

        yield replace(_telling(console), started=started)


def _telling(console: Console) -> runner.Progress:
    return runner.Progress(
        finished=lambda record: _tell(console, record),
        warned=lambda message: console.print(f"warning: {message}", markup=False),
    )


def _tell(console: Console, record: StepRecord) -> None:
    done = "unchanged" if record.reused else f"{record.seconds:.1f} s, {record.peak_memory_bytes / _GIB:.2f} GiB"
    console.print(f"{record.label}: {done}", markup=False)
    for message in record.warnings:
        console.print(f"{record.label}: warning: {message}", markup=False)


@contextmanager
def watch_study(*, quiet: bool) -> Iterator[Watcher]:
    """Show the points of a study on standard error as they end, on a terminal with a bar; nothing where `quiet`."""
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    if quiet:
        yield Watcher()
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("points", total=None)

        def ended(state: PointState, number: int, count: int) -> None:
            bars.update(task, completed=number, total=count)
            console.print(f"[{number}/{count}] {state.name}: {_ending(state)}", markup=False)

        yield Watcher(ended, lambda message: console.print(f"warning: {message}", markup=False))


def _ending(state: PointState) -> str:
    if state.error is not None:
        return f"FAILED: {state.error}"
    run, shared = state.seconds
    saved = f" ({shared:.1f} s saved)" if shared else ""
    return f"{run:.1f} s{saved}, quality: {'FAILED' if state.gates else state.metrics.get('quality')}"
