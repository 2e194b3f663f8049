"""Run the points of a study on a Dask cluster, all of whose machines have access to the study's folder.

Each point runs in a process of its own beside its worker: compiled code then starts with the worker's number of
threads, and a crash ends only that point.
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
from scaffold_pipeline.studies.workers import WorkerPool

if TYPE_CHECKING:
    from distributed import Client

CONNECT_TIMEOUT = 5.0
"""Seconds within which a scheduler must answer."""


def cluster_pool(address: str, most: int, count: int | None = None) -> WorkerPool:
    """Return the workers of the scheduler at `address` for `count` points at once, by default one per worker.

    There are `most` at most. Raises `PipelineError` if no scheduler answers, it has no workers, or a worker has
    different versions of the libraries: results would depend on the worker.
    """
    with _client(address) as client:
        workers = _workers(address, client)
    memory = sum(worker["memory_limit"] or sys.maxsize for worker in workers)
    return WorkerPool(min(count or len(workers), most), memory, partial(_cluster, address))


@contextmanager
def cluster_executor(address: str | None) -> Iterator[Executor | None]:
    """Yield an executor on the scheduler's workers, checked as in `cluster_pool`; None without an address."""
    if address is None:
        yield None
        return
    with _client(address) as client:
        _workers(address, client)
        yield _Cluster(address, client.get_executor(pure=False))


def _workers(address: str, client: Client) -> Collection[dict[str, Any]]:
    """Return the scheduler's facts of each worker; raises `PipelineError` if there is none, or versions differ."""
    workers: dict[str, dict[str, Any]] = client.scheduler_info(n_workers=-1)["workers"]
    if not workers:
        raise PipelineError(f"{address}: the scheduler has no workers; start some with `dask worker {address}`")
    _require_same_versions(address, client)
    return workers.values()


@contextmanager
def _client(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        message = "--scheduler needs dask.distributed; install it with `pip install 'scaffold-pipeline[dask]'`"
        raise PipelineError(message) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # its messages here repeat the exceptions
    try:
        asyncio.run(asyncio.wait_for(_shake_hands(address), CONNECT_TIMEOUT))
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        message = f"{address}: no Dask scheduler answers within {CONNECT_TIMEOUT:.0f} s; give the address it printed"
        raise PipelineError(message) from error
    with client:
        yield client


def _require_same_versions(address: str, client: Client) -> None:
    here = _versions()
    for worker, there in client.run(_versions, on_error="return").items():
        if not isinstance(there, dict):  # the error of a worker without this package, or with an old one
            raise PipelineError(f"{address}: worker {worker} cannot be used ({there}); install scaffold-pipeline there")
        for name in sorted(here):
            if there.get(name) != here[name]:
                raise PipelineError(
                    f"{address}: worker {worker} has {name} {there.get(name)}, here it is {here[name]}, so results "
                    "would depend on the machine; install the same versions on both"
                )


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **library_versions()}


async def _shake_hands(address: str) -> None:
    """Connect to the scheduler at `address` once: `Client` would wait for ever for one that accepts and is silent."""
    from distributed import Security
    from distributed.core import connect

    comm = await connect(address, timeout=CONNECT_TIMEOUT, **Security().get_connection_args("client"))
    await comm.close()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    with _client(address) as client:
        yield _Cluster(address, client.get_executor(pure=False))


class _Cluster(Executor):
    """Dask's executor, with a process for each call; a dead worker raises `BrokenExecutor`, as in other executors."""

    def __init__(self, address: str, executor: Executor) -> None:
        self._address = address
        self._executor = executor

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_: Any) -> Future[Any]:  # noqa: ANN401
        future: Future[Any] = Future()
        of_dask = self._executor.submit(call_in_process, function, *arguments)
        of_dask.add_done_callback(partial(self._pass_on, future))
        return future

    def _pass_on(self, future: Future[Any], of_dask: Future[Any]) -> None:
        from distributed import KilledWorker

        if of_dask.cancelled():
            message = f"{self._address}: the scheduler was lost; finished points are kept: the same command continues"
            future.set_exception(PipelineError(message))
            return
        error = of_dask.exception()
        if error is None:
            future.set_result(of_dask.result())
        else:
            future.set_exception(BrokenExecutor(str(error)) if isinstance(error, KilledWorker) else error)


def call_in_process(function: Callable[..., Any], *arguments: Any) -> Any:  # noqa: ANN401 - whatever it returns
    """Return `function(*arguments)`, computed in a new process; raises `BrokenExecutor` if that ends without a result.

    `multiprocessing` is not used: a worker that a nanny has started may have no such child processes.
    """
    environment = {**os.environ, **dict.fromkeys(THREAD_VARIABLES, str(thread_count()))}
    with TemporaryDirectory(prefix="scaffold-") as name:
        folder = Path(name)
        (folder / "request").write_bytes(pickle.dumps((function, arguments)))
        command = [sys.executable, "-m", __name__, str(folder)]
        with (
            (folder / "output").open("wb") as output,
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=environment) as child,
        ):
            child.wait()
        if child.returncode:
            lines = (folder / "output").read_text(encoding="utf-8", errors="replace").split("\n")
            raise BrokenExecutor(f"ended with exit code {child.returncode} ({' '.join(lines[-2:]).strip()})")
        return pickle.loads((folder / "answer").read_bytes())  # noqa: S301 - our own child wrote it


def _serve(folder: Path) -> None:
    """Run the request in `folder` and write the answer; this is the child process."""
    die_with_parent()
    Thread(target=_exit_with_parent, daemon=True).start()
    use_one_blas_thread()
    function, arguments = pickle.loads((folder / "request").read_bytes())  # noqa: S301 - our own parent wrote it
    (folder / "answer").write_bytes(pickle.dumps(function(*arguments)))


def _exit_with_parent() -> None:
    """End this process when its parent, which holds the other end of standard input, has ended."""
    os.read(sys.stdin.fileno(), 1)  # a thread that waits in sys.stdin itself breaks the interpreter's shutdown
    os._exit(1)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
