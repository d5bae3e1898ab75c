# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.io import loadmat

from quadpi_core.errors import LogError, SignalError
from quadpi_core.estimator.fusion import airborne, fuse
from quadpi_core.flight import Flight, OdometryStream, WindStream
from quadpi_core.frames import body_flu_to_frd, rotate_world_to_body
from quadpi_core.logs.formats.cfusdlog import read_cfusdlog
from quadpi_core.logs.formats.neurobem import read_neurobem
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle

CUTOFF = 30.0


def keep_samples(stream, keep):
    return replace(stream, **{column.name: getattr(stream, column.name)[keep] for column in fields(stream)})


def assert_sound(flight: Flight):
    for column in fields(flight):
        values = getattr(flight, column.name)
        if isinstance(values, np.ndarray):
            assert len(values) == len(flight)
            assert np.all(np.isfinite(values)), column.name
    np.testing.assert_allclose(np.linalg.norm(flight.attitude, axis=1), 1.0, rtol=1e-12)
    assert np.ptp(np.diff(flight.time)) < 1e-8


@pytest.fixture(scope="module")
def flight(noisy_vehicle, simulated):
    return fuse(simulated.recording, noisy_vehicle, CUTOFF)


def test_fused_signals_follow_the_truth(flight, true_flight, noisy_vehicle):
    assert_sound(flight)
    assert flight.start_ns == 1_000_000_000
    assert flight.rate_hz == pytest.approx(500.0)
    settled = slice(1500, -100)
    true = true_flight(1e-9 * flight.start_ns + flight.time)
    velocity = rotate_world_to_body(true.attitude, true.velocity)

    def error(estimated, expected):
        return np.sqrt(np.mean((estimated[settled] - expected[settled]) ** 2))

    assert error(flight.velocity, velocity) < 0.05
    assert error(flight.position, true.position) < 0.005
    assert error(flight.rates, true.rates) < 0.02
    assert error(flight.specific_force, true.specific_force) < 0.2
    assert error(flight.angular_acceleration, true.angular_acceleration) < 0.8
    assert error(measured_wrench(flight, noisy_vehicle)[:, :3], 0.772 * true.specific_force) < 0.15
    expected = 800.0 + 50.0 * np.sin(np.outer(1e-9 * flight.start_ns + flight.time, [1.0, 1.1, 1.2, 1.3]))
    assert error(flight.rotor_speeds, expected) < 0.01
    assert not flight.wind.any()


def test_wind_is_brought_to_the_grid_and_held_beyond_its_ends(noisy_vehicle, simulated):
    wind = WindStream(np.array([3, 5], dtype=np.int64) * 1_000_000_000, np.array([[1.0, 0, 0], [3.0, 0, 0]]))
    fused = fuse(replace(simulated.recording, wind=wind), noisy_vehicle, CUTOFF)
    at = {second: fused.wind[round((second - 1) * 500), 0] for second in (2, 4, 7)}
    assert at[2] == pytest.approx(1.0, abs=1e-6)
    assert at[4] == pytest.approx(2.0, abs=1e-6)
    assert at[7] == pytest.approx(3.0, abs=1e-6)


def test_odometry_serves_where_there_is_no_pose(noisy_vehicle, simulated):
    recording, true = simulated.recording, simulated.truth
    velocity = rotate_world_to_body(true.attitude, true.velocity)
    odometry = OdometryStream(recording.imu.time_ns, true.position, true.attitude, velocity, true.rates)
    odometry = keep_samples(odometry, slice(50, -50, 4))
    fused = fuse(replace(recording, pose=None, odometry=odometry), noisy_vehicle, CUTOFF)
    assert_sound(fused)
    assert fused.start_ns == odometry.time_ns[0]
    assert np.max(np.abs(fused.velocity - velocity[50 : 50 + len(fused)])) < 0.02


