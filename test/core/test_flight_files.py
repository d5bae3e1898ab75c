# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several flights at once: names that differ, and one that is bad stops no other, wherever tasks run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from quadpi_core import flight_files
from quadpi_core.errors import LogError, OutputError
from quadpi_core.flight_files import FlightLeftOut, bags_in, for_each_flight, named_files
from quadpi_core.parallel import Progress, Workers


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a/x.bin", "b/y.bin"], ["x", "y"]),
        (["monday/LOG1.bin", "tuesday/LOG1.bin", "LOG2.bin"], ["monday_LOG1", "tuesday_LOG1", "LOG2"]),
        (["/1/same/x.bin", "/2/same/x.bin"], ["1_same_x", "2_same_x"]),
        (["a/x.bin", "a/x.csv", "b/x.bin"], ["a_x.bin", "a_x.csv", "b_x.bin"]),
        (["x.bin", "./x.bin"], ["x", "x"]),
        (["/b/L.bin", "/d/L.bin", "/b_L.bin"], ["b_L", "d_L", "b_L_2"]),
        (["/", "x.bin", "."], ["", "x", Path.cwd().name]),
    ],
)
def test_names_differ_where_stems_do_not(paths, names):
    """And do not depend on the order."""
    assert [file.name for file in named_files(paths)] == names
    assert [file.name for file in named_files(paths[::-1])] == names[::-1]


def test_no_bag_takes_the_place_of_a_flight(tmp_path):
    flights = [tmp_path / "a.mcap", tmp_path / "b.bin"]
    assert bags_in(tmp_path / "out", flights) == [tmp_path / "out" / name for name in ("a.mcap", "b.mcap")]
    with pytest.raises(LogError, match=rf"a\.mcap: its bag would replace {flights[0]}; choose another"):
        bags_in(tmp_path, flights)


@pytest.fixture
def named():
    """A task that travels by value: workers cannot import the modules of the tests."""

    def task(shared, file):
        if not file.path.stat().st_size:
            raise LogError(f"{file.path}: the file is empty")
        return shared, file.name

    return task


@pytest.fixture
def flights(tmp_path):
    for name in ("a", "b", "empty"):
        (tmp_path / name).write_text("" if name == "empty" else name)
    return [tmp_path / name for name in ("empty", "a", "missing", "b", "a")]


@pytest.mark.parametrize("place", ["here", pytest.param("beside", marks=pytest.mark.slow)])
def test_the_others_go_on(named, flights, place):
    seen, left_out = [], []
    workers = Workers(1 if place == "here" else 2, progress=seen.append)
    empty, a, missing, b, _ = flights
    for _ in range(2):
        # Flights that were left out are not read again, but keep the names of the others as they are.
        done = for_each_flight(named, flights, shared=7, task="Reading", workers=workers, left_out=left_out)
        assert [(file.path, result) for file, result in done] == [(a, (7, "a")), (b, (7, "b"))]
        assert left_out == [
            FlightLeftOut("a", str(a), f"{a}: the same flight as {a}; give each flight once"),
            FlightLeftOut("empty", str(empty), f"{empty}: the file is empty"),
            FlightLeftOut("missing", str(missing), f"{missing}: No such file or directory"),
        ]
    assert seen == [Progress("Reading", n, 4) for n in (1, 2, 3, 4)] + [
        Progress("Reading", n, 2) for n in (1, 2)
    ]


def test_the_first_is_an_error_where_none_may_be_left_out(named, flights):
    with pytest.raises(LogError, match="empty: the file is empty"):
        for_each_flight(named, flights[:4], shared=None, task="")


def test_if_all_are_left_out_the_error_has_the_reasons(named, flights):
    with pytest.raises(LogError, match=r"^\S+empty: the file is empty$"):
        for_each_flight(named, flights[:1], shared=None, task="", left_out=[])
    with pytest.raises(LogError, match=r"none of the flights can be used: .*empty; .*missing: No such"):
        for_each_flight(named, [flights[0], flights[2]], shared=None, task="", left_out=[])


def test_an_output_that_cannot_be_written_is_no_fault_of_the_flight(flights):
    def full(_shared, file):
        raise OutputError(f"{file.name}: no space")

    with pytest.raises(OutputError):
        for_each_flight(full, flights[1:2], shared=None, task="", left_out=[])


@pytest.mark.slow
def test_few_are_read_in_this_process_and_many_in_others(monkeypatch, cluster, tmp_path):
    monkeypatch.setattr(flight_files, "MANY_FILES", 2)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.chdir(tmp_path)

    def place(_, file):
        return os.getpid(), str(file.path)

    def places(paths, workers):
        done = for_each_flight(place, paths, shared=None, task="", workers=workers)
        return {result[0] for _, result in done}, {result[1] for _, result in done}

    assert places([Path("a")], Workers()) == ({os.getpid()}, {"a"})
    assert os.getpid() not in places([Path("a"), Path("b")], Workers())[0]
    assert places([Path("a"), Path("b")], Workers(1))[0] == {os.getpid()}
    # Workers of a cluster have another working folder.
    assert places([Path("a")], Workers(scheduler=cluster))[1] == {f"{tmp_path}/a"}
