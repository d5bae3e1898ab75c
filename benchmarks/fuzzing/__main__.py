# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`make fuzz`: damaged input for every reader, in worker processes; exit status 1 if anything was found.

A case that crashes, or exceeds SECONDS_MAX of processor time, ends only the worker that runs it.
"""

from __future__ import annotations

import argparse
import logging
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NamedTuple

from benchmarks.fuzzing import api_calls
from benchmarks.fuzzing.cases import MEMORY_MAX, SECONDS_MAX, Outcome, judge, make, parse_case, peak_bytes
from benchmarks.fuzzing.formats import FORMATS

_BATCH = 100
_SHOWN_PER_FORMAT = 10
# Wall time of a batch beyond its processor time, after which a worker counts as hanging.
_WAIT_MAX_S = 120.0


class Batch(NamedTuple):
    """Consecutive cases of one format."""

    name: str
    seed: int
    first: int
    cases: int


@dataclass
class Tally:
    """Results of the cases of one format."""

    kinds: Counter[str] = field(default_factory=Counter)
    findings: list[tuple[str, Outcome]] = field(default_factory=list)
    seconds: float = 0.0


def _work(pipe: Connection, place: multiprocessing.sharedctypes.Synchronized[int], folder: str) -> None:
    """Judge the batches that arrive on the pipe; `place` is the number of the running case."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while (batch := pipe.recv()) is not None:
        form, found, kinds = FORMATS[batch.name], [], Counter[str]()
        started = time.process_time()
        for number in range(batch.first, batch.first + batch.cases):
            place.value = number
            data = make(form, batch.seed, number)
            signal.setitimer(signal.ITIMER_PROF, SECONDS_MAX)
            outcome = judge(form, data, number, Path(folder))
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            kinds[outcome.kind] += 1
            if outcome.is_finding:
                found.append((f"{batch.name}:{batch.seed}:{number}", outcome))
            if outcome.kind == "memory":
                break  # the peak never falls: a new process continues
        done = number + 1 - batch.first
        pipe.send((kinds, found, done, time.process_time() - started, peak_bytes()))