def test_what_is_missing_is_named(noisy_vehicle, simulated):
    recording = simulated.recording
    with pytest.raises(LogError, match=r"simulated\.bag: topic rotor_speeds is missing"):
        fuse(replace(recording, rotor_speeds=None), noisy_vehicle, CUTOFF)
    with pytest.raises(LogError, match=r"simulated\.bag: topics mocap/pose and odometry are missing"):
        fuse(replace(recording, pose=None), noisy_vehicle, CUTOFF)


def paused(recording, topic):
    keep = np.ones(len(recording.imu), dtype=bool)
    keep[2000:2100] = False
    return replace(recording, **{topic: keep_samples(getattr(recording, topic), keep)})


def test_a_pause_is_named_with_its_sample(noisy_vehicle, simulated):
    with pytest.raises(LogError, match=r"topic imu: sample 2000: comes 0\.202 s after"):
        fuse(paused(simulated.recording, "imu"), noisy_vehicle, CUTOFF)


def test_a_pause_of_the_rotor_speeds_costs_its_own_samples(noisy_vehicle, simulated, flight):
    """And one period of the cut-off on either side, beyond which nothing has changed."""
    fused = fuse(paused(simulated.recording, "rotor_speeds"), noisy_vehicle, CUTOFF)
    start_s = 1e-9 * (flight.start_ns - simulated.recording.imu.time_ns[0])
    first = 2000 - round(500.0 * start_s) - 17
    kept = np.r_[0:first, first + 100 + 2 * 17 : len(flight)]
    np.testing.assert_array_equal(fused.time, flight.time[kept])
    np.testing.assert_array_equal(fused.velocity, flight.velocity[kept])
    np.testing.assert_allclose(fused.rotor_speeds, flight.rotor_speeds[kept], atol=0.1)
    assert fused.rate_hz == pytest.approx(500.0)
    assert [sentence.split(";")[0] for sentence in fused.quality.sentences()] == [
        "topic rotor_speeds: pauses from 3.998 to 4.200 s at sample 2000",
        f"topic imu: left out 134 of {len(flight)} samples while the rotor speeds pause",
    ]


def test_streams_that_never_meet_and_short_flights_are_refused(noisy_vehicle, simulated):
    recording = simulated.recording
    late = replace(recording.rotor_speeds, time_ns=recording.rotor_speeds.time_ns + 60_000_000_000)
    with pytest.raises(LogError, match="share no time"):
        fuse(replace(recording, rotor_speeds=late), noisy_vehicle, CUTOFF)
    brief = keep_samples(recording.rotor_speeds, slice(0, 540))
    with pytest.raises(SignalError, match=r"simulated\.bag: 40 samples are too few to filter"):
        fuse(replace(recording, rotor_speeds=brief), noisy_vehicle, CUTOFF)
    with pytest.raises(SignalError, match=r"simulated\.bag: cut-off 250 Hz"):
        fuse(recording, noisy_vehicle, 250.0)


def test_lost_and_jittering_samples_are_bridged(noisy_vehicle, simulated, flight):
    rng = np.random.default_rng(10)
    imu = simulated.recording.imu
    keep = rng.random(len(imu)) > 0.02
    keep[3000:3010] = False
    rough = keep_samples(imu, keep)
    fused = fuse(replace(simulated.recording, imu=rough), noisy_vehicle, CUTOFF)
    assert_sound(fused)
    assert fused.rate_hz == pytest.approx(500.0)
    offset = round((fused.start_ns - flight.start_ns) / 2_000_000)
    shared = slice(1500, 3000)
    difference = fused.velocity[shared] - flight.velocity[offset:][shared]
    assert np.max(np.abs(difference)) < 0.05


