# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`make fuzz` in short; what it found before, again; and that it finds what it looks for."""

import faulthandler
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("pandas", reason="pandas is not installed")
pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")

from benchmarks.fuzzing import api_calls
from benchmarks.fuzzing.__main__ import Run, batches, summary
from benchmarks.fuzzing.cases import judge, make, parse_case
from benchmarks.fuzzing.formats import FORMATS, Format
from quadpi_core.errors import LogError

ROOT = Path(__file__).parents[2]
# Each file is named by its format and by what it did before that was mended.
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


@pytest.mark.slow
def test_a_few_cases_of_every_format():
    command = (sys.executable, "-m", "benchmarks.fuzzing", "--cases", "500", "--workers", "1")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "found: nothing" in done.stdout
    for name in FORMATS:
        assert f"\n{name} " in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("name", "cases"), [("mcap", 40), ("configuration", 240)])
def test_damaged_files(name, cases, tmp_path):
    for number in range(cases):
        outcome = judge(FORMATS[name], make(FORMATS[name], 1, number), number, tmp_path)
        assert not outcome.is_finding, (number, outcome)


@pytest.mark.parametrize("file", CORPUS, ids=lambda file: file.name)
def test_what_was_found_before(file, tmp_path):
    for number in range(4):
        outcome = judge(FORMATS[file.name.split(".")[0]], file.read_bytes(), number, tmp_path)
        assert not outcome.is_finding, (number, outcome)


def test_the_corpus_is_small():
    assert all(file.stat().st_size < 20_000 for file in CORPUS)
    assert sum(file.stat().st_size for file in CORPUS) < 200_000


@pytest.mark.parametrize("name", FORMATS)
def test_a_case_is_the_same_each_time(name):
    form, seed, number = parse_case(f"{name}:3:7")
    assert make(form, seed, number) == make(form, seed, number)
    assert len({make(form, seed, number) for number in range(20)}) > 10


def test_every_public_call_is_fuzzed():
    """A new name or method needs an entry, whose name may go on behind a comma."""
    known = {name.partition(",")[0] for name in api_calls.calls()}
    assert set(api_calls.public_calls()) <= known
    assert {"Monitor.step", "AerodynamicModel.evaluate", "judge"} <= set(api_calls.public_calls())


def run_of_calls(monkeypatch, cases):
    make = partial(api_calls.make_call, known_calls=api_calls.array_calls)
    form = Format("calls", 1.0, make, api_calls.read_call, ".call", names_file=False)
    monkeypatch.setitem(FORMATS, "calls", form)
    api_calls.warm_up(api_calls.array_calls())
    run = Run(batches(cases, 0, ["calls"]), 1, 120.0)
    run.go()
    return run.tallies["calls"]


def test_a_few_calls_of_the_library(monkeypatch):
    tally = run_of_calls(monkeypatch, 400)
    assert tally.findings == []
    assert min(tally.kinds["read"], tally.kinds["refused"]) > 100


@pytest.mark.slow
def test_many_calls_of_the_library():
    refused = [name for name in api_calls.calls() if api_calls.clean_result(name) is None]
    assert refused == ["study"]
    command = (sys.executable, "-m", "benchmarks.fuzzing", "--cases", "3000", "--formats", "api")
    done = subprocess.run((*command, "--workers", "1"), cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3000 cases" in done.stdout


def test_calls_that_read_past_an_array_are_found(monkeypatch):
    """Without the check of rows, arrays that do not fit each other give a crash, or pass."""
    monkeypatch.setattr("quadpi_core.array_checks._require_shape", lambda *_: None)
    kinds = {outcome.kind for _, outcome in run_of_calls(monkeypatch, 300).findings}
    assert kinds & {"crash", "passed"}


def crash():
    faulthandler.disable()
    os.kill(os.getpid(), signal.SIGSEGV)


def refuse_without_a_name():
    raise LogError("damaged")


def overflow():
    raise OverflowError("int too large")


def hang():
    while True:
        pass


@pytest.mark.parametrize(
    ("misbehave", "kind"),
    [(crash, "crash"), (refuse_without_a_name, "unnamed"), (overflow, "traceback"), (hang, "hang")],
)
def test_it_finds(monkeypatch, misbehave, kind):
    """Case 103 misbehaves; all others are judged all the same."""

    def read(_, number):
        if number == 103:
            misbehave()

    monkeypatch.setattr("benchmarks.fuzzing.__main__.SECONDS_MAX", 0.5)
    monkeypatch.setitem(FORMATS, "bad", Format("bad", 1.0, lambda rng: rng.randbytes(3), read, ".bad"))
    run = Run(batches(250, 0, ["bad"]), 1, 60.0)
    run.go()
    tally = run.tallies["bad"]
    assert tally.kinds == {"read": 249, kind: 1}
    assert [case for case, _ in tally.findings] == ["bad:0:103"]
    assert f"1 {kind}" in summary(run)
