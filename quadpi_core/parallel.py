# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Independent tasks: in this process, in other processes, or on a Dask cluster; and their progress.

Not by joblib (1.6): its workers outlive a parent that is killed, it stops at the first error in time rather
than of the items, begins 0.8 s later, and its Dask backend waits for ever for a worker that is lost.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from quadpi_core.config_schema import is_config_path
from quadpi_core.errors import QuadpiError, one_line, require_library
from quadpi_core.reading_options import MappingOrOptions, ReadingOptions, reading_options
from quadpi_core.version import __version__

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

# One task per core: threads within a task would only take cores from other tasks.
_ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
# Environment and main module belong to all threads, and which processes are whose shows as they start.
_STARTS = threading.Lock()


class ParallelError(QuadpiError):
    """Workers cannot be reached, cannot run quadpi, or ended before their task did."""


@dataclass(frozen=True)
class Progress:
    """How far a long computation is.

    Attributes:
        task: what is being done, such as "Reading flights".
        done: number of steps that are finished.
        total: number of steps; None where it is unknown.
        unit: of the steps.
        note: what else is known, such as the loss of a training.
    """

    task: str
    done: float = 0
    total: float | None = None
    unit: str = ""
    note: str = ""


ReportProgress = Callable[[Progress], None]


def ignore_progress(_: Progress) -> None:
    """Report progress to nobody."""


@dataclass(frozen=True)
class Workers:
    """Where independent tasks run, and where their progress is reported.

    Attributes:
        count: processes on this machine; one means this process. Default: one per core, but this process for
            the files of fewer than 64 flights.
        scheduler: address of a Dask scheduler whose workers do the tasks instead. They must run the same
            version of quadpi; files are only found where they share the file system.
        progress: called in this process as tasks finish.
        answer_s: seconds after which a scheduler that does not answer, or has no workers, is given up: Dask
            needs a few on a busy cluster, and a wrong address should not hold a user for minutes.
    """

    count: int | None = None
    scheduler: str | None = None
    progress: ReportProgress = ignore_progress
    answer_s: float = 30.0

    def found_by(self, mapping: MappingOrOptions) -> ReadingOptions:
        """The options with the absolute path of the mapping file, for remote workers."""
        options = reading_options(mapping)
        if self.scheduler is None or options.mapping is None or not is_config_path(options.mapping):
            return options
        return replace(options, mapping=str(Path(options.mapping).absolute()))

    def map(
        self,
        function: Callable[[Shared, Item], Result],
        items: Sequence[Item],
        *,
        shared: Shared,
        done: Callable[[int, Result], None] = lambda _index, _result: None,
    ) -> list[Result]:
        """Results of `function(shared, item)`, in the order of the items, wherever they run.

        Args:
            function: of a module, by whose name a worker finds it.
            items: one per task.
            shared: what all tasks need; each worker gets it once.
            done: called in this process with the index and the result of each task, as they finish.

        Raises:
            ParallelError: for a scheduler that does not answer, has no workers, or has workers with no or
                another quadpi; and when a worker is lost for good.
        """
        results: list[Any] = [None] * len(items)

        def finished(index: int, result: Result) -> None:
            results[index] = result
            done(index, result)

        count = min(self.count or os.cpu_count() or 1, len(items))
        if self.scheduler is None and count <= 1:
            for index, item in enumerate(items):
                finished(index, function(shared, item))
        elif items and self.scheduler is None:
            _map_in_processes(count, function, items, shared, finished)
        elif items:
            distributed = require_library("distributed", "cluster")
            with _client(distributed, str(self.scheduler), self.answer_s) as client:
                _map_on_cluster(distributed, client, function, items, shared, finished)
        return results


DEFAULT_WORKERS = Workers()