class Worker:
    """A process, its batch, and the case that it is at."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("fork")
        self.folder = tempfile.TemporaryDirectory(prefix="quadpi.fuzz.", dir=_fast_folder())
        self.place = context.Value("q", 0, lock=False)
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, self.place, self.folder.name), daemon=True)
        self.process.start()
        theirs.close()
        self.batch: Batch | None = None
        self.since = time.monotonic()

    def give(self, batch: Batch | None) -> None:
        """Start a batch, or end with None."""
        self.batch, self.since = batch, time.monotonic()
        self.pipe.send(batch)

    def close(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.join()
        self.folder.cleanup()


def _fast_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def batches(cases: int, seed: int, names: list[str]) -> list[Batch]:
    """All cases in batches, formats interleaved, so that an interrupted run has tried all of them."""
    total = sum(FORMATS[name].share for name in names)
    ordered = []
    for name in names:
        count = max(round(cases * FORMATS[name].share / total), 1)
        for first in range(0, count, _BATCH):
            batch = Batch(name, seed, first, min(_BATCH, count - first))
            ordered.append((first / count, batch))
    return [batch for _, batch in sorted(ordered)]


class Run:
    """Distributes batches to workers until all are done or the time is over."""

    def __init__(self, work: list[Batch], workers: int, seconds: float) -> None:
        self.tallies: dict[str, Tally] = {}
        self.peak = 0
        self._work = work[::-1]
        self._until = time.monotonic() + seconds
        self._workers = workers

    def go(self) -> None:
        """Run all batches."""
        workers = [Worker() for _ in range(self._workers)]
        try:
            for worker in workers:
                self._next(worker)
            while any(worker.batch for worker in workers):
                busy = [worker for worker in workers if worker.batch]
                ready = wait([worker.pipe for worker in busy], timeout=1.0)
                for worker in busy:
                    if worker.pipe in ready:
                        self._take(workers, worker)
                    elif time.monotonic() - worker.since > _WAIT_MAX_S + SECONDS_MAX * _BATCH:
                        worker.process.kill()
        finally:
            for worker in workers:
                worker.close()

    def _next(self, worker: Worker) -> None:
        """Give a worker the next batch, if there are time and work left."""
        if self._work and time.monotonic() < self._until:
            worker.give(self._work.pop())
        else:
            worker.batch = None

    def _take(self, workers: list[Worker], worker: Worker) -> None:
        """Collect the results of a worker; a dead one is replaced and continues after the fatal case."""
        assert worker.batch is not None
        batch = worker.batch
        tally = self.tallies.setdefault(batch.name, Tally())
        try:
            kinds, found, done, seconds, peak = worker.pipe.recv()
        except (EOFError, ConnectionResetError):
            done = worker.place.value + 1 - batch.first
            worker.process.join()
            code = worker.process.exitcode or 0
            kind = "hang" if code in {-signal.SIGPROF, -signal.SIGKILL} else "crash"
            name = signal.Signals(-code).name if code < 0 else f"status {code}"
            outcome = Outcome(kind, f"the process ended by {name}")
            kinds, found = (
                Counter({kind: 1, "read": done - 1}),
                [(f"{batch.name}:{batch.seed}:{worker.place.value}", outcome)],
            )
            seconds, peak = 0.0, 0
        tally.kinds += kinds
        tally.findings += found
        tally.seconds += seconds
        self.peak = max(self.peak, peak)
        if done < batch.cases:
            self._work.append(batch._replace(first=batch.first + done, cases=batch.cases - done))
        if not worker.process.is_alive() or kinds["memory"]:
            worker.close()
            workers[workers.index(worker)] = worker = Worker()
        self._next(worker)


def summary(run: Run) -> str:
    """One line per format, then the findings."""
    lines = [f"{'format':14} {'cases':>9} {'read':>9} {'refused':>9} {'found':>6} {'per s':>7}"]
    for name, tally in sorted(run.tallies.items()):
        cases = tally.kinds.total()
        found = cases - tally.kinds["read"] - tally.kinds["refused"]
        rate = cases / tally.seconds if tally.seconds else 0.0
        lines.append(
            f"{name:14} {cases:9} {tally.kinds['read']:9} {tally.kinds['refused']:9} {found:6} {rate:7.0f}"
        )
    every = sum((tally.kinds for tally in run.tallies.values()), Counter[str]())
    wrong = sorted((kind, count) for kind, count in every.items() if kind not in {"read", "refused"})
    lines.append(
        f"{every.total()} cases, {every['read']} read, {every['refused']} refused in one line; "
        f"found: {', '.join(f'{count} {kind}' for kind, count in wrong) or 'nothing'}; "
        f"peak memory {run.peak / 2**20:.0f} MiB"
    )
    for _, tally in sorted(run.tallies.items()):
        shown: Counter[str] = Counter()
        for case, outcome in tally.findings:
            shown[outcome.detail[-60:]] += 1
            if shown[outcome.detail[-60:]] == 1 and len(shown) <= _SHOWN_PER_FORMAT:
                lines.append(f"{case}: {outcome.kind}: {outcome.detail[:400]}")
    return "\n".join(lines)


def warm_up(names: list[str]) -> None:
    """Import what the readers need before forking the workers, then bound their memory."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        for form in (FORMATS[name] for name in names):
            for number in range(4):
                judge(form, make(form, 0, number), number, Path(folder))
    if "api" in names:
        api_calls.warm_up(api_calls.calls())
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + 12 * MEMORY_MAX, resource.RLIM_INFINITY))


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1_000_000, help="over all formats")
    parser.add_argument("--minutes", type=float, default=20.0, help="after which no batch is started")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--formats", nargs="+", choices=list(FORMATS), default=list(FORMATS))
    parser.add_argument(
        "--case", help="one case by format:seed:number: write it to --output and judge it here"
    )
    parser.add_argument("--output", type=Path, help="file for the bytes of --case")
    options = parser.parse_args()
    if options.case:
        form, seed, number = parse_case(options.case)
        data = make(form, seed, number)
        if options.output:
            options.output.write_bytes(data)
        with tempfile.TemporaryDirectory() as folder:
            outcome = judge(form, data, number, Path(folder))
        print(f"{options.case}: {len(data)} bytes: {outcome.kind} {outcome.detail}")
        return int(outcome.is_finding)
    warm_up(options.formats)
    run = Run(batches(options.cases, options.seed, options.formats), options.workers, 60.0 * options.minutes)
    run.go()
    print(summary(run))
    return int(any(tally.findings for tally in run.tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
