# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a reader does to itself is one error here: crashes, loops, memory, and more than a file may hold."""

import ctypes
import os
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, QuadpiError, SampleError
from quadpi_core.logs import sandbox
from quadpi_core.logs.sandbox import read_apart, require_unpackable, unpacked_limit
from quadpi_core.paths import LIMIT_VARIABLE


@pytest.mark.parametrize("limit", ["", "0", "-1", "1e3", "²", "9" * 20])
def test_a_limit_that_is_none(monkeypatch, limit):
    monkeypatch.setenv(LIMIT_VARIABLE, limit)
    with pytest.raises(QuadpiError, match="must be a positive whole number of MiB"):
        unpacked_limit(0)


def test_a_large_file_may_unpack_to_more():
    assert unpacked_limit(10 * 2**20) == 1000 * 2**20
    require_unpackable(10 * 2**20, 1000 * 2**20)
    with pytest.raises(LogError, match="unpacks to more than the limit of 1000 MiB"):
        require_unpackable(10 * 2**20, 1000 * 2**20 + 1)


def test_what_is_read_comes_as_it_is_read():
    def read(count, *, step):
        for number in range(0, count, step):
            yield os.getpid(), np.arange(number)

    found = list(read_apart(0, read, 6, step=2))
    assert [len(values) for _, values in found] == [0, 2, 4]
    assert os.getpid() not in {process for process, _ in found}


def crash():
    ctypes.string_at(0)
    yield


def take_memory():
    yield np.ones(2**24)


def hold_too_much():
    while True:
        yield bytes(2**21)


def end_itself():
    yield 1
    os._exit(0)


def loop():
    while True:
        pass
    yield


def stop():
    raise SystemExit
    yield


def wait():
    while True:
        time.sleep(1)
    yield


def fail():
    yield 1
    raise ValueError("a size of\n-1")


def cannot_open():
    yield Path("/nowhere").read_bytes()


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (crash, r"cannot be read: damaged, its reader crashed \(SIGSEGV\)"),
        (end_itself, r"cannot be read: damaged, its reader crashed \(it ended\)"),
        (stop, r"cannot be read: damaged, its reader crashed \(it ended\)"),
        (take_memory, "unpacks to more than the limit of 16 MiB, or is damaged; QUADPI_UNPACKED_MIB or"),
        (hold_too_much, "unpacks to more than the limit of 16 MiB"),
        (loop, "cannot be read: damaged, its reader does not end"),
        (wait, "cannot be read: its reader does not end"),
        (fail, "cannot be read: a size of -1"),
        (cannot_open, "cannot be read: No such file or directory"),
    ],
)
def test_what_ends_a_reader_is_one_line(monkeypatch, capfd, read, message):
    monkeypatch.setattr(sandbox, "_SECONDS", 1 if read in {loop, wait} else 60)
    monkeypatch.setattr(sandbox, "_PATIENCE", 2 if read is wait else 60)
    monkeypatch.setenv(LIMIT_VARIABLE, "16")
    here = os.getpid()
    try:
        with pytest.raises(LogError, match=f"^{message}"):
            for _ in read_apart(0, read):
                pass
    finally:
        assert os.getpid() == here
    assert capfd.readouterr() == ("", "")


def test_its_own_errors_come_through():
    def read():
        raise SampleError(3, "no stamp")
        yield

    with pytest.raises(SampleError, match="sample 3: no stamp"):
        next(read_apart(0, read))


def test_a_reader_that_is_left_ends():
    def read():
        while True:
            yield os.getpid()

    reading = read_apart(0, read)
    process = next(reading)
    reading.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


_READING = """
from quadpi_core.logs.sandbox import read_apart

def read():
    while True:
        yield bytes(100_000)

reading = read_apart(10**9, read)
next(reading)
"""
_WAITING = """
from quadpi_core.logs.bag_files import Bag
from quadpi_core.paths import bags_directory

bag = Bag(bags_directory() / "train_1.mcap")
"""
_THEN_SLEEP = "print(flush=True)\n__import__('time').sleep(600.0)"


@pytest.mark.parametrize("code", [_READING, _WAITING], ids=["reading", "waiting"])
def test_a_reader_ends_whose_process_is_killed(code):
    ends, held = os.pipe()
    command = [sys.executable, "-c", code + _THEN_SLEEP]
    with subprocess.Popen(command, stdout=subprocess.PIPE, pass_fds=(held,)) as process:
        os.close(held)
        assert process.stdout.readline() == b"\n"
        process.kill()
    # The reader has inherited the other end.
    ready, _, _ = select.select([ends], [], [], 30.0)
    assert ready
    assert os.read(ends, 1) == b""
    os.close(ends)
