# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Independent tasks here, in processes, and on a cluster of two workers that is known by its address."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest

from quadpi_core import parallel
from quadpi_core.errors import LogError
from quadpi_core.parallel import ParallelError, Workers
from quadpi_core.paths import bags_directory

pytestmark = pytest.mark.slow

ROOT = Path(parallel.__file__).parents[1]
BAGS = ("extrapolation", "interpolation")


@pytest.fixture(scope="module")
def tasks():
    """Tasks that travel by value: workers cannot import the modules of the tests."""

    def scaled(factor, item):
        return factor * item

    def slow_first(_, item):
        time.sleep(0.5 if item == 0 else 0.0)
        return item

    def refuse(_, item):
        if item == 1:
            raise LogError("b.mcap: topic imu: sample 3: not finite")
        return item

    def refuse_late(_, item):
        time.sleep(0.5 if item == 1 else 0.0)
        if item:
            raise LogError(f"{item}.mcap: the file is empty")

    def process(folder, _item):
        """Waits, where a folder is given, until a second process is at work too."""
        if folder is not None:
            (folder / str(os.getpid())).touch()
            until = time.monotonic() + 60.0
            while len(list(folder.iterdir())) < 2 and time.monotonic() < until:
                time.sleep(0.01)
        return os.getpid()

    def refuse_at_work(_, item):
        """Refuses once the other task has ended, whose worker waits for more."""
        if item:
            time.sleep(0.5)
            raise LogError("the file is empty")
        return os.getpid()

    def wait(seconds, item):
        time.sleep(seconds)
        return item

    def variable(_, name):
        return os.environ.get(name)

    def die(_, _item):
        os.kill(os.getpid(), signal.SIGKILL)

    return SimpleNamespace(**locals())


@pytest.fixture(params=["here", "processes", "cluster"])
def place(request):
    if request.param == "cluster":
        return Workers(scheduler=request.getfixturevalue("cluster"))
    return Workers(1 if request.param == "here" else 2)


def test_results_are_in_the_order_of_the_items(tasks, place):
    assert place.map(tasks.scaled, [3, 1, 2], shared=10) == [30, 10, 20]
    done = {}
    assert place.map(tasks.slow_first, [0, 1, 2], shared=None, done=done.__setitem__) == [0, 1, 2]
    assert done == {0: 0, 1: 1, 2: 2}


def test_known_errors_come_back_as_they_are(tasks, place):
    with pytest.raises(LogError, match=r"^b.mcap: topic imu: sample 3: not finite$"):
        place.map(tasks.refuse, [0, 1, 2], shared=None)


def test_of_several_that_fail_the_first_item_is_reported(tasks, place):
    with pytest.raises(LogError, match=r"^1.mcap: the file is empty$"):
        place.map(tasks.refuse_late, [0, 1, 2, 3], shared=None)


def test_nothing_to_do_needs_no_workers(tasks):
    assert Workers(scheduler="tcp://127.0.0.1:1").map(tasks.scaled, [], shared=1) == []


def test_processes_are_others_and_cluster_workers_are_used(tasks, cluster, tmp_path):
    assert set(Workers(1).map(tasks.process, range(2), shared=None)) == {os.getpid()}
    for name, workers in (("processes", Workers(2)), ("cluster", Workers(scheduler=cluster))):
        (tmp_path / name).mkdir()
        used = set(workers.map(tasks.process, range(8), shared=tmp_path / name))
        assert len(used - {os.getpid()}) == 2


def test_threads_that_start_workers_at_once_do_not_end_those_of_each_other(tasks):
    before, main = dict(os.environ), vars(sys.modules["__main__"]).get("__file__")

    def done(seconds):
        return Workers(2).map(tasks.wait, [1, 2, 3], shared=seconds)

    with ThreadPoolExecutor(3) as threads:
        assert list(threads.map(done, [0.0, 1.0, 2.0])) == 3 * [[1, 2, 3]]
    assert (dict(os.environ), vars(sys.modules["__main__"]).get("__file__")) == (before, main)


def test_of_workers_that_cannot_all_be_started_none_is_left(tasks, monkeypatch):
    sent, before = [], set(multiprocessing.active_children())

    def submit(pool, *task, submit=ProcessPoolExecutor.submit):
        sent.append(task)
        if len(sent) == 3:
            raise OSError("no more processes")
        return submit(pool, *task)

    monkeypatch.setattr(ProcessPoolExecutor, "submit", submit)
    with pytest.raises(OSError, match="no more processes"):
        Workers(3).map(tasks.wait, [1, 2, 3], shared=60.0)
    # One whose end the pool's thread notes at this moment may be listed still.
    assert not any(alive(worker.pid) for worker in set(multiprocessing.active_children()) - before)


def test_a_worker_has_one_thread(tasks):
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"]
    assert Workers(2).map(tasks.variable, names, shared=None) == ["1"] * len(names)


def test_no_scheduler_is_said(tasks):
    for address in ("tcp://127.0.0.1:1", "nowhere"):
        with pytest.raises(ParallelError, match=f"--scheduler {address}: no scheduler answers"):
            Workers(scheduler=address, answer_s=1.0).map(tasks.scaled, [1], shared=1)


