# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Betaflight's logs: which of several flights is read, in which units, and what is said of the rest."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import Recording
from quadpi_core.logs.formats.betaflight import read_betaflight
from quadpi_core.vehicle import Vehicle

from ..blackbox_writer import PLAIN, intra, log, signed

RAD_S = 2.0 * np.pi / 60.0
GYRO, ACCELERATION, ERPM = (
    [f"{name}[{axis}]" for axis in range(count)]
    for name, count in (("gyroADC", 3), ("accSmooth", 3), ("eRPM", 4))
)
SENSORS = [*GYRO, *ACCELERATION]
VALUES = (100, -200, 300, 0, 0, 2048, 10, 20, 30, 40)


def frames(count: int, values: tuple[int, ...] = VALUES, *, every: int = 32) -> list[bytes]:
    return [intra(every * k, 1000 + 500 * k, b"".join(map(signed, values))) for k in range(count)]


def flight(*parts: bytes, names: list[str] | None = None, **headers: object) -> bytes:
    fields = PLAIN | dict.fromkeys([*SENSORS, *ERPM] if names is None else names, (0, 0, 0, 0))
    known = {"acc_1G": 2048, "dshot_bidir": 1, "motor_poles": 14, **headers}
    return log(fields, parts, more=[f"{name}:{value}" for name, value in known.items() if value is not None])


@pytest.fixture
def read(tmp_path: Path, vehicle: Vehicle) -> Any:
    """read(content) → the recording in such a file."""

    def recording(content: bytes, of: Vehicle | None = vehicle) -> Recording:
        path = tmp_path / "flight.bbl"
        path.write_bytes(content)
        return read_betaflight(path, of)

    return recording


def test_units_and_axes(read):
    """deg/s and counts in forward-left-up; hundreds of eRPM of 7 pole pairs, motors in neurobem's order."""
    recording = read(flight(*frames(4)))
    assert recording.imu.angular_velocity[0] == pytest.approx(np.radians([100.0, 200.0, -300.0]))
    assert recording.imu.specific_force[0] == pytest.approx([0.0, 0.0, -9.80665])
    assert recording.rotor_speeds.speeds[0] == pytest.approx(np.array([10, 20, 30, 40]) * 100.0 / 7 * RAD_S)
    assert recording.imu.time_ns.tolist() == [10**6, 1_500_000, 2 * 10**6, 2_500_000]


def test_counts_of_the_gyro_are_scaled_as_the_headers_say(read):
    """The scale is the bits of a float; at high resolution a count is a tenth."""
    bits = struct.unpack("<I", struct.pack("<f", 0.5))[0]
    for headers, scale in (
        ({"gyro_scale": f"0x{bits:08x}"}, 0.5),
        ({"gyro_scale": f"0x{bits:08x}", "blackbox_high_resolution": 1}, 0.05),
        ({"blackbox_high_resolution": 0}, 1.0),
    ):
        found = read(flight(*frames(3), **headers)).imu.angular_velocity[0, 0]
        assert found == pytest.approx(np.radians(100.0 * scale))


@pytest.mark.parametrize("one_g", [None, 0, -1])
def test_counts_of_the_accelerometer_need_their_scale(read, one_g):
    with pytest.raises(LogError, match=r"flight\.bbl: the header acc_1G is missing: nothing says how many"):
        read(flight(*frames(3), acc_1G=one_g))


def test_the_flight_with_most_frames_is_read_and_the_others_said(read, caplog):
    content = flight(*frames(3)) + flight(*frames(5)) + flight(*frames(4))
    assert len(read(content).imu) == 5
    assert "holds 3 flights; read is the longest, number 2" in caplog.text


def test_a_flight_whose_headers_are_broken_is_passed_over(read, caplog):
    broken = flight(*frames(9)).replace(b"Field I encoding", b"Field I encodin_")
    assert len(read(broken + flight(*frames(3))).imu) == 3
    assert "flight 1: its header `Field I encoding` has 1 entries" in caplog.text
    with pytest.raises(LogError, match=r"flight\.bbl: no frame of a flight can be read"):
        read(broken)


@pytest.mark.parametrize(("others", "frames_read"), [(99, 2), (100, 1)])
def test_of_many_flights_the_hundred_largest_are_looked_at(read, others, frames_read):
    """The one with most frames is the smallest here: the headers of the others are longer."""
    long = flight(*frames(1), note="x" * 4000)
    assert len(read(long * others + flight(*frames(2))).imu) == frames_read


def test_what_is_missing_is_said(read, caplog):
    content = flight(*frames(3), *frames(6, every=32)[4:])
    assert len(read(content).imu) == 5
    assert "flight 1: about 1 frames are damaged or were not logged" in caplog.text
    read(content[: -len("End of log") - 3])
    assert "flight 1: it has no end: the file is cut off, or the battery was pulled" in caplog.text


@pytest.mark.parametrize(("names", "topic"), [(ERPM, "imu"), (SENSORS, None)])
def test_fields_that_were_not_logged(read, names, topic, caplog):
    values = tuple(VALUES[[*SENSORS, *ERPM].index(name)] for name in names)
    content = flight(*frames(3, values), names=names)
    if topic:
        with pytest.raises(
            LogError, match=r"topic imu: the log holds no samples .*\(gyroADC and accSmooth\)"
        ):
            read(content)
        return
    assert read(content).rotor_speeds is None
    assert "bidirectional DShot was on, but eRPM is not among the logged fields" in caplog.text


def test_electrical_speeds_need_pole_pairs(read, vehicle, caplog):
    with pytest.raises(VehicleError, match="pole_pairs"):
        read(flight(*frames(3)), replace(vehicle, pole_pairs=None))
    assert read(flight(*frames(3)), None).rotor_speeds is None
    assert "topic rotor_speeds: left out, electrical speeds need the vehicle's pole pairs" in caplog.text


def test_other_pole_pairs_than_the_log_says_are_noted(read, vehicle, caplog):
    read(flight(*frames(3)), replace(vehicle, pole_pairs=6))
    assert "motor_poles is 14, the vehicle file says 12" in caplog.text
