# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A rotor that reads the same for long in flight is named, with the time; on the ground it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, Recording, RotorSpeedStream
from quadpi_core.logs import read_recording
from quadpi_core.reading_options import split_recording
from quadpi_core.screening.consistency import checked, contradictions
from quadpi_core.screening.flight_runs import survey
from quadpi_core.screening.rotors_in_flight import carrying, stuck_rotors
from quadpi_core.screening.wild_samples import screened
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


# Rotor speeds that are no measurements are left out and counted; those of a rotor that stops stay.


STOP_S, LAG_S = 4.0, 0.03


def with_speeds(recording: Recording, speeds: np.ndarray) -> Recording:
    return replace(recording, rotor_speeds=replace(recording.rotor_speeds, speeds=speeds))


def seconds(recording: Recording) -> np.ndarray:
    return (recording.rotor_speeds.time_ns - recording.imu.time_ns[0]) * 1e-9


def dropping(
    recording: Recording, rotors: list[int], for_s: float, every_s: float
) -> tuple[Recording, np.ndarray]:
    """The recording with rotors that read 0 now and then, and where they do."""
    time_s, speeds = seconds(recording), recording.rotor_speeds.speeds.copy()
    zero = (time_s > 1.0) & (np.mod(time_s, every_s) < for_s)
    speeds[np.ix_(zero, rotors)] = 0.0
    return with_speeds(recording, speeds), zero


@pytest.mark.parametrize("rotors", [[2], [0, 3], [0, 1, 2, 3]])
@pytest.mark.parametrize(("for_s", "every_s"), [(0.002, 0.1), (0.03, 0.5), (0.1, 0.7), (0.3, 3.0)])
def test_drop_outs_are_left_out_and_counted(flown, vehicle: Vehicle, rotors, for_s, every_s) -> None:
    recording, zero = dropping(flown["train_2"], rotors, for_s, every_s)
    kept = screened(recording, vehicle)
    (left,) = kept.quality.left_out
    assert (left.limit, left.samples) == ("in which a rotor reads 0 in flight", np.count_nonzero(zero))
    assert np.array_equal(kept.rotor_speeds.time_ns, recording.rotor_speeds.time_ns[~zero])
    assert list(contradictions(kept, vehicle)) == []
    blocks = survey(lambda: split_recording(recording), vehicle)["rotor_speeds"]
    assert np.array_equal(blocks.usable, ~zero)


def test_what_is_interpolated_across_a_drop_out_is_left_out_with_it(flown, vehicle: Vehicle) -> None:
    recording, zero = dropping(flown["train_2"], [1], 0.03, 0.5)
    speeds = recording.rotor_speeds.speeds.copy()
    edge = np.flatnonzero(np.diff(zero.astype(int)) == 1)
    speeds[edge, 1] *= 0.3
    left = screened(with_speeds(recording, speeds), vehicle).quality.left_out
    assert sum(one.samples for one in left) == np.count_nonzero(zero) + len(edge)


def stopping(vehicle: Vehicle, rotor: int, telemetry: bool) -> Recording:
    """A hover in which a rotor stops; its telemetry goes on, or reads 0 from then on."""
    time_ns = 2_000_000 * np.arange(2600)
    time_s = time_ns * 1e-9
    hover = np.sqrt(vehicle.mass_kg * 9.81 / 4.0)
    since = np.maximum(time_s - STOP_S, 0.0)
    thrust = np.full((2600, 4), hover**2)
    thrust[:, rotor] *= np.exp(-2.0 * since / LAG_S)
    levers = np.stack((-vehicle.rotor_positions[:, 1], vehicle.rotor_positions[:, 0]))
    turning = thrust @ levers.T / np.diag(vehicle.inertia)[:2]
    rng = np.random.default_rng(rotor)
    rates = np.zeros((2600, 3))
    rates[:, :2] = np.cumsum(turning - turning[0], axis=0) * 0.002
    force = np.zeros((2600, 3))
    force[:, 2] = -thrust.sum(axis=1) / vehicle.mass_kg
    speeds = np.sqrt(thrust) * 650.0 / hover + rng.normal(0.0, 1.0, (2600, 4))
    speeds[time_s >= STOP_S + (0.2 if telemetry else 0.0), rotor] = 0.0
    imu = ImuStream(
        time_ns, rates + rng.normal(0.0, 0.02, rates.shape), force + rng.normal(0.0, 2.0, force.shape)
    )
    return Recording("hover", vehicle.name, "", imu, RotorSpeedStream(time_ns, np.abs(speeds)))


@pytest.mark.parametrize("telemetry", [True, False])
@pytest.mark.parametrize("rotor", range(4))
def test_a_rotor_that_stops_keeps_its_samples_and_is_not_called_a_sensor(vehicle, rotor, telemetry) -> None:
    recording = stopping(vehicle, rotor, telemetry)
    kept = screened(recording, vehicle)
    assert len(kept.rotor_speeds) == len(recording.rotor_speeds)
    (finding,) = (
        one for one in contradictions(kept, vehicle) if "stopped" in one.text or "sensor" in one.text
    )
    assert finding.mistake == "stopped rotor"
    assert finding.text.startswith(f"rotor {rotor + 1} stopped at 4.")


def test_speeds_of_a_slow_source_that_are_held_are_left_out_with_its_rate(flown, vehicle: Vehicle) -> None:
    recording = flown["train_2"]
    places = np.arange(len(recording.rotor_speeds)) // 20 * 20
    held = with_speeds(recording, recording.rotor_speeds.speeds[places])
    kept = screened(held, vehicle)
    (left,) = kept.quality.left_out
    assert left.limit.startswith("in which no rotor speed is new: its source gives ")
    assert np.array_equal(kept.rotor_speeds.time_ns, recording.rotor_speeds.time_ns[::20])


@pytest.mark.parametrize("step_rad_s", [1.7, 12.0])
def test_coarse_speeds_are_not_held_ones(flown, vehicle: Vehicle, step_rad_s) -> None:
    recording = flown["train_2"]
    coarse = step_rad_s * np.round(recording.rotor_speeds.speeds / step_rad_s)
    kept = screened(with_speeds(recording, coarse), vehicle)
    assert kept.quality.left_out == ()
    assert list(contradictions(kept, vehicle)) == []


def test_rotors_that_begin_to_turn_in_the_air_keep_their_samples(shared_data) -> None:
    """Thrown by hand."""
    vehicle = Vehicle.load("indiflight")
    recording = read_recording(shared_data / "indiflight" / "LOG00230.BFL", vehicle)
    assert [left.samples for left in recording.quality.left_out] == [1]