def test_neurobem_wrench_agrees_with_the_columns_of_the_file(shared_data):
    vehicle = Vehicle.load("neurobem")
    path = shared_data / "neurobem" / "bemnn20210218171908seg2.mat"
    fused = fuse(read_neurobem(path, vehicle), vehicle, CUTOFF)
    assert_sound(fused)
    matrix = next(value for name, value in loadmat(path).items() if not name.startswith("_"))
    matrix = matrix[round((fused.start_ns * 1e-9 - matrix[0, 0]) * 400.0) :][: len(fused)]
    rates = body_flu_to_frd(matrix[:, 4:7])
    moment = body_flu_to_frd(matrix[:, 1:4]) @ vehicle.inertia + np.cross(rates, rates @ vehicle.inertia)
    expected = np.hstack((vehicle.mass_kg * body_flu_to_frd(matrix[:, 11:14]), moment))
    wrench = measured_wrench(fused, vehicle)
    for axis in range(6):
        assert np.corrcoef(wrench[:, axis], expected[:, axis])[0, 1] > 0.99


def test_crazyflie_flight_hovers_at_its_weight(shared_data):
    vehicle = Vehicle.load("crazyflie_rpm")
    fused = fuse(read_cfusdlog(shared_data / "imrc_brushless" / "eckart00", vehicle), vehicle, CUTOFF)
    assert_sound(fused)
    flying = np.median(measured_wrench(fused, vehicle)[:, 2])
    assert flying == pytest.approx(-vehicle.mass_kg * vehicle.gravity_m_s2, rel=0.05)


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


@pytest.fixture(scope="module")
def flown(fly, vehicle):
    """A flight of 8 s that begins in the air."""
    return fuse(fly(0), vehicle, 20.0)


def wait_on_ground(flight, seconds, idle_rad_s, vehicle):
    """The flight, but parked before `seconds`, the rotors idling."""
    parked = (flight.time < seconds)[:, None]
    at_rest = [0.0, 0.0, -vehicle.gravity_m_s2]
    return replace(
        flight,
        specific_force=np.where(parked, at_rest, flight.specific_force),
        rotor_speeds=np.where(parked, idle_rad_s, flight.rotor_speeds),
    )


@pytest.mark.parametrize("seconds", [2.0, 6.0])
@pytest.mark.parametrize("idle_rad_s", [0.0, 300.0])
def test_time_on_the_ground_is_cut(flown, vehicle, seconds, idle_rad_s):
    kept = airborne(wait_on_ground(flown, seconds, idle_rad_s, vehicle), vehicle.gravity_m_s2)
    assert kept.time[0] == pytest.approx(seconds, abs=0.01)
    assert kept.time[-1] == flown.time[-1]


def test_gentle_start_of_a_wild_flight_is_kept(flown, vehicle):
    wild = np.where((flown.time > 1.0)[:, None], 3.0, 1.0)
    faster = replace(
        flown,
        specific_force=flown.specific_force * wild,
        rotor_speeds=flown.rotor_speeds * np.sqrt(wild),
    )
    assert len(airborne(faster, vehicle.gravity_m_s2)) == len(flown)


@pytest.mark.parametrize(("share", "carried"), [(0.45, False), (0.55, True)])
def test_rotors_carry_the_vehicle_from_half_of_its_weight_on(flown, vehicle, share, carried):
    still = replace(flown, rotor_speeds=np.full_like(flown.rotor_speeds, 800.0))
    hover = replace(still, specific_force=np.tile([0.0, 0.0, -vehicle.gravity_m_s2], (len(flown), 1)))
    rising = np.where((flown.time < 2.0)[:, None], share, 1.0)
    flight = replace(
        hover,
        specific_force=hover.specific_force * rising,
        rotor_speeds=hover.rotor_speeds * np.sqrt(rising),
    )
    assert (airborne(flight, vehicle.gravity_m_s2).time[0] == flown.time[0]) == carried


def test_rotors_that_never_turn_are_refused(flown, vehicle):
    still = replace(flown, rotor_speeds=np.zeros_like(flown.rotor_speeds))
    with pytest.raises(LogError, match=r"flight0: topic rotor_speeds: the rotors never carry the vehicle"):
        airborne(still, vehicle.gravity_m_s2)
