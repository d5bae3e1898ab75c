# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Units of stamps, told by the rate, and columns by their names."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.mapping import UNITS
from quadpi_core.logs.table_columns import open_columns

from .formats.test_table_files import hover_table, read
from .test_mapping import minimal_mapping


def text_of(time_ns: np.ndarray, precision: str) -> np.ndarray:
    return np.datetime_as_string(time_ns.astype("datetime64[ns]"), unit=precision)


START_NS = 1_403_636_579_758_555_392
STAMPS = {
    "s": lambda ns: ns / 1e9,
    "ms": lambda ns: ns // 10**6,
    "us": lambda ns: ns // 1000,
    "ns": lambda ns: ns,
    "iso": lambda ns: text_of(ns, "ns"),
    "iso, UTC": lambda ns: np.char.add(text_of(ns, "us"), "Z"),
    "iso, decimal comma": lambda ns: np.char.replace(text_of(ns, "us"), ".", ","),
    "iso, offset": lambda ns: np.char.add(text_of(ns + 7_200 * 10**9, "us"), "+02:00"),
    "iso, decimal comma, UTC": lambda ns: np.char.add(np.char.replace(text_of(ns, "us"), ".", ","), "Z"),
    "iso, basic": lambda ns: np.char.replace(np.char.replace(text_of(ns, "us"), "-", ""), ":", ""),
    "slashes": lambda ns: np.char.replace(text_of(ns, "us"), "-", "/"),
    "date and time": lambda ns: np.char.replace(text_of(ns, "us"), "T", " "),
}


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns", None])
@pytest.mark.parametrize("rate_hz", [50, 1000])
def test_the_rate_tells_the_unit_of_the_stamps(tmp_path: Path, stamps: str, unit: str, rate_hz: int, caplog):
    mapping = minimal_mapping()
    mapping["time"] = {"columns": ["t"]} | ({"unit": unit} if unit else {})
    time_ns = START_NS + np.arange(50) * (10**9 // rate_hz)
    imu = read(tmp_path, mapping, hover_table() | {"t": STAMPS[stamps](time_ns)}).imu
    precision = {"s": 300, "ms": 1_000_000, "ns": 1, "iso": 1}.get(stamps, 1000)
    assert np.abs(imu.time_ns - time_ns).max() < precision
    expected = f"the stamps are taken to be in {stamps}"
    assert (expected in caplog.text) == (stamps in UNITS["time"] and stamps != unit)


@pytest.mark.parametrize(
    ("unit", "interval", "expected_s"),
    [
        ("ms", 0.051, 5.1e-5),  # 20 kHz; in seconds it would be 20 Hz
        ("ms", 0.049, 0.049),
        ("s", 0.49, 0.49),
        ("s", 0.51, 5.1e-4),
        (None, 5.1e-4, 5.1e-4),
        (None, 0.49, 0.49),
    ],
)
def test_between_which_rates_the_unit_of_the_stamps_is_told(tmp_path: Path, unit, interval, expected_s):
    mapping = minimal_mapping()
    mapping["time"] = {"columns": ["t"], "unit": unit}
    imu = read(tmp_path, mapping, hover_table() | {"t": np.arange(50) * interval}).imu
    assert imu.time_ns[1] == pytest.approx(expected_s * 1e9)


def test_a_unit_that_cannot_be_told_is_asked_for(tmp_path: Path):
    mapping = minimal_mapping()
    del mapping["time"]["unit"]
    with pytest.raises(LogError, match="unit of the time cannot be told; `unit` in the mapping says it"):
        read(tmp_path, mapping, hover_table() | {"t": np.zeros(50)})


@pytest.mark.parametrize(
    ("period_ns", "written"),
    [
        (2**32 * 1000, lambda ns: ns // 1000),
        (2**32 * 1000, lambda ns: ns / 1e9),
        (2**32 * 10**6, lambda ns: ns // 10**6),
        (86_400 * 10**9, lambda ns: np.array([one[11:] for one in text_of(ns, "ms")])),
    ],
)
def test_a_clock_that_begins_again_at_its_period_is_counted_on(
    tmp_path: Path, period_ns: int, written, caplog
):
    time_ns = period_ns // 10**6 * 10**6 - 10**9 + np.arange(50) * 40_000_000
    mapping = minimal_mapping()
    del mapping["time"]["unit"]
    imu = read(tmp_path, mapping, hover_table() | {"t": written(time_ns % period_ns)}).imu
    np.testing.assert_allclose(np.diff(imu.time_ns), 40_000_000, atol=1_000_000)
    assert "the clock begins again after" in caplog.text


def test_a_clock_that_starts_again_at_any_other_time_is_not(tmp_path: Path):
    time_us = np.r_[4_294_000_000 + np.arange(30) * 40_000, np.arange(20) * 40_000]
    flight = read(tmp_path, minimal_mapping(), hover_table() | {"t": time_us})
    assert (len(flight.imu), len(flight.quality.breaks)) == (30, 1)


def test_stamps_before_zero_are_moved(tmp_path: Path, caplog):
    imu = read(tmp_path, minimal_mapping(), hover_table() | {"t": np.arange(50) * 0.01 - 0.2}).imu
    np.testing.assert_array_equal(imu.time_ns, 800_000_000 + np.arange(50) * 10_000_000)
    assert "the stamps begin at -0.200 s: 1 s are added to all" in caplog.text


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (739_000 + np.arange(50) / 86_400 / 500, "is the interval of no flight"),
        (np.array(["17.05.2024 23:59:55.1"] * 50), "is neither a number nor date and time"),
    ],
)
def test_a_time_in_days_or_in_words_is_refused(tmp_path: Path, stamps, said):
    with pytest.raises(LogError, match=said):
        read(tmp_path, minimal_mapping(), hover_table() | {"t": stamps})


def test_a_table_needs_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(LogError, match=r"a\.csv: this needs pyarrow, .* pip install quadpi-monitor\[logs\]"):
        open_columns(tmp_path / "a.csv")
