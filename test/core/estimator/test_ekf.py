# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from quadpi_core.errors import SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import EkfTrace
from quadpi_core.estimator.filter_state import EstimatorStatus, Outcome
from quadpi_core.logs.formats.cfusdlog import read_cfusdlog
from quadpi_core.logs.formats.neurobem import read_neurobem
from quadpi_core.vehicle import Vehicle
from test.core.known_flights import feed

RATE = 500.0


def attitude_error(estimated, true):
    """Rotation vectors (N, 3) rad from the estimated to the true attitudes (N, 4), body axes."""
    first, second = (Rotation.from_quat(np.roll(np.atleast_2d(q), -1, axis=1)) for q in (estimated, true))
    return (first.inv() * second).as_rotvec()


def squared_error(state, simulated, index):
    """NEES: error in units of the covariance; chi-square of 15 degrees if the filter is consistent."""
    true = simulated.truth
    error = np.concatenate(
        (
            true.position[index] - state.position,
            true.velocity[index] - state.velocity,
            attitude_error(state.attitude, true.attitude[index])[0],
            simulated.gyro_bias[index] - state.gyro_bias,
            simulated.accelerometer_bias[index] - state.accelerometer_bias,
        )
    )
    return error @ np.linalg.solve(state.covariance[:15, :15], error)


@pytest.mark.slow
def test_nees_within_its_bounds_and_covariance_stays_positive_definite(noisy_vehicle, simulate_flight):
    runs = 25
    nees = []
    for seed in range(runs):
        simulated = simulate_flight(seed)
        ekf = Ekf(noisy_vehicle, RATE)
        row = []
        for index, _ in feed(ekf, simulated.recording):
            if index >= 1000 and index % 250 == 0:
                row.append(squared_error(ekf.state, simulated, index))
                assert np.array_equal(ekf.state.covariance, ekf.state.covariance.T)
                assert np.linalg.eigvalsh(ekf.state.covariance)[0] > 0.0
        nees.append(row)
    per_instant = np.mean(nees, axis=0)
    low, high = chi2.ppf([0.025, 0.975], runs * 15) / runs
    inside = (per_instant > low) & (per_instant < high)
    assert len(inside) == 12
    assert np.mean(inside) >= 0.75, per_instant
    assert low < np.mean(per_instant) < high


def test_recovers_state_and_biases(noisy_vehicle, simulated):
    trace = Ekf(noisy_vehicle, RATE).run(simulated.recording)
    late = slice(-1000, None)
    true = simulated.truth
    assert np.sqrt(np.mean((trace.velocity[late] - true.velocity[late]) ** 2)) < 0.03
    assert np.sqrt(np.mean((trace.position[late] - true.position[late]) ** 2)) < 0.003
    assert np.sqrt(np.mean(attitude_error(trace.attitude[late], true.attitude[late]) ** 2)) < 0.005
    np.testing.assert_allclose(trace.gyro_bias[-1], simulated.gyro_bias[-1], atol=0.01)
    np.testing.assert_allclose(trace.accelerometer_bias[-1], simulated.accelerometer_bias[-1], atol=0.15)
    assert np.max(np.abs(simulated.accelerometer_bias[-1])) > 0.2


@pytest.fixture
def running(noisy_vehicle, simulate_flight):
    """A filter that has seen 1.2 s, and the stamp of its last IMU sample."""
    recording = simulate_flight(4, duration=1.2).recording
    ekf = Ekf(noisy_vehicle, RATE)
    for _ in feed(ekf, recording):
        pass
    return ekf, int(recording.imu.time_ns[-1])


def snapshot(ekf):
    return ekf.state.rows.copy()


def assert_same(before, ekf):
    assert np.array_equal(before, ekf.state.rows)


