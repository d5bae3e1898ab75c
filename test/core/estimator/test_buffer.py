# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Late, repeated and contradicting motion capture, where the answer of the filter changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from quadpi_core import frames
from quadpi_core.core import compiled
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    ESTIMATE,
    IMU_SAMPLE,
    POSITION,
    VELOCITY,
    EstimatorStatus,
    Outcome,
    allocate,
    begin,
)
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

MS = 1_000_000
STEP_NS, POSE_EVERY = 2 * MS, 5
VEHICLE = Vehicle.load("neurobem")
VEHICLE = replace(VEHICLE, noise=replace(VEHICLE.noise, mocap_delay_s=0.0, mocap_delay_std_s=0.0))
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
STILL, HOVER = np.zeros(3), np.array([0.0, 0.0, -VEHICLE.gravity_m_s2])


class Hover:
    """A filter that a hovering vehicle feeds, IMU at 500 Hz; poses only where a test gives them."""

    def __init__(self) -> None:
        self.ekf = Ekf(VEHICLE, 500.0)
        self.rng = np.random.default_rng(3)
        self.now_ns = 0

    def imu(self, count: int = 1) -> None:
        for _ in range(count):
            self.now_ns += STEP_NS
            self.ekf.step(self.now_ns, STILL, HOVER)

    def pose(self, time_ns: int, offset: Array = STILL) -> Outcome:
        """A pose with the noise of motion capture."""
        noise = VEHICLE.noise.mocap_position_m * self.rng.standard_normal(3)
        return self.ekf.update_pose(time_ns, offset + noise, LEVEL)

    def fly(self, seconds: float, offset: Array = STILL) -> None:
        for _ in range(round(seconds * 100)):
            self.imu(POSE_EVERY)
            self.pose(self.now_ns, offset)

    def counted(self, outcome: Outcome) -> int:
        return self.ekf.pose_counts[outcome]


@pytest.fixture
def hover() -> Hover:
    flown = Hover()
    flown.fly(4.0)
    assert flown.ekf.status is EstimatorStatus.OK
    return flown


def test_a_pose_is_held_for_ten_milliseconds(hover: Hover) -> None:
    hover.imu(10)
    used = hover.counted(Outcome.USED)
    hover.pose(hover.now_ns)
    hover.imu(4)
    assert hover.counted(Outcome.USED) == used
    hover.imu()
    assert hover.counted(Outcome.USED) == used + 1


def test_the_order_of_arrival_of_poses_and_velocities_changes_nothing(hover: Hover) -> None:
    other = Hover()
    other.fly(4.0)
    for one, velocity_first in ((hover, True), (other, False)):
        one.imu(2)
        early_ns, late_ns = one.now_ns - 3 * MS, one.now_ns - MS
        give = [
            lambda one=one, at=late_ns: one.ekf.update_velocity(at, np.array([0.01, 0.0, 0.0]), False),
            lambda one=one, at=early_ns: one.ekf.update_pose(at, np.array([0.001, 0.0, 0.0]), LEVEL),
        ]
        for update in give if velocity_first else reversed(give):
            assert update() is Outcome.COLLECTED
        one.imu(20)
    np.testing.assert_array_equal(hover.ekf.state.rows, other.ekf.state.rows)


@pytest.mark.parametrize(("late_ms", "outcome"), [(480, Outcome.USED), (530, Outcome.TOO_LATE)])
def test_poses_of_the_last_half_second_are_fused(hover: Hover, late_ms: int, outcome: Outcome) -> None:
    hover.imu(300)
    before = hover.counted(outcome)
    hover.pose(hover.now_ns - late_ms * MS)
    hover.imu(10)
    assert hover.counted(outcome) == before + 1


def test_a_value_that_repeats_twelve_times_is_frozen(hover: Hover) -> None:
    frozen = hover.counted(Outcome.FROZEN)
    place = np.array([0.002, 0.001, 0.0])
    for _ in range(13):
        hover.imu(POSE_EVERY)
        hover.ekf.update_pose(hover.now_ns, place, LEVEL)
    hover.imu(10)
    assert hover.counted(Outcome.FROZEN) == frozen + 1  # the first is new, eleven may repeat it


