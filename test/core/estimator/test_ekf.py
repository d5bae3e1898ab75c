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
from quadpi_core.flight import PoseStream, TwistStream
from quadpi_core.frames import rotate_world_to_body
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


SECOND = 1_000_000_000


def kept(stream, keep):
    return replace(stream, **{column.name: getattr(stream, column.name)[keep] for column in fields(stream)})


def run(vehicle: Vehicle, simulated, pose: PoseStream | None, **streams) -> tuple[Ekf, EkfTrace]:
    ekf = Ekf(vehicle, RATE)
    return ekf, ekf.run(replace(simulated.recording, pose=pose, **streams))


def errors(trace: EkfTrace, simulated, after_s: float):
    """Position m and velocity m/s, estimated less true (M, 3), and which rows they are."""
    rows = np.flatnonzero(trace.time_ns > after_s * SECOND)
    index = np.searchsorted(simulated.recording.imu.time_ns, trace.time_ns[rows])
    true = simulated.truth
    return trace.position[rows] - true.position[index], trace.velocity[rows] - true.velocity[index], rows


def during(trace: EkfTrace, begin_s: float, end_s: float) -> set[EstimatorStatus]:
    rows = (trace.time_ns > begin_s * SECOND) & (trace.time_ns < end_s * SECOND)
    return {EstimatorStatus(status) for status in np.unique(trace.status[rows])}


@pytest.mark.parametrize("length_s", [1.0, 2.0, 3.0])
def test_a_drop_out_grows_uncertain_and_ends_without_a_jump_beyond_that(noisy_vehicle, simulated, length_s):
    pose = simulated.recording.pose
    keep = (pose.time_ns < 3 * SECOND) | (pose.time_ns > (3.0 + length_s) * SECOND)
    ekf, trace = run(noisy_vehicle, simulated, kept(pose, keep))
    position, velocity, rows = errors(trace, simulated, 3.0)
    assert np.all(np.abs(position) < 4.5 * np.sqrt(trace.variance[rows, :3]))
    assert np.all(np.abs(velocity) < 4.5 * np.sqrt(trace.variance[rows, 3:6]))
    lasts = trace.time_ns < (3.0 + length_s) * SECOND
    assert np.max(trace.variance[lasts, 0]) > 100.0 * trace.variance[-1, 0]
    assert np.max(np.abs(velocity[-500:])) < 0.1
    assert EstimatorStatus.DEGRADED in during(trace, 3.3, 3.0 + length_s)
    assert (EstimatorStatus.LOST in during(trace, 3.0, 3.0 + length_s)) == (length_s > 2.1)
    assert during(trace, 3.1 + length_s, 8.0) == {EstimatorStatus.OK}
    assert ekf.imu_counts[Outcome.RESET] == 0