def test_bad_samples_are_refused_counted_and_leave_no_trace(running):
    ekf, last_ns = running
    before = snapshot(ekf)
    still, upright = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    bad = np.array([0.0, np.nan, 0.0])
    assert ekf.step(last_ns + 2_000_000, bad, still).outcome == Outcome.UNUSABLE
    assert ekf.step(last_ns + 2_000_000, still, np.array([0.0, 0.0, -1e30])).outcome == Outcome.UNUSABLE
    assert ekf.step(last_ns + 2_000_000, np.array([5e3, 0.0, 0.0]), still).outcome == Outcome.UNUSABLE
    assert ekf.step(last_ns, still, still).outcome == Outcome.STAMP_NOT_ADVANCING
    assert ekf.update_pose(last_ns, bad, upright) == Outcome.UNUSABLE
    assert ekf.update_pose(last_ns, np.array([0.0, 1e30, 0.0]), upright) == Outcome.UNUSABLE
    assert ekf.update_pose(last_ns, still, np.zeros(4)) == Outcome.UNUSABLE
    assert ekf.update_pose(last_ns, still, np.full(4, np.inf)) == Outcome.UNUSABLE
    assert ekf.update_pose(last_ns + 500_000_000, still, upright) == Outcome.TOO_EARLY
    assert_same(before, ekf)
    assert ekf.imu_counts[Outcome.UNUSABLE] == 3
    assert ekf.pose_counts[Outcome.UNUSABLE] == 4
    assert ekf.pose_counts[Outcome.TOO_EARLY] == 1


def arriving_late(recording, lateness_ns, stamp_ns=0):
    """The poses arrive so much after they were true; of that, their stamps are late by `stamp_ns`."""
    pose = recording.pose
    after = np.searchsorted(recording.imu.time_ns, pose.time_ns + lateness_ns, side="right")
    late = replace(pose, time_ns=pose.time_ns + stamp_ns)
    return replace(recording, pose=late, arrivals={pose.topic: after})


def velocity_error(vehicle, recording, true):
    trace = Ekf(vehicle, RATE).run(recording)
    late = trace.time_ns > 3_000_000_000
    index = np.searchsorted(recording.imu.time_ns, trace.time_ns[late])
    return np.sqrt(np.mean(np.square(trace.velocity[late] - true.velocity[index])))


def test_poses_that_arrive_late_cost_what_dead_reckoning_costs(noisy_vehicle, simulated):
    recording, true = simulated.recording, simulated.truth
    at_once = velocity_error(noisy_vehicle, recording, true)
    assert velocity_error(noisy_vehicle, arriving_late(recording, 9_000_000), true) < 1.05 * at_once
    assert velocity_error(noisy_vehicle, arriving_late(recording, 200_000_000), true) < 1.6 * at_once


def test_a_pose_changes_nothing_before_its_time_and_too_late_nothing_at_all(running):
    ekf, last_ns = running
    still, force = np.zeros(3), np.array([0.0, 0.0, -9.8])
    last_ns += 20_000_000
    ekf.step(last_ns, still, force)
    ekf.update_pose(last_ns, ekf.state.position + 0.01, ekf.state.attitude)
    used = ekf.pose_counts[Outcome.USED]
    for step_ns in range(2_000_000, 10_000_000, 2_000_000):
        ekf.step(last_ns + step_ns, still, force)
        assert ekf.pose_counts[Outcome.USED] == used
    ekf.step(last_ns + 10_000_000, still, force)
    assert ekf.pose_counts[Outcome.USED] == used + 1
    for step_ns in range(20_000_000, 800_000_000, 20_000_000):
        ekf.step(last_ns + step_ns, still, force)
    ekf.update_pose(last_ns + 100_000_000, still, np.array([1.0, 0.0, 0.0, 0.0]))
    ekf.step(last_ns + 802_000_000, still, force)
    assert ekf.pose_counts[Outcome.TOO_LATE] == 1


@pytest.mark.parametrize("delay_ns", [0, 60_000_000, 120_000_000, 200_000_000])
def test_the_delay_of_motion_capture_is_found(noisy_vehicle, simulated, delay_ns):
    ekf = Ekf(noisy_vehicle, RATE)
    ekf.run(arriving_late(simulated.recording, delay_ns + 5_000_000, delay_ns))
    assert abs(ekf.delay_s - 1e-9 * delay_ns) < min(4.0 * ekf.delay_std_s, 0.004)
    assert ekf.delay_std_s < 0.003
    assert ekf.status == EstimatorStatus.OK


def test_a_delay_that_is_trusted_stays(noisy_vehicle, simulated):
    noise = replace(noisy_vehicle.noise, mocap_delay_s=0.05, mocap_delay_std_s=0.0)
    ekf = Ekf(replace(noisy_vehicle, noise=noise), RATE)
    ekf.run(arriving_late(simulated.recording, 55_000_000, 50_000_000))
    assert (ekf.delay_s, ekf.delay_std_s) == (0.05, 0.0)
    assert ekf.pose_counts[Outcome.REJECTED] < 5


