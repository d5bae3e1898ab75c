# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Independent tasks: in this process, in processes beside it, or on a Dask cluster elsewhere."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, TypeVar

import cloudpickle

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.version import __version__

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

# Starting processes takes about as long as reading so many flights of half a minute.
MANY_FILES = 64
_ANSWER_S = 30.0
# One task per core: threads within a task would only take cores from other tasks.
_ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}


class ParallelError(QuadpiError):
    """Workers cannot be reached, cannot run quadpi, or ended before their task did."""


def map_tasks(
    function: Callable[[Shared, Item], Result],
    items: Sequence[Item],
    *,
    shared: Shared,
    workers: int | None = None,
    scheduler: str | None = None,
    done: Callable[[int, Result], None] = lambda _index, _result: None,
) -> list[Result]:
    """Results of `function(shared, item)`, in the order of the items whatever the workers.

    Args:
        function: of a module, by whose name a worker finds it.
        items: one per task.
        shared: what all tasks need; each worker gets it once.
        workers: processes on this machine; default: one per core. One means this process.
        scheduler: address of a Dask scheduler whose workers do the tasks instead. They must run the same
            version of quadpi; files are only found where they share the file system.
        done: called in this process with the index of each task that has finished and its result, as they
            finish.

    Raises:
        ParallelError: for a scheduler that does not answer, has no workers, or has workers with no or
            another quadpi; and when a worker is lost for good.
    """
    results: list[Any] = [None] * len(items)

    def finished(index: int, result: Result) -> None:
        results[index] = result
        done(index, result)

    count = min(workers or os.cpu_count() or 1, len(items))
    if scheduler is None and count <= 1:
        for index, item in enumerate(items):
            finished(index, function(shared, item))
    elif items and scheduler is None:
        _map_beside(count, function, items, shared, finished)
    elif items:
        with _client(str(scheduler)) as client:
            _map_on(client, function, items, shared, finished)
    return results


def map_files(
    function: Callable[[Shared, Path], Result],
    paths: Sequence[Path],
    *,
    shared: Shared,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """As :func:`map_tasks`, for files that each take a fraction of a second: processes only if it pays.

    Args:
        function: see there.
        paths: of files; a scheduler's workers, whose working folder is another, are given absolute ones.
        shared: see there.
        workers: default: this process for fewer than MANY_FILES, else one per core.
        scheduler: see there.
        progress: called with the number of files finished so far.

    Raises:
        ParallelError: see there.
    """
    finished = 0

    def done(_index: int, _result: Result) -> None:
        nonlocal finished
        finished += 1
        progress(finished)

    if scheduler is not None:
        paths = [path.absolute() for path in paths]
    if workers is None and len(paths) < MANY_FILES:
        workers = 1
    return map_tasks(function, paths, shared=shared, workers=workers, scheduler=scheduler, done=done)


def _map_beside(
    workers: int,
    function: Callable[[Shared, Item], Result],
    items: Sequence[Item],
    shared: Shared,
    finished: Callable[[int, Result], None],
) -> None:
    """In so many processes of our own, which are reached by pipes: nothing listens on the network."""
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers,
        # A process that is forked has the locks of threads that it does not have.
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        # By value where a function has no name by which to import it.
        initargs=(cloudpickle.dumps((function, shared)),),
    )
    try:
        with _undisturbed(), _environment(_ONE_THREAD):
            index = {pool.submit(_work, item): k for k, item in enumerate(items)}
        futures = list(index)
        for future in as_completed(futures):
            if future.exception() is not None:
                # Of several that fail, the first of the items is reported, not the first in time.
                for earlier in futures[: index[future] + 1]:
                    earlier.result()
            finished(index[future], future.result())
        pool.shutdown()
    except BrokenProcessPool as error:
        raise ParallelError("a worker ended before its task did") from error
    finally:
        # After an error or Ctrl-C nobody waits for what the others are about to do.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
            process.join()


# Of a process beside, what it was begun with: the function and what its tasks share.
_begun: list[tuple[Callable[[Any, Any], Any], Any]] = []


def _begin(task: bytes) -> None:
    """Begin a process beside, which ends with the process that began it, however that ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _begun.append(cloudpickle.loads(task))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(item: Any) -> Any:
    ((function, shared),) = _begun
    return function(shared, item)


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Variables that processes begun in the block have."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _map_on(
    client: Any,
    function: Callable[[Shared, Item], Result],
    items: Sequence[Item],
    shared: Shared,
    finished: Callable[[int, Result], None],
) -> None:
    from distributed import KilledWorker
    from distributed import as_completed as completed

    # Not by hash: Dask would take equal arguments of another call for this one's.
    sent = client.scatter(shared, broadcast=True, hash=False)
    futures = [client.submit(function, sent, item, pure=False) for item in items]
    index = {future.key: k for k, future in enumerate(futures)}
    try:
        outcomes = completed(futures, loop=client.loop, with_results=True, raise_errors=False)
        for future, result in outcomes:
            if future.cancelled():
                raise ParallelError("all workers were lost, with what they had been sent")
            if future.status == "error":
                # Of several that fail, the first of the items is reported, not the first in time.
                for earlier in futures[: index[future.key] + 1]:
                    earlier.result()
            finished(index[future.key], result)
    except KilledWorker as error:
        raise ParallelError(f"a worker ended before its task did: {one_line(error)}") from error
    finally:
        client.cancel(futures)


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler."""
    # Slow to import, and few commands need it.
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ParallelError(f"--scheduler {scheduler}: no scheduler answers: {one_line(error)}") from error
    with client:
        _require_workers(client, scheduler)
        yield client


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Signals wait for the end of the block, and processes begun in it never see Ctrl-C.

    A process that is only beginning cannot be cleared away, and a terminal sends Ctrl-C to all processes.
    """
    waiting: list[int] = []
    handler = None
    if threading.current_thread() is threading.main_thread():
        handler = signal.signal(signal.SIGTERM, lambda number, _frame: waiting.append(number))
    # As it starts, with the first process, it would lift the mask.
    resource_tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if handler is not None:
            signal.signal(signal.SIGTERM, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number in waiting:
            signal.raise_signal(number)


def _require_workers(client: Any, scheduler: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_ANSWER_S)
    except TimeoutError as error:
        raise ParallelError(f"--scheduler {scheduler}: has no workers") from error
    for worker, version in client.run(_version, on_error="return").items():
        if version != __version__:
            found = f"cannot run quadpi: {one_line(version)}" if isinstance(version, Exception) else version
            raise ParallelError(f"--scheduler {scheduler}: worker {worker}: {found}, not {__version__}")


def _version() -> str:
    return __version__