def test_motion_capture_that_begins_anew_elsewhere_is_taken_after_a_while(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    after = pose.time_ns > 4 * SECOND
    yaw = Rotation.from_euler("z", 0.5)
    position, attitude = pose.position.copy(), pose.attitude.copy()
    position[after] = yaw.apply(position[after]) + np.array([2.0, -1.0, 0.5])
    turned = yaw * Rotation.from_quat(np.roll(attitude[after], -1, axis=1))
    attitude[after] = np.roll(turned.as_quat(), 1, axis=1)
    ekf, trace = run(noisy_vehicle, simulated, replace(pose, position=position, attitude=attitude))
    assert 40 <= ekf.pose_counts[Outcome.REJECTED] <= 60
    assert EstimatorStatus.DEGRADED in during(trace, 4.05, 4.4)
    assert during(trace, 5.0, 8.0) == {EstimatorStatus.OK}
    late = trace.time_ns > 6 * SECOND
    index = np.searchsorted(simulated.recording.imu.time_ns, trace.time_ns[late])
    expected = yaw.apply(simulated.truth.velocity[index])
    assert np.max(np.abs(trace.velocity[late] - expected)) < 0.15


def test_a_step_of_the_delay_is_found_out(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    late_ns = np.where(pose.time_ns > 4 * SECOND, 80_000_000, 0)
    time_ns = pose.time_ns + late_ns
    ekf, trace = run(noisy_vehicle, simulated, replace(pose, time_ns=time_ns))
    assert abs(ekf.delay_s - 0.08) < 4.0 * ekf.delay_std_s + 0.002
    assert during(trace, 5.5, 8.0) == {EstimatorStatus.OK}
    assert np.sqrt(np.mean(errors(trace, simulated, 6.5)[1] ** 2)) < 0.05


def test_spikes_are_rejected_and_leave_no_trace(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    rng = np.random.default_rng(3)
    spikes = (rng.random(len(pose)) < 0.1) & (pose.time_ns > 2 * SECOND)
    position = pose.position + spikes[:, None] * rng.normal(scale=1.0, size=pose.position.shape)
    ekf, trace = run(noisy_vehicle, simulated, replace(pose, position=position))
    assert abs(ekf.pose_counts[Outcome.REJECTED] - int(spikes.sum())) <= 3
    assert np.sqrt(np.mean(errors(trace, simulated, 3.0)[1] ** 2)) < 0.03


def test_a_frozen_motion_capture_is_not_fused_as_new(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    frozen = (pose.time_ns > 4 * SECOND) & (pose.time_ns < 5 * SECOND)
    first = int(np.argmax(frozen))
    position, attitude = pose.position.copy(), pose.attitude.copy()
    position[frozen], attitude[frozen] = position[first], attitude[first]
    ekf, trace = run(noisy_vehicle, simulated, replace(pose, position=position, attitude=attitude))
    assert ekf.pose_counts[Outcome.FROZEN] == frozen.sum() - 1
    position_error, _, rows = errors(trace, simulated, 4.0)
    assert np.all(np.abs(position_error) < 4.5 * np.sqrt(trace.variance[rows, :3]))
    assert EstimatorStatus.DEGRADED in during(trace, 4.3, 5.0)
    assert during(trace, 5.1, 8.0) == {EstimatorStatus.OK}


def twist_of(simulated, body: bool, noise: float) -> TwistStream:
    rng = np.random.default_rng(8)
    imu, true = simulated.recording.imu, simulated.truth
    some = slice(None, None, 5)
    velocity = rotate_world_to_body(true.attitude, true.velocity) if body else true.velocity
    seen = velocity[some] + rng.normal(scale=noise, size=velocity[some].shape)
    return TwistStream(imu.time_ns[some], seen, np.full(len(seen), body))


@pytest.mark.parametrize("body", [True, False])
def test_velocities_alone_start_it_and_level_it(noisy_vehicle, simulated, body):
    ekf, trace = run(noisy_vehicle, simulated, None, twist=twist_of(simulated, body, 0.05))
    late = trace.time_ns > 5 * SECOND
    index = np.searchsorted(simulated.recording.imu.time_ns, trace.time_ns[late])
    true = simulated.truth
    expected = rotate_world_to_body(true.attitude[index], true.velocity[index])
    assert np.sqrt(np.mean((trace.velocity_body[late] - expected) ** 2)) < 0.08
    down = rotate_world_to_body(trace.attitude[late], np.array([0.0, 0.0, 1.0]))
    true_down = rotate_world_to_body(true.attitude[index], np.array([0.0, 0.0, 1.0]))
    tilt = np.arccos(np.clip(np.sum(down * true_down, axis=1), -1.0, 1.0))
    assert np.degrees(np.sqrt(np.mean(tilt**2))) < 2.5
    assert ekf.velocity_counts[Outcome.USED] > 600
    if not body:
        assert np.sqrt(np.mean((trace.velocity[late] - true.velocity[index]) ** 2)) < 0.1


def test_an_odometry_is_both_and_better_than_its_pose(noisy_vehicle, simulated):
    pose = simulated.recording.pose
    sparse = kept(pose, slice(None, None, 4))
    _, alone = run(noisy_vehicle, simulated, sparse)
    twist = twist_of(simulated, True, 0.02)
    vehicle = replace(noisy_vehicle, noise=replace(noisy_vehicle.noise, mocap_velocity_m_s=0.02))
    ekf, both = run(vehicle, simulated, sparse, twist=twist)
    assert ekf.velocity_counts[Outcome.USED] > 600
    assert ekf.pose_counts[Outcome.USED] > 150
    error_alone, error_both = (np.sqrt(np.mean(errors(t, simulated, 3.0)[1] ** 2)) for t in (alone, both))
    assert error_both < 0.8 * error_alone


def test_measurements_out_of_order_or_not_a_measurement_are_refused(noisy_vehicle, simulated):
    ekf, _ = run(noisy_vehicle, simulated, simulated.recording.pose)
    last_ns = ekf.state.time_ns
    before = ekf.state.rows.copy()
    assert ekf.update_velocity(last_ns, np.array([0.0, np.nan, 0.0]), True) == Outcome.UNUSABLE
    assert ekf.update_velocity(last_ns, np.array([0.0, 1e6, 0.0]), False) == Outcome.UNUSABLE
    assert ekf.update_velocity(last_ns, np.zeros(3), True) == Outcome.COLLECTED
    assert ekf.update_velocity(last_ns, np.zeros(3), True) == Outcome.STAMP_NOT_ADVANCING
    assert ekf.update_velocity(last_ns - 500_000_000, np.zeros(3), True) == Outcome.STAMP_NOT_ADVANCING
    assert ekf.update_velocity(last_ns + 365 * 86400 * SECOND, np.zeros(3), True) == Outcome.TOO_EARLY
    assert np.array_equal(before, ekf.state.rows)
    assert ekf.velocity_counts[Outcome.UNUSABLE] == 2
