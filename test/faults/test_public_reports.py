# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small recordings after public bug reports give the right values that their README says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle


@pytest.fixture
def report(shared_data: Path) -> Callable[[str], Path]:
    """report(name) → the folder of that case; the test skips where it is absent."""

    def folder(name: str) -> Path:
        path = shared_data / "reports" / name
        if not path.is_dir():
            pytest.skip(f"no case {path}")
        return path

    return folder


def test_a_crazyflie_s_log_that_ends_at_power_off(report, caplog):
    recording = read_recording(report("crazyflie_usd_power_off") / "log07", Vehicle.load("bebop2"))
    assert len(recording.imu) == len(recording.rotor_speeds) == 1999
    assert np.ptp(recording.imu.time_ns) == pytest.approx(1998 * 2_000_000, rel=1e-3)
    assert "cut off in the record from byte 100071" in caplog.text


def test_a_bag_that_was_reindexed_without_a_storage_identifier(report):
    recording = read_recording(report("bag_reindexed_on_humble") / "bag", Vehicle.load("bebop2"))
    assert [stream.topic for stream in recording.streams()] == ["imu", "rotor_speeds", "mocap/pose"]
    assert np.ptp(recording.imu.time_ns) == pytest.approx(6.0e9, rel=1e-3)


def test_a_table_with_spaces_after_the_commas_of_its_heading(report):
    case = report("csv_space_after_comma")
    recording = read_recording(case / "flight.csv", Vehicle.load("bebop2"), case / "mapping.yaml")
    assert [len(stream) for stream in recording.streams()] == [1000, 1000, 1000]


def test_a_table_with_a_state_that_lacks_its_position(report, caplog):
    case = report("table_velocity_without_position")
    read_recording(case / "flight.csv", Vehicle.load("bebop2"), case / "mapping.yaml")
    assert "position is missing, so attitude and velocity are not used" in caplog.text
