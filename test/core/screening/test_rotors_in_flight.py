# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A rotor that reads the same for long in flight is named, with the time; on the ground it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.screening.consistency import checked
from quadpi_core.screening.rotors_in_flight import carrying, stuck_rotors
from quadpi_core.vehicle import Vehicle

GRAVITY = 9.81


def reading(recording: Recording, rotor: int, speed: float, from_s: float, to_s: float) -> Recording:
    """The recording with a rotor that reads one speed for some time."""
    rotors = recording.rotor_speeds
    assert rotors is not None
    time_s = (rotors.time_ns - recording.imu.time_ns[0]) * 1e-9
    speeds = rotors.speeds.copy()
    speeds[(time_s >= from_s) & (time_s <= to_s), rotor] = speed
    return replace(recording, rotor_speeds=replace(rotors, speeds=speeds))


@pytest.mark.parametrize("speed", [0.0, 812.5])
def test_a_rotor_that_reads_the_same_in_flight_is_named_with_the_time(flown, vehicle: Vehicle, speed) -> None:
    recording = reading(flown["train_2"], 2, speed, 5.0, 6.0)
    found = checked(reading(recording, 2, speed, 8.0, 8.7), vehicle).quality.findings
    stuck = [finding for finding in found if finding.mistake == "stuck rotor"]
    assert [str(finding) for finding in stuck] == [
        f"topic rotor_speeds: rotor 3 reads {speed:.4g} rad/s from 5.00 to 6.00 s in flight, without a "
        "change, and so for 1.7 s in all: its sensor fails; leave this flight out"
    ]


def test_two_rotors_are_named_each(flown, vehicle: Vehicle) -> None:
    recording = reading(reading(flown["train_4"], 0, 0.0, 4.0, 5.0), 3, 0.0, 7.0, 8.0)
    found = [finding.text[:7] for finding in stuck_rotors(recording, vehicle.gravity_m_s2)]
    assert found == ["rotor 1", "rotor 4"]


def test_nothing_is_said_of_rotors_that_idle_on_the_ground(flown, vehicle: Vehicle) -> None:
    recording = flown["train_2"]
    for rotor in range(4):
        recording = reading(recording, rotor, 100.0, -1.0, 3.0)
    assert list(stuck_rotors(recording, vehicle.gravity_m_s2)) == []


def test_real_flights_with_a_failing_sensor_are_named_and_sound_ones_not(shared_data) -> None:
    vehicle = Vehicle.load("crazyflie_rpm")
    logs = (shared_data / "imrc_brushed").glob("jana*")
    recordings = [read_recording(log, vehicle) for log in sorted(logs)]
    named = {own.name for own in recordings if list(stuck_rotors(own, vehicle.gravity_m_s2))}
    assert named == {"jana20", "jana23", "jana24", "jana27"}


def test_recordings_without_rotor_speeds_or_with_one_sample_have_no_stuck_rotor(flown) -> None:
    recording = flown["train_2"]
    assert list(stuck_rotors(replace(recording, rotor_speeds=None), GRAVITY)) == []
    one = recording.rotor_speeds.take(slice(0, 1))
    assert list(stuck_rotors(replace(recording, rotor_speeds=one), GRAVITY)) == []


def test_rotors_carry_from_half_of_the_weight_on() -> None:
    lift = np.full(1000, GRAVITY)
    speeds = np.full((1000, 4), 500.0)
    speeds[0], speeds[1] = 500.0 * np.sqrt(0.49), 500.0 * np.sqrt(0.51)
    assert carrying(speeds, lift, GRAVITY)[:3].tolist() == [False, True, True]
