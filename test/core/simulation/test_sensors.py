# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.config_schema import parse_config
from quadpi_core.errors import SimulationError
from quadpi_core.frames import (
    from_rotation_vector,
    inverse,
    matrix,
    product,
    rotate_body_to_world,
    rotate_world_to_body,
    to_rotation_vector,
)
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.sensor_noise import (
    Anemometer,
    Imu,
    InertialSensor,
    MotionCapture,
    RotorSpeedSensor,
    SensorSuite,
)
from quadpi_core.simulation.sensors import Fault, sense
from quadpi_core.vehicle import Vehicle

PERFECT = SensorSuite("perfect")
BEBOP = Vehicle.load("bebop2")
ANGLE = np.radians(25.0)


@pytest.fixture(scope="module")
def truth(swing):
    return swing(4.0)


@pytest.fixture(scope="module")
def long_truth(swing):
    return swing(40.0)


def sensed(truth, suite=PERFECT, *, vehicle=BEBOP, effects=None, faults=None, seed=1):
    failures = parse_config(tuple[Fault, ...], faults or [], "x", SimulationError)
    return sense(truth, vehicle, suite, read_effects(effects or {}, "x"), failures, seed)


def assert_streams_equal(one, other, *, but=()):
    """All streams equal bit for bit, except those of the topics `but`, which must differ."""
    for before, after in zip(one.recording.streams(), other.recording.streams(), strict=True):
        equal = all(
            np.array_equal(getattr(before, column.name), getattr(after, column.name))
            for column in fields(before)
        )
        assert equal == (before.topic not in but), before.topic


def test_perfect_sensors_send_the_truth(truth):
    recording = sensed(truth).recording
    np.testing.assert_array_equal(recording.imu.time_ns, truth.time_ns)
    np.testing.assert_array_equal(recording.imu.angular_velocity, truth.rates)
    np.testing.assert_array_equal(recording.imu.specific_force, truth.specific_force)
    np.testing.assert_array_equal(recording.wind.velocity, truth.known_wind)
    # Whole electrical rev/min: half of one, in rad/s of the rotor.
    step = 2.0 * np.pi / 60.0 / BEBOP.pole_pairs
    assert np.abs(recording.rotor_speeds.speeds - truth.rotor_speeds).max() <= 0.5001 * step
    recording.check()
    assert (recording.name, recording.vehicle) == ("swing", "bebop2")


def test_poses_lie_between_the_samples_of_the_truth(truth):
    pose = sensed(truth).recording.pose
    seconds = 1e-9 * (pose.time_ns - truth.time_ns[0])
    np.testing.assert_allclose(seconds, (np.arange(480) + 0.5) / 120.0, atol=1e-9)
    expected = [2.0, 1.0, 0.5] * np.sin(np.outer(seconds, [1.1, 1.7, 0.8]))
    np.testing.assert_allclose(pose.position, expected, atol=3e-6)
    np.testing.assert_allclose(np.linalg.norm(pose.attitude, axis=1), 1.0, rtol=1e-14)
    # Of the attitude: the turn from the sample before is that at the rates in between.
    before = np.searchsorted(truth.time_ns, pose.time_ns) - 1
    turn = [
        to_rotation_vector(product(inverse(truth.attitude[i]), q))
        for i, q in zip(before, pose.attitude, strict=True)
    ]
    elapsed = 1e-9 * (pose.time_ns - truth.time_ns[before])
    np.testing.assert_allclose(turn, truth.rates[before] * elapsed[:, None], atol=1e-4)


def test_no_wind_sensor_in_still_air(swing):
    assert sensed(swing(1.0, wind=False)).recording.wind is None


def test_accelerometer_away_from_the_centre_of_gravity(truth):
    """It feels the acceleration of the place where it sits: here from differences of that place's path."""
    arm = (0.08, -0.05, 0.03)
    there = truth.position + rotate_body_to_world(truth.attitude, np.broadcast_to(arm, truth.position.shape))
    acceleration = (there[2:] - 2.0 * there[1:-1] + there[:-2]) * 500.0**2
    gravity = [0.0, 0.0, BEBOP.gravity_m_s2]
    expected = rotate_world_to_body(truth.attitude[1:-1], acceleration - gravity)
    felt = sensed(truth, replace(PERFECT, imu=Imu(position=arm))).recording.imu
    np.testing.assert_allclose(felt.specific_force[1:-1], expected, atol=1e-4)
    assert np.abs(felt.specific_force - truth.specific_force).max() > 0.1
    np.testing.assert_array_equal(felt.angular_velocity, truth.rates)


