# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator does when motion capture is late, gone, moved, frozen or of another kind."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import EkfTrace
from quadpi_core.estimator.filter_state import EstimatorStatus, Outcome
from quadpi_core.flight import PoseStream, TwistStream
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.vehicle import Vehicle

RATE = 500.0
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