def _map_in_processes(
    workers: int,
    function: Callable[[Shared, Item], Result],
    items: Sequence[Item],
    shared: Shared,
    finished: Callable[[int, Result], None],
) -> None:
    """In processes of our own, which are reached by pipes: nothing listens on the network."""
    task = _pickled((function, shared))
    of_main = b"__main__" in task or b"__main__" in _pickled(items)
    pool = ProcessPoolExecutor(
        workers,
        # A forked process inherits locks held by threads that it does not have.
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_set_up,
        initargs=(task,),
    )
    own: set[Any] = set()
    try:
        with _STARTS, _signals_deferred(), _started_with(of_main):
            before = set(multiprocessing.active_children())
            try:
                index = {pool.submit(_work, item): k for k, item in enumerate(items)}
            finally:
                own = set(multiprocessing.active_children()) - before
        for future in as_completed(index):
            if future.exception() is not None:
                # Of several that fail, the first of the items is reported, not the first in time.
                for earlier in list(index)[: index[future] + 1]:
                    earlier.result()
            finished(index[future], future.result())
        pool.shutdown()
    except BrokenProcessPool as error:
        raise ParallelError("a worker ended before its task did") from error
    finally:
        # After an error or Ctrl-C nobody waits for what the others are about to do.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in own:
            process.kill()
            process.join()


def _pickled(task: Any) -> bytes:
    """A task for another process; what has no name to import it by, such as a function in one, by value."""
    with suppress(pickle.PicklingError, AttributeError, TypeError):
        by_name = pickle.dumps(task)
        # Other processes import the main module too, if it has a file.
        if b"__main__" not in by_name or hasattr(sys.modules["__main__"], "__file__"):
            return by_name
    return require_library("cloudpickle", "cluster").dumps(task)


# In a worker process: the function, and what its tasks share.
_task: list[tuple[Callable[[Any, Any], Any], Any]] = []


def _set_up(task: bytes) -> None:
    """Set up a worker process, which ends when its parent does, however that ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _task.append(pickle.loads(task))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(item: Any) -> Any:
    ((function, shared),) = _task
    return function(shared, item)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread of BLAS in the block, whose products are so small that two threads take twice the time."""
    # Imported here, as live nodes have no such block.
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


@contextmanager
def _started_with(main_module: bool) -> Iterator[None]:
    """Processes started in the block have one thread, and import the main module only where they need it."""
    # A user's script without `if __name__ == "__main__"` would otherwise run again in each, and end it.
    main = {} if main_module else dict.fromkeys(("__spec__", "__file__"))
    there: Any = ((os.environ, _ONE_THREAD), (vars(sys.modules["__main__"]), main))
    before = [{name: names[name] for name in given if name in names} for names, given in there]
    for names, given in there:
        names.update(given)
    try:
        yield
    finally:
        for (names, given), kept in zip(there, before, strict=True):
            for name in given:
                del names[name]
            names.update(kept)


def _map_on_cluster(
    distributed: ModuleType,
    client: Any,
    function: Callable[[Shared, Item], Result],
    items: Sequence[Item],
    shared: Shared,
    finished: Callable[[int, Result], None],
) -> None:
    # Not by hash: Dask would take equal arguments of another call for this one's.
    sent = client.scatter(shared, broadcast=True, hash=False)
    futures = [client.submit(function, sent, item, pure=False) for item in items]
    index = {future.key: k for k, future in enumerate(futures)}
    try:
        outcomes = distributed.as_completed(futures, loop=client.loop, with_results=True, raise_errors=False)
        for future, result in outcomes:
            if future.cancelled():
                raise ParallelError("all workers were lost, with what they had been sent")
            if future.status == "error":
                for earlier in futures[: index[future.key] + 1]:
                    earlier.result()
            finished(index[future.key], result)
    except distributed.KilledWorker as error:
        raise ParallelError(f"a worker ended before its task did: {one_line(error)}") from error
    finally:
        client.cancel(futures)


@contextmanager
def _client(distributed: ModuleType, scheduler: str, answer_s: float) -> Iterator[Any]:
    """A client of the scheduler."""
    try:
        client = distributed.Client(scheduler, timeout=answer_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ParallelError(f"--scheduler {scheduler}: no scheduler answers: {one_line(error)}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=answer_s)
        except TimeoutError as error:
            raise ParallelError(f"--scheduler {scheduler}: has no workers") from error
        for worker, said in client.run(_version, on_error="return").items():
            if said != __version__:
                found = f"cannot run quadpi: {one_line(said)}" if isinstance(said, Exception) else said
                raise ParallelError(f"--scheduler {scheduler}: worker {worker}: {found}, not {__version__}")
        yield client


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defer signals to the end of the block; processes started in it never see Ctrl-C.

    A process that is still starting cannot be cleaned up, and a terminal sends Ctrl-C to all processes.
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


def _version() -> str:
    return __version__