def test_misaligned_imu_reports_in_its_own_axes(truth):
    angles = (2.0, -1.0, 3.0)
    rotation = matrix(from_rotation_vector(np.radians(angles)))
    reported = sensed(truth, replace(PERFECT, imu=Imu(misalignment=angles))).recording.imu
    np.testing.assert_allclose(reported.angular_velocity @ rotation.T, truth.rates, atol=1e-12)
    np.testing.assert_allclose(reported.specific_force @ rotation.T, truth.specific_force, atol=1e-12)


def test_slower_sensors_take_some_of_the_instants(truth):
    suite = replace(PERFECT, imu=Imu(rate=250.0), rotor_speeds=RotorSpeedSensor(rate=100.0))
    recording = sensed(truth, replace(suite, wind=Anemometer(rate=10.0))).recording
    for stream, step in ((recording.imu, 2), (recording.rotor_speeds, 5), (recording.wind, 50)):
        np.testing.assert_array_equal(stream.time_ns, truth.time_ns[::step])
    np.testing.assert_array_equal(recording.imu.angular_velocity, truth.rates[::2])


@pytest.mark.parametrize("rate", [300.0, 1000.0, 499.0])
def test_rate_that_does_not_divide_is_refused(truth, rate):
    suite = replace(PERFECT, rotor_speeds=RotorSpeedSensor(rate=rate))
    with pytest.raises(
        SimulationError,
        match=rf"noise perfect: rotor_speeds: `rate_hz` must divide the 500 Hz .* found {rate:g}",
    ):
        sensed(truth, suite)


def test_electrical_speeds_are_whole_and_give_the_mechanical_ones(long_truth):
    sent = sensed(long_truth, replace(PERFECT, rotor_speeds=RotorSpeedSensor(noise=5.0)))
    np.testing.assert_array_equal(sent.erpm, np.rint(sent.erpm))
    np.testing.assert_array_equal(sent.recording.rotor_speeds.speeds, BEBOP.rotor_speeds_from_erpm(sent.erpm))
    true_erpm = long_truth.rotor_speeds * BEBOP.pole_pairs * 60.0 / (2.0 * np.pi)
    # Rounding adds a uniform error of variance 1/12.
    np.testing.assert_allclose((sent.erpm - true_erpm).std(axis=0), np.sqrt(25.0 + 1 / 12), rtol=0.02)
    np.testing.assert_allclose((sent.erpm - true_erpm).mean(axis=0), 0.0, atol=0.2)


def test_a_stopped_rotor_never_reads_negative(truth):
    stopped = replace(truth, rotor_speeds=np.zeros_like(truth.rotor_speeds))
    erpm = sensed(stopped, replace(PERFECT, rotor_speeds=RotorSpeedSensor(noise=5.0))).erpm
    assert erpm.min() == 0.0
    assert erpm.max() > 10.0


def test_vehicle_without_pole_pairs_measures_mechanical_speeds(truth):
    vehicle = replace(BEBOP, pole_pairs=None)
    sent = sensed(truth, replace(PERFECT, rotor_speeds=RotorSpeedSensor(noise=5.0)), vehicle=vehicle)
    assert sent.erpm is None
    error = sent.recording.rotor_speeds.speeds - truth.rotor_speeds
    np.testing.assert_allclose(error.std() * 60.0 / (2.0 * np.pi), 5.0, rtol=0.05)


