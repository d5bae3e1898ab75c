# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Telemetry: the type in the heartbeat tells what is no multirotor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from benchmarks.fuzzing.flight_logs import Sender
from quadpi_core.errors import LogError
from quadpi_core.field.stacks.telemetry_stack import read_telemetry_field

from ...logs.formats.test_mavlink_tlog import record


def telemetry(mav_type: int, *, system: int = 1, samples: int = 400) -> bytes:
    sender: Any = Sender(system=system)
    log = record(sender.packet("HEARTBEAT", mav_type, 3, 0, 0, 4, 3), 0)
    for number in range(1, samples):
        values = (0.0, 0.0, -9.8, 0.1, 0.2, 0.3, *[0.1] * 7)
        log += record(sender.packet("HIGHRES_IMU", 10_000 * number, *values, 0x3F, 0), number)
    return log


def test_a_quadcopter_is_read(tmp_path: Path):
    path = tmp_path / "flight.tlog"
    path.write_bytes(telemetry(2))
    log = read_telemetry_field(path)
    assert log.stack == "MAVLink telemetry"
    assert log.imu.values[0, 2:6] == pytest.approx([0.3, 0.0, 0.0, -9.8])


@pytest.mark.parametrize(("mav_type", "name"), [(1, "a fixed-wing aircraft"), (20, "a VTOL aircraft")])
def test_what_is_no_multirotor_is_refused(tmp_path: Path, mav_type: int, name: str):
    path = tmp_path / "flight.tlog"
    path.write_bytes(telemetry(mav_type))
    with pytest.raises(LogError, match=f"flight.tlog: MAV_TYPE {mav_type} is {name}"):
        read_telemetry_field(path)


@pytest.mark.parametrize(("first", "second"), [(1, 2), (2, 1)])
def test_of_two_vehicles_in_a_log_the_one_that_is_read_has_the_type(
    tmp_path: Path, first: int, second: int, caplog
):
    """The second sends twice as many samples, and its heartbeat comes later."""
    path = tmp_path / "flight.tlog"
    path.write_bytes(telemetry(first, samples=200) + telemetry(second, system=2, samples=400))
    if second == 2:
        read_telemetry_field(path)
        assert "holds 2 vehicles; read is system 2" in caplog.text
        return
    with pytest.raises(LogError, match="MAV_TYPE 1 is a fixed-wing aircraft"):
        read_telemetry_field(path)
