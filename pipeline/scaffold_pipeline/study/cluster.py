"""A Dask cluster that works on the points of a study, which lies in a folder that all its machines see.

Each point has a process of its own beside the worker that answers for it: compiled code then has the worker's share of
threads from its start, and whatever ends that process is no more than the end of a point.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import platform
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING, Any

from scaffold_pipeline.errors import PipelineError
from scaffold_pipeline.processes.isolation import die_with_parent
from scaffold_pipeline.processes.threads import THREAD_VARIABLES, thread_count, use_one_blas_thread
from scaffold_pipeline.report.publish import library_versions
from scaffold_pipeline.study.workers import WorkerPool

if TYPE_CHECKING:
    from distributed import Client

PATIENCE = 5.0
"""Seconds that a scheduler has to answer."""


def cluster_pool(address: str, most: int, count: int | None = None) -> WorkerPool:
    """Return the workers of the scheduler at `address`: `count` points at once, by default one a worker.

    There are `most` at most. Raises `PipelineError` where none answers, or it has no workers, or one of them has other
    versions of what results come from: they would depend on who worked.
    """
    with _client(address) as client:
        found = _workers(address, client)
    memory = sum(worker["memory_limit"] or sys.maxsize for worker in found)
    return WorkerPool(min(count or len(found), most), memory, partial(_cluster, address))


@contextmanager
def cluster_executor(address: str | None) -> Iterator[Executor | None]:
    """Give an executor of the scheduler's workers, which are checked as for a pool; none without an address."""
    if address is None:
        yield None
        return
    with _client(address) as client:
        _workers(address, client)
        yield _Cluster(address, client.get_executor(pure=False))


def _workers(address: str, client: Client) -> Collection[dict[str, Any]]:
    """Return what the scheduler tells of each worker; raises `PipelineError` where there is none, or an unlike one."""
    found: dict[str, dict[str, Any]] = client.scheduler_info(n_workers=-1)["workers"]
    if not found:
        raise PipelineError(f"{address}: the scheduler has no workers; start some with `dask worker {address}`")
    _require_same_versions(address, client)
    return found.values()


@contextmanager
def _client(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        message = "--scheduler needs dask.distributed; install it with `pip install 'scaffold-pipeline[dask]'`"
        raise PipelineError(message) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it tells here, an exception tells too
    try:
        asyncio.run(asyncio.wait_for(_shake_hands(address), PATIENCE))
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        message = (
            f"{address}: no Dask scheduler answers there within {PATIENCE:.0f} s; is it the address that it printed?"
        )
        raise PipelineError(message) from error
    with client:
        yield client


def _require_same_versions(address: str, client: Client) -> None:
    here = _versions()
    for worker, there in client.run(_versions, on_error="return").items():
        if not isinstance(there, dict):  # the error of a worker that has not got this package, or of another age
            raise PipelineError(
                f"{address}: worker {worker} cannot take part ({there}); install scaffold-pipeline there"
            )
        for name in sorted(here):
            if there.get(name) != here[name]:
                raise PipelineError(
                    f"{address}: worker {worker} has {name} {there.get(name)}, here it is {here[name]}, so results "
                    "would depend on who computes them; install the same versions on both"
                )


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **library_versions()}


async def _shake_hands(address: str) -> None:
    """Connect to the scheduler at `address` and leave it: where one accepts and is silent, `Client` waits for ever."""
    from distributed import Security
    from distributed.core import connect

    comm = await connect(address, timeout=PATIENCE, **Security().get_connection_args("client"))
    await comm.close()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    with _client(address) as client:
        yield _Cluster(address, client.get_executor(pure=False))


class _Cluster(Executor):
    """Dask's executor, with a process for each call, and the end of a worker told as other executors tell it."""

    def __init__(self, address: str, executor: Executor) -> None:
        self._address = address
        self._executor = executor

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> Future[Any]:  # noqa: ANN401
        promised: Future[Any] = Future()
        given = self._executor.submit(call_in_process, function, *arguments)
        given.add_done_callback(partial(self._hand_on, promised))
        return promised

    def _hand_on(self, promised: Future[Any], given: Future[Any]) -> None:
        from distributed import KilledWorker

        if given.cancelled():
            message = f"{self._address}: the scheduler was lost; the same command goes on with the points that are left"
            promised.set_exception(PipelineError(message))
            return
        error = given.exception()
        if error is None:
            promised.set_result(given.result())
        else:
            promised.set_exception(BrokenExecutor(str(error)) if isinstance(error, KilledWorker) else error)


def call_in_process(function: Callable[..., Any], *arguments: Any) -> Any:  # noqa: ANN401 - whatever it returns
    """Return `function(*arguments)`, computed in a fresh process; raises `BrokenExecutor` where that ends without it.

    Not a process of `multiprocessing`: a worker that a nanny has started may have none.
    """
    environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, str(thread_count()))}
    with TemporaryDirectory(prefix="scaffold-") as folder:
        box = Path(folder)
        (box / "request").write_bytes(pickle.dumps((function, arguments)))
        command = [sys.executable, "-m", __name__, str(box)]
        with (
            (box / "output").open("wb") as output,
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=environment) as child,
        ):
            child.wait()
        if child.returncode:
            lines = (box / "output").read_text(encoding="utf-8", errors="replace").split("\n")
            raise BrokenExecutor(f"ended with exit code {child.returncode} ({' '.join(lines[-2:]).strip()})")
        return pickle.loads((box / "answer").read_bytes())  # noqa: S301 - our own child wrote it


def _serve(box: Path) -> None:
    """Do what the request in `box` asks for: the child's side."""
    die_with_parent()
    Thread(target=_outlive_nobody, daemon=True).start()
    use_one_blas_thread()
    function, arguments = pickle.loads((box / "request").read_bytes())  # noqa: S301 - our own parent wrote it
    (box / "answer").write_bytes(pickle.dumps(function(*arguments)))


def _outlive_nobody() -> None:
    """End this process when its parent, which holds the other end of standard input, is gone."""
    os.read(sys.stdin.fileno(), 1)  # not of sys.stdin itself: a thread that waits in it makes the interpreter end badly
    os._exit(1)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
