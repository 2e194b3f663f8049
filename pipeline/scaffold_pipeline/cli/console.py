"""Progress of a run or study on standard error: a live bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from scaffold_pipeline.config.plan import Step
from scaffold_pipeline.runs import runner
from scaffold_pipeline.runs.records import StepRecord
from scaffold_pipeline.studies.study import Watcher
from scaffold_pipeline.studies.table import PointState

_GIB = 2**30


@contextmanager
def watch(*, quiet: bool) -> Iterator[runner.Progress]:
    """Print the stages of a run on standard error as they start and finish; print nothing if `quiet`."""
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    if quiet:
        yield runner.Progress()
    elif console.is_terminal:
        with _live(console) as progress:
            yield progress
    else:
        yield _plain_progress(console)


@contextmanager
def _live(console: Console) -> Iterator[runner.Progress]:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=None)

        def started(step: Step, number: int, count: int) -> None:
            bars.reset(task, description=f"{step.label} ({number} of {count})", total=None)

        yield replace(_plain_progress(console), started=started)


def _plain_progress(console: Console) -> runner.Progress:
    return runner.Progress(
        finished=lambda record: _print_record(console, record),
        warned=lambda message: console.print(f"warning: {message}", markup=False),
    )


def _print_record(console: Console, record: StepRecord) -> None:
    cost = "unchanged" if record.reused else f"{record.seconds:.1f} s, {record.peak_memory_bytes / _GIB:.2f} GiB"
    console.print(f"{record.label}: {cost}", markup=False)
    for message in record.warnings:
        console.print(f"{record.label}: warning: {message}", markup=False)


@contextmanager
def watch_study(*, quiet: bool) -> Iterator[Watcher]:
    """Print the points of a study on standard error as they end, with a bar on a terminal; nothing if `quiet`."""
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    if quiet:
        yield Watcher()
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("points", total=None)

        def ended(state: PointState, number: int, count: int) -> None:
            bars.update(task, completed=number, total=count)
            console.print(f"[{number}/{count}] {state.name}: {_outcome_text(state)}", markup=False)

        yield Watcher(ended, lambda message: console.print(f"warning: {message}", markup=False))


def _outcome_text(state: PointState) -> str:
    if state.error is not None:
        return f"FAILED: {state.error}"
    run, shared = state.seconds
    saved = f" ({shared:.1f} s saved)" if shared else ""
    return f"{run:.1f} s{saved}, quality: {'FAILED' if state.gates else state.metrics.get('quality')}"