def test_noise_of_the_suite_is_on_every_sensor(long_truth):
    suite = replace(
        PERFECT,
        imu=Imu(gyro=InertialSensor(noise=0.02), accelerometer=InertialSensor(noise=0.3)),
        mocap=MotionCapture(position_noise=0.002, attitude_noise=0.005),
        wind=Anemometer(noise=0.1),
    )
    noisy, ideal = sensed(long_truth, suite).recording, sensed(long_truth).recording
    gyro = noisy.imu.angular_velocity - ideal.imu.angular_velocity
    np.testing.assert_allclose(gyro.std(axis=0), 0.02, rtol=0.03)
    force = noisy.imu.specific_force - ideal.imu.specific_force
    np.testing.assert_allclose(force.std(axis=0), 0.3, rtol=0.03)
    assert np.abs(np.corrcoef(np.hstack((gyro, force)).T) - np.eye(6)).max() < 0.04
    np.testing.assert_allclose((noisy.wind.velocity - ideal.wind.velocity).std(axis=0), 0.1, rtol=0.03)
    np.testing.assert_allclose((noisy.pose.position - ideal.pose.position).std(axis=0), 0.002, rtol=0.06)
    turn = [
        to_rotation_vector(product(inverse(one), other))
        for one, other in zip(ideal.pose.attitude, noisy.pose.attitude, strict=True)
    ]
    np.testing.assert_allclose(np.std(turn, axis=0), 0.005, rtol=0.06)


def test_frames_jitter_and_arrive_late_but_in_order(long_truth):
    mocap = MotionCapture(capture_jitter=2e-4, latency=0.008, arrival_jitter=0.004)
    sent = sensed(long_truth, replace(PERFECT, mocap=mocap))
    stamps, arrival = sent.recording.pose.time_ns, sent.arrival_ns["mocap/pose"]
    off_grid = 1e-9 * (stamps - long_truth.time_ns[0]) - (np.arange(len(stamps)) + 0.5) / 120.0
    np.testing.assert_allclose(off_grid.std(), 2e-4, rtol=0.05)
    assert np.diff(stamps).min() > 0
    late = 1e-9 * (arrival - stamps)
    assert np.diff(arrival).min() >= 0
    assert late.min() >= 0.008 - 1e-9
    assert 0.011 < late.mean() < 0.014
    for topic, stream in (("imu", sent.recording.imu), ("rotor_speeds", sent.recording.rotor_speeds)):
        np.testing.assert_array_equal(sent.arrival_ns[topic], stream.time_ns)


def test_wild_jitter_keeps_frames_in_order_and_in_the_flight(truth):
    stamps = sensed(truth, replace(PERFECT, mocap=MotionCapture(capture_jitter=1.0))).recording.pose.time_ns
    assert np.diff(stamps).min() > 0
    assert truth.time_ns[0] <= stamps[0]
    assert stamps[-1] <= truth.time_ns[-1]


def frames_seen(truth, **mocap):
    """Which of the frames are seen (480 in 4 s), and the largest of |roll|, |pitch| in each."""
    pose = sensed(truth, replace(PERFECT, mocap=MotionCapture(**mocap))).recording.pose
    every = sensed(truth).recording.pose
    w, x, y, z = every.attitude.T
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(2 * (w * y - x * z))
    return np.isin(every.time_ns, pose.time_ns), np.maximum(np.abs(roll), np.abs(pitch))


def test_markers_are_hidden_only_while_tilted(long_truth):
    seen, tilt = frames_seen(long_truth, obscured_angle=25.0, obscured_share=1.0)
    near = np.abs(tilt - ANGLE) < 1e-9
    np.testing.assert_array_equal(seen[~near], tilt[~near] < ANGLE)
    assert 0.2 < np.mean(seen) < 0.8


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.6), (0.6, 0.0), (-2.5, 0.0)])
def test_either_roll_or_pitch_hides_the_markers(swing, roll, pitch):
    seen, tilt = frames_seen(swing(4.0, roll=roll, pitch=pitch), obscured_angle=25.0)
    np.testing.assert_array_equal(seen, tilt < ANGLE)
    assert not np.all(seen)


def test_markers_are_hidden_in_bursts(long_truth):
    seen, tilt = frames_seen(long_truth, obscured_angle=25.0, obscured_share=0.4, obscured_burst=0.05)
    tilted = tilt > ANGLE
    assert seen[~tilted].all()
    np.testing.assert_allclose(np.mean(~seen[tilted]), 0.4, atol=0.08)
    # Of two frames in a row while tilted: once hidden, hidden again but for one in 0.05 s of frames.
    both = tilted[1:] & tilted[:-1] & ~seen[:-1]
    np.testing.assert_allclose(np.mean(seen[1:][both]), 1.0 / (0.05 * 120.0), atol=0.04)


def test_frames_drop_out_at_random(long_truth):
    seen, tilt = frames_seen(long_truth, dropout_probability=0.1)
    np.testing.assert_allclose(np.mean(~seen), 0.1, atol=0.02)
    assert abs(np.corrcoef(seen, tilt)[0, 1]) < 0.06


