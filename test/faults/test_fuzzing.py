# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`make fuzz` in short; what it found before, again; and that it finds what it looks for."""

import faulthandler
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")

from benchmarks.fuzzing.__main__ import Run, batches, summary
from benchmarks.fuzzing.cases import judge, make, parse_case
from benchmarks.fuzzing.formats import FORMATS, Format
from quadpi_core.errors import LogError

ROOT = Path(__file__).parents[2]
# Each file is named by its format and by what it did before that was mended.
CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())


@pytest.mark.slow
def test_a_few_cases_of_every_format():
    command = (sys.executable, "-m", "benchmarks.fuzzing", "--cases", "1500", "--workers", "1")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "found: nothing" in done.stdout
    for name in FORMATS:
        assert f"\n{name} " in done.stdout


@pytest.mark.parametrize("file", CORPUS, ids=lambda file: file.name)
@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_what_was_found_before(file, number, tmp_path):
    outcome = judge(FORMATS[file.name.split(".")[0]], file.read_bytes(), number, tmp_path)
    assert not outcome.is_finding, outcome


def test_the_corpus_is_small():
    assert all(file.stat().st_size < 20_000 for file in CORPUS)
    assert sum(file.stat().st_size for file in CORPUS) < 200_000


@pytest.mark.parametrize("name", FORMATS)
def test_a_case_is_the_same_each_time(name):
    form, seed, number = parse_case(f"{name}:3:7")
    assert make(form, seed, number) == make(form, seed, number)
    assert len({make(form, seed, number) for number in range(20)}) > 10


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