def test_contradicting_poses_are_believed_after_they_agree_for_0_4_s(hover: Hover) -> None:
    """Until then they are rejected, at 100 Hz forty of them."""
    moved = np.array([1.5, 0.0, 0.0])
    hover.fly(0.39, moved)
    assert abs(hover.ekf.state.position[0]) < 0.1
    hover.fly(0.3, moved)
    assert hover.ekf.state.position[0] == pytest.approx(1.5, abs=0.1)
    assert 39 <= hover.counted(Outcome.REJECTED) <= 42


@pytest.mark.parametrize(
    ("limit_ns", "before", "after"),
    [
        (250 * MS, EstimatorStatus.OK, EstimatorStatus.DEGRADED),
        (2000 * MS, EstimatorStatus.DEGRADED, EstimatorStatus.LOST),
    ],
)
def test_the_status_follows_the_time_without_a_correction(
    hover: Hover, limit_ns: int, before: EstimatorStatus, after: EstimatorStatus
) -> None:
    hover.imu(10)
    since_ns = round(1e9 * hover.ekf.since_correction_s)
    hover.imu((limit_ns - since_ns) // STEP_NS)
    assert hover.ekf.status is before
    hover.imu()
    assert hover.ekf.status is after
    hover.fly(1.0)
    assert hover.ekf.status is EstimatorStatus.OK


def test_five_contradicting_poses_are_the_fewest_that_are_believed(hover: Hover) -> None:
    """Of slow motion capture, which contradicts for 0.4 s with fewer."""
    moved, rejected = np.array([1.5, 0.0, 0.0]), hover.counted(Outcome.REJECTED)
    for count in (1, 2, 3, 4, 4, 4):
        hover.imu(75)
        hover.pose(hover.now_ns, moved)
        hover.imu(10)
        assert hover.counted(Outcome.REJECTED) == rejected + count
    assert hover.ekf.state.position[0] == pytest.approx(1.5, abs=0.1)


def test_three_contradicting_poses_degrade_the_estimate(hover: Hover) -> None:
    for status in (EstimatorStatus.OK, EstimatorStatus.OK, EstimatorStatus.DEGRADED):
        hover.imu(5)
        hover.pose(hover.now_ns, np.array([1.5, 0.0, 0.0]))
        hover.imu(5)
        assert hover.ekf.status is status


@pytest.mark.parametrize(
    ("velocity_std", "bias_std", "status"),
    [
        (0.049, 0.09, EstimatorStatus.OK),
        (0.051, 0.09, EstimatorStatus.DEGRADED),
        (0.049, 0.11, EstimatorStatus.DEGRADED),
        (1.99, 0.09, EstimatorStatus.DEGRADED),
        (2.01, 0.09, EstimatorStatus.LOST),
    ],
)
def test_the_status_follows_the_uncertainty_of_velocity_and_bias(
    velocity_std: float, bias_std: float, status: EstimatorStatus
) -> None:
    """In m/s and m/s², of the worst axis."""
    memory, estimate = allocate(VEHICLE, 500.0), np.zeros(1, ESTIMATE)
    estimate["covariance"][0, VELOCITY.start + 1, VELOCITY.start + 1] = velocity_std**2
    estimate["covariance"][0, ACCELEROMETER_BIAS.start, ACCELEROMETER_BIAS.start] = bias_std**2
    begin(memory, estimate, 0)
    compiled.catch_up(*memory, np.zeros(0, IMU_SAMPLE))
    assert memory.filter["status"] == status


@pytest.mark.parametrize("pose", [True, False])
@pytest.mark.parametrize(("share", "outcome"), [(0.99, Outcome.USED), (1.01, Outcome.REJECTED)])
def test_gates_are_quantiles_of_chi_square(hover: Hover, pose: bool, share: float, outcome: Outcome) -> None:
    """At 0.9999, of the six numbers of a pose and the three of a velocity."""
    hover.imu(10)
    state, sensors = hover.ekf.state, VEHICLE.noise
    states = [*range(6)[POSITION], *range(9)[ATTITUDE]] if pose else list(range(6)[VELOCITY])
    deviation = [sensors.mocap_position_m] * 3 + [sensors.mocap_attitude_rad] * 3 if pose else [0.1] * 3
    innovation = state.covariance[np.ix_(states, states)] + np.diag(np.square(deviation))
    gate = chi2.ppf(0.9999, len(states))
    off = np.zeros(3)
    off[0] = np.sqrt(share * gate / np.linalg.inv(innovation)[0, 0])
    counts = hover.ekf.pose_counts if pose else hover.ekf.velocity_counts
    before = counts[outcome]
    if pose:
        hover.ekf.update_pose(hover.now_ns, state.position + off, state.attitude.copy())
    else:
        hover.ekf.update_velocity(hover.now_ns, state.velocity + off, False, 0.1)
    hover.imu(10)
    counts = hover.ekf.pose_counts if pose else hover.ekf.velocity_counts
    assert counts[outcome] == before + 1


# Of measurements that contradict the filter: 9 · σ and 3 m/s or 3 rad/s for the time between them.
NOISE, ALONG, ABOUT = VEHICLE.noise, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("along_m", "about_rad", "agree"),
    [
        (0.99 * (9.0 * NOISE.mocap_position_m + 0.3), 0.0, True),
        (1.01 * (9.0 * NOISE.mocap_position_m + 0.3), 0.0, False),
        (0.0, 0.97 * (9.0 * NOISE.mocap_attitude_rad + 0.3), True),
        (0.0, 1.03 * (9.0 * NOISE.mocap_attitude_rad + 0.3), False),
    ],
)
def test_poses_agree_that_one_plausible_motion_explains(
    hover: Hover, along_m: float, about_rad: float, agree: bool
) -> None:
    """Ten of a place to and fro, 0.1 s apart: those that agree are believed."""
    hover.imu(10)
    used = hover.counted(Outcome.USED)
    for k in range(10):
        place, turn = (2.0 + k % 2 * along_m) * ALONG, k % 2 * about_rad * ABOUT
        hover.imu(50)
        hover.ekf.update_pose(hover.now_ns, place, frames.from_rotation_vector(turn))
    hover.imu(10)
    assert (hover.counted(Outcome.USED) > used) == agree