def test_one_sensor_does_not_change_the_noise_of_another(truth):
    suite = SensorSuite.load("mpu6000")
    before = sensed(truth, suite)
    assert_streams_equal(before, sensed(truth, suite))
    for change, topic in (
        ({"imu": replace(suite.imu, gyro=InertialSensor(noise=1.0))}, "imu"),
        ({"rotor_speeds": RotorSpeedSensor(rate=250.0, noise=50.0)}, "rotor_speeds"),
        ({"mocap": MotionCapture(rate=60.0, position_noise=1.0)}, "mocap/pose"),
        ({"wind": Anemometer(rate=50.0, noise=1.0)}, "wind"),
    ):
        assert_streams_equal(before, sensed(truth, replace(suite, **change)), but={topic})
    gyro_alone = sensed(truth, replace(suite, imu=replace(suite.imu, gyro=InertialSensor(noise=1.0))))
    np.testing.assert_array_equal(
        gyro_alone.recording.imu.specific_force, before.recording.imu.specific_force
    )


def test_other_seeds_give_other_noise(truth):
    suite = SensorSuite.load("mpu6000")
    topics = {"imu", "rotor_speeds", "mocap/pose", "wind"}
    assert_streams_equal(sensed(truth, suite, seed=1), sensed(truth, suite, seed=2), but=topics)


def test_effects_of_sensors_come_before_their_noise(truth):
    suite = replace(PERFECT, imu=Imu(accelerometer=InertialSensor(range=15.0)))
    bias = {"accelerometer_bias": {"x_m_s2": 0.5, "y_m_s2": 0.0, "z_m_s2": -10.0}}
    plain, biased = sensed(truth, suite).recording, sensed(truth, suite, effects=bias).recording
    np.testing.assert_allclose(biased.imu.specific_force[:, 0] - plain.imu.specific_force[:, 0], 0.5)
    assert (biased.imu.specific_force[:, 2] == -15.0).all()


def test_effect_on_rotor_speeds_shows_in_the_electrical_ones(truth):
    scaled = sensed(truth, effects={"rotor_speed_scale": {"rotor": 2, "change": -0.5}})
    np.testing.assert_allclose(scaled.erpm[:, 1], 0.5 * sensed(truth).erpm[:, 1], atol=1.0)
    np.testing.assert_array_equal(scaled.erpm[:, 0], sensed(truth).erpm[:, 0])


def test_faults_come_last_and_nothing_is_not_finite_without_one(truth):
    suite = SensorSuite.load("mpu6000")
    fault = {"kind": "not_finite", "topic": "rotor_speeds", "rotors": [3], "at_s": 1.0, "for_s": 0.5}
    before, after = sensed(truth, suite), sensed(truth, suite, faults=[fault])
    for stream in before.recording.streams():
        stream.check("sensed")
    assert_streams_equal(before, after, but={"rotor_speeds"})
    broken = np.flatnonzero(np.isnan(after.erpm).any(axis=1))
    np.testing.assert_array_equal(broken, np.arange(500, 750))
    np.testing.assert_array_equal(np.isnan(after.recording.rotor_speeds.speeds), np.isnan(after.erpm))
    assert np.isfinite(after.erpm[:, [0, 1, 3]]).all()


def test_a_half_reading_sensor_sends_whole_numbers(truth):
    fault = {"kind": "half_reading", "topic": "rotor_speeds", "rotors": [1], "at_s": 0.0, "for_s": 9.0}
    half = sensed(truth, faults=[fault])
    np.testing.assert_array_equal(half.erpm, np.rint(half.erpm))
    np.testing.assert_allclose(half.erpm[:, 0], 0.5 * sensed(truth).erpm[:, 0], atol=1.0)


def test_dropout_of_poses_drops_their_arrivals_too(truth):
    fault = {"kind": "dropout", "topic": "mocap/pose", "at_s": 1.0, "for_s": 1.5}
    sent = sensed(truth, SensorSuite.load("paper"), faults=[fault])
    stamps = sent.recording.pose.time_ns
    assert len(stamps) == len(sent.arrival_ns["mocap/pose"])
    assert 1.5 <= 1e-9 * np.diff(stamps).max() < 1.52