def test_no_workers_are_said(tasks):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as empty,
        pytest.raises(ParallelError, match="has no workers"),
    ):
        # Enough for the scheduler itself to answer on a busy machine.
        Workers(scheduler=empty.scheduler_address, answer_s=5.0).map(tasks.scaled, [1], shared=1)


def test_a_scheduler_needs_the_extra(tasks, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(LogError, match=r"pip install quadpi-monitor\[cluster\]"):
        Workers(scheduler="tcp://127.0.0.1:1").map(tasks.scaled, [1], shared=1)


def test_a_scheduler_has_thirty_seconds_to_answer(tasks, monkeypatch):
    pytest.importorskip("distributed")
    given = []

    def unanswered(*_, timeout, **__):
        given.append(timeout)
        raise OSError("timed out")

    monkeypatch.setattr("distributed.Client", unanswered)
    with pytest.raises(ParallelError, match="no scheduler answers: timed out"):
        Workers(scheduler="tcp://127.0.0.1:1").map(tasks.scaled, [1], shared=1)
    assert given == [30.0]


def test_workers_of_another_version_are_refused(tasks, monkeypatch, cluster):
    monkeypatch.setattr(parallel, "__version__", "0.0.other")
    with pytest.raises(ParallelError, match=r"worker tcp://\S+: \d\S+, not 0.0.other"):
        Workers(scheduler=cluster).map(tasks.scaled, [1], shared=1)


def test_a_worker_that_dies_is_said(tasks):
    with pytest.raises(ParallelError, match=r"^a worker ended before its task did$"):
        Workers(2).map(tasks.die, [1, 2], shared=None)


def test_a_worker_of_a_cluster_that_dies_is_said(tasks):
    dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, dashboard_address="127.0.0.1:0") as fragile,
        pytest.raises(ParallelError, match=r"^a worker ended before its task did: .+$"),
    ):
        Workers(scheduler=fragile.scheduler_address).map(tasks.die, [1], shared=None)


def test_no_worker_is_left(tasks):
    used = Workers(2).map(tasks.process, range(4), shared=None)
    assert not any(alive(worker) for worker in used)
    used.clear()
    with pytest.raises(LogError):
        Workers(2).map(tasks.refuse_at_work, [0, 1], shared=None, done=lambda _, worker: used.append(worker))
    assert len(used) == 1
    assert not alive(used[0])


def test_processes_beside_open_no_port():
    def listening(_, process):
        """Sockets that a process listens on; 0: this one."""
        tables = [Path(f"/proc/net/{name}").read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
        waiting = {
            f"socket:[{row.split()[9]}]" for table in tables for row in table if row.split()[3] == "0A"
        }
        found = set()
        for file in Path(f"/proc/{process or os.getpid()}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):
                found.add(str(file.readlink()))
        return found & waiting

    # The fixture `cluster` may listen in this process already.
    before = listening(None, 0)
    assert Workers(2).map(listening, [0, os.getpid()], shared=None) == [set(), before]


def test_processes_beside_end_with_a_run_that_is_killed(tmp_path):
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, time\n"
        "from quadpi_core.parallel import Workers\n"
        "def wait(_, _item):\n"
        "    print(os.getpid(), flush=True)\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    Workers(2).map(wait, [1, 2], shared=None)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment
    ) as run:
        workers = [int(run.stdout.readline()) for _ in range(2)]
        run.kill()
        # The pipe ends with the last process that holds it.
        assert run.stdout.read() == ""
    assert not any(Path(f"/proc/{worker}/cmdline").is_file() and alive(worker) for worker in workers)


def test_the_program_that_colcon_installs_has_workers(tmp_path):
    """Each worker reads the file of the program that began it."""
    program, bags = ROOT / "tools" / "quadpi", [bags_directory() / f"{name}.mcap" for name in BAGS]
    subprocess.run(
        [sys.executable, program, "import", *bags, "--vehicle", "bebop2", "--workers", "2", "-o", tmp_path],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    assert {bag.name for bag in bags} == {path.name for path in tmp_path.iterdir()}


def alive(process):
    """Whether a process is more than an entry that nobody has waited for."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False


def test_a_script_without_a_guard_is_not_run_again_by_its_workers(tmp_path):
    script = tmp_path / "mine.py"
    bags = str(bags_directory() / "*polation.mcap")
    script.write_text(
        "import quadpi_core as qp\n"
        f"print(len(qp.load_flights({bags!r}, vehicle='bebop2', workers=2)), __file__)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == (f"2 {script}\n", 0), done.stderr


def test_items_of_a_class_of_the_script_reach_its_workers(tmp_path):
    script = tmp_path / "mine.py"
    script.write_text(
        "import operator\nfrom quadpi_core.parallel import Workers\nclass Mine: pass\n"
        "if __name__ == '__main__':\n"
        "    print(Workers(2).map(operator.is_, [Mine(), Mine()], shared=None))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("[False, False]\n", 0), done.stderr