def test_sign_and_scale_of_a_pose_attitude_do_not_matter(noisy_vehicle, simulate_flight):
    recording = simulate_flight(4, duration=2.0).recording
    pose = recording.pose
    scaled = replace(recording, pose=replace(pose, attitude=-2.0 * pose.attitude))
    one, other = (Ekf(noisy_vehicle, RATE).run(each) for each in (recording, scaled))
    np.testing.assert_allclose(one.velocity, other.velocity, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.variance, other.variance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("jump_ns", [150_000_000, -2_000_000_000])
def test_a_pause_or_a_jump_back_starts_anew(running, jump_ns):
    ekf, last_ns = running
    for step_ns, outcome in ((0, Outcome.STAMP_JUMPED), (2_000_000, Outcome.RESET)):
        assert ekf.step(last_ns + jump_ns + step_ns, np.zeros(3), np.zeros(3)).outcome == outcome
    assert not ekf.initialised
    with pytest.raises(SignalError, match="not initialised"):
        _ = ekf.state


@pytest.mark.parametrize("jump_ns", [31_536_000_000_000_000, -1_700_000_000_000_000_000])
def test_one_stamp_that_is_far_off_is_refused_and_the_rest_goes_on(running, jump_ns):
    ekf, last_ns = running
    assert ekf.step(last_ns + jump_ns, np.zeros(3), np.zeros(3)).outcome == Outcome.STAMP_JUMPED
    assert ekf.step(last_ns + 2_000_000, np.zeros(3), np.zeros(3)).outcome == Outcome.USED
    assert ekf.step(last_ns + jump_ns + 2_000_000, np.zeros(3), np.zeros(3)).outcome == Outcome.STAMP_JUMPED
    assert ekf.initialised


def test_a_pose_from_the_future_does_not_keep_it_from_starting(noisy_vehicle, simulated):
    recording = simulated.recording
    ekf = Ekf(noisy_vehicle, RATE)
    wild_ns = int(recording.pose.time_ns[0]) + 1_000_000_000_000
    ekf.update_pose(wild_ns, recording.pose.position[0], recording.pose.attitude[0])
    assert next(feed(ekf, recording), None) is not None


def test_coasts_through_a_mocap_dropout_and_recovers(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    keep = (pose.time_ns < 4_000_000_000) | (pose.time_ns > 4_500_000_000)
    gappy = replace(pose, **{column.name: getattr(pose, column.name)[keep] for column in fields(pose)})
    trace = Ekf(noisy_vehicle, RATE).run(replace(simulated.recording, pose=gappy))
    index = np.searchsorted(simulated.recording.imu.time_ns, trace.time_ns)
    error = np.linalg.norm(trace.position - simulated.truth.position[index], axis=1)
    std = np.sqrt(trace.variance[:, :3].sum(axis=1))
    during = np.searchsorted(trace.time_ns, 4_490_000_000)
    assert std[during] > 3.0 * std[during - 300]
    assert np.all(error < 5.0 * std)
    assert error[-1] < 0.01


def rms(difference):
    return np.sqrt(np.mean(difference**2, axis=0))


def against_odometry(trace: EkfTrace, recording):
    """RMS differences of position m, body velocity m/s and attitude rad from the recording's odometry."""
    odometry = recording.odometry
    index = np.searchsorted(odometry.time_ns, trace.time_ns)
    return (
        rms(trace.position - odometry.position[index]),
        rms(trace.velocity_body - odometry.velocity[index]),
        rms(attitude_error(trace.attitude, odometry.attitude[index])),
    )


@pytest.mark.parametrize("number", [0, 6, 12, 17, 21])
def test_crazyflie_agrees_with_the_onboard_estimate(shared_data, number):
    vehicle = Vehicle.load("crazyflie_rpm")
    recording = read_cfusdlog(shared_data / "imrc_brushless" / f"eckart{number:02d}", vehicle)
    trace = Ekf(vehicle, RATE).run(recording)
    position, velocity, attitude = against_odometry(trace, recording)
    assert np.max(position) < 0.03
    assert np.max(velocity) < 0.15
    assert np.max(attitude) < 0.05


@pytest.mark.parametrize(
    ("flight", "velocity_limit"), [("bemnn20210223104803seg2", 0.01), ("bemnn20210218172600seg1", 0.15)]
)
def test_neurobem_velocity_agrees_with_the_file(shared_data, flight, velocity_limit):
    vehicle = Vehicle.load("neurobem")
    recording = read_neurobem(shared_data / "neurobem" / f"{flight}.mat", vehicle)
    trace = Ekf(vehicle, 400.0).run(recording)
    assert np.max(against_odometry(trace, recording)[1]) < velocity_limit
