# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM: one line, a status that tells, and every folder as it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import quadpi_core
from benchmarks.fuzzing.flight_logs import dataflash, hover
from quadpi_core.paths import bags_directory, whole_output

# A command that says on its output when it has come somewhere. A step of the work is one of training, or a
# flight or chunk that workers have finished; after it the work waits, or goes on.
COMMAND = """
import sys, time
from quadpi_core import parallel
from quadpi_core.models import ensemble
from quadpi_core.cli import main

def announced(step, waits):
    def announce(*arguments):
        result = step(*arguments)
        print("working", flush=True)
        time.sleep(waits)
        return result
    return announce

ensemble.training_progress = announced(ensemble.training_progress, waits=0.0)
map_tasks = parallel.Workers.map
def announced_tasks(*arguments, done=lambda *_: None, **options):
    return map_tasks(*arguments, done=announced(done, waits=60.0), **options)
parallel.Workers.map = announced_tasks
main()
"""
KEPT = "finished realisations are kept, and the next run resumes from them"
INTERRUPTED = "quadpi: interrupted; nothing is half written\n"


@pytest.fixture
def interrupted():
    """interrupted(number, command, …) → exit status and errors of a command that was at work."""

    def run(number, *arguments):
        with subprocess.Popen(
            [sys.executable, "-c", COMMAND, *map(str, arguments)],
            env=os.environ | {"PYTHONPATH": str(Path(quadpi_core.__file__).parents[1])},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            first = process.stdout.readline()
            # A terminal sends Ctrl-C to workers as well, others send SIGTERM to one process.
            if number == signal.SIGINT:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
            output, errors = process.communicate()
        assert first == "working\n", errors
        assert set(output.splitlines()) <= {"working"}
        return process.returncode, errors

    return run


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "number", "status"),
    [("bootstrap", signal.SIGINT, 130), ("quality-driven", signal.SIGTERM, 143)],
    ids=["Ctrl-C", "SIGTERM"],
)
def test_training_leaves_the_model_that_stood_there(
    quadpi, interrupted, bags, tmp_path, method, number, status
):
    pytest.importorskip("torch")
    options = ("--vehicle", "neurobem", "--axes", "Fx", "-o", tmp_path / "model")
    assert quadpi("identify", *bags[:2], *options, "--method", "polynomial").status == 0
    before = contents(tmp_path)
    page = ("--json", tmp_path / "data.json", "--html", tmp_path / "page.html")
    ran = interrupted(number, "identify", *bags, *options, "--method", method, *page)
    assert ran == (status, INTERRUPTED)
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_workers_end_quietly(interrupted, bags, tmp_path):
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "flight0.mcap").write_text("mine")
    before = contents(tmp_path)
    options = ("--vehicle", "neurobem", "-o", tmp_path / "bags", "--workers", 2)
    assert interrupted(signal.SIGINT, "import", *bags, *options) == (130, INTERRUPTED)
    assert contents(tmp_path) == before


def test_a_log_that_is_being_read(tmp_path):
    """40 MB of records, which take seconds; the signal comes as soon as there is a temporary folder."""
    log = tmp_path / "long.BIN"
    flight = dataflash(hover(200))
    log.write_bytes(flight * (40_000_000 // len(flight)))
    before = contents(tmp_path)
    command = ("import", log, "--vehicle", "neurobem", "-o", tmp_path / "bags")
    with subprocess.Popen(
        [sys.executable, "-m", "quadpi_core.cli", *map(str, command)],
        env=os.environ | {"PYTHONPATH": str(Path(quadpi_core.__file__).parents[1])},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while process.poll() is None and list(tmp_path.iterdir()) == [log]:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate()
    assert (process.returncode, errors) == (143, INTERRUPTED)
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_realisations_that_are_finished_are_kept(quadpi, interrupted, tmp_path):
    train_1, train_2, flight = (
        bags_directory() / f"{name}.mcap" for name in ("train_1", "train_2", "interpolation")
    )
    model, kept = tmp_path / "model", tmp_path / "kept"
    identified = quadpi("identify", train_1, train_2, "--vehicle", "bebop2", "--axes", "Fx", "-o", model)
    assert identified.status == 0
    options = ("-o", kept, "--realisations", 10, "--workers", 1)
    status, errors = interrupted(signal.SIGINT, "validate", model, flight, *options)
    assert (status, errors) == (130, f"quadpi: interrupted; {KEPT}\n")
    assert [path.name for path in kept.rglob("*.npz")] == ["000000-000005.npz"]
    assert not [path for path in tmp_path.rglob(".*") if path.exists()]


def test_a_folder_that_was_about_to_be_replaced_is_there_again(tmp_path, monkeypatch):
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "old").write_text("old")

    rename, interrupted = Path.rename, []

    def interrupt(path, target):
        if target == folder and not folder.exists() and not interrupted:
            interrupted.append(path)
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", interrupt)
    with pytest.raises(KeyboardInterrupt), whole_output(folder) as temporary:
        temporary.mkdir()
    assert interrupted
    assert contents(tmp_path) == {folder: None, folder / "old": b"old"}