@pytest.mark.parametrize(("pause_ms", "agree"), [(480, True), (520, False)])
def test_poses_half_a_second_apart_do_not_agree(hover: Hover, pause_ms: int, agree: bool) -> None:
    hover.fly(0.35, 2.0 * ALONG)
    hover.imu(pause_ms // 2)
    used = hover.counted(Outcome.USED)
    hover.pose(hover.now_ns, 2.0 * ALONG)
    hover.imu(10)
    assert (hover.counted(Outcome.USED) > used) == agree


@pytest.mark.parametrize(("share", "agree"), [(0.97, True), (1.03, False)])
def test_velocities_agree_that_a_plausible_acceleration_explains(
    hover: Hover, share: float, agree: bool
) -> None:
    """9 · 0.1 m/s, and in 0.1 s 10 m/s² beside the specific force."""
    change = share * (0.9 + 0.1 * (10.0 + VEHICLE.gravity_m_s2))
    used = hover.ekf.velocity_counts[Outcome.USED]
    for k in range(10):
        hover.imu(50)
        hover.ekf.update_velocity(hover.now_ns, (8.0 + k % 2 * change) * ALONG, False, 0.1)
    hover.imu(10)
    assert (hover.ekf.velocity_counts[Outcome.USED] > used) == agree


@pytest.mark.parametrize(("share", "frozen"), [(0.8, 0), (1.2, 1)])
def test_a_value_that_repeats_is_frozen_once_noise_cannot_hide_the_motion(
    hover: Hover, share: float, frozen: int
) -> None:
    """At 1 m/s, once it is four standard deviations behind."""
    place = STILL.copy()
    for _ in range(200):
        hover.imu(POSE_EVERY)
        place = place + 0.01 * ALONG
        hover.ekf.update_velocity(hover.now_ns, ALONG, False, 0.02)
        hover.pose(hover.now_ns, place)
    seen = hover.counted(Outcome.FROZEN)
    hover.imu(10)
    place = place + 0.02 * ALONG
    hover.ekf.update_pose(hover.now_ns, place, LEVEL)
    hover.imu(round(share * 4.0 * NOISE.mocap_position_m * 500.0))
    hover.ekf.update_pose(hover.now_ns, place, LEVEL)
    hover.imu(10)
    assert hover.counted(Outcome.FROZEN) == seen + frozen
