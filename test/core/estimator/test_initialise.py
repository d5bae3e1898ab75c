# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The first estimate is the true state, where the samples of the first second show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BODY_VELOCITY,
    DELAY,
    GYRO_BIAS,
    IMU_SAMPLE,
    MEASUREMENT,
    POSE,
    POSITION,
    VELOCITY,
    WORLD_VELOCITY,
)
from quadpi_core.estimator.initialise import (
    COLLECT_NS,
    CollectedSamples,
    Initial,
    initial_from_poses,
    initial_from_velocities,
)
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

SECOND = 1_000_000_000
GRAVITY = 9.81
VEHICLE = Vehicle.load("neurobem")
NOISE = replace(VEHICLE.noise, mocap_delay_s=0.0, mocap_delay_std_s=0.0)
YAW_RATE, BIAS = 0.8, np.array([0.01, -0.02, 0.005])


def stamps(rate_hz: float, seconds: float = 1.0) -> Array:
    return np.round(np.arange(0.0, seconds + 1e-6, 1.0 / rate_hz) * SECOND).astype(np.int64)


def turning(time_ns: Array) -> Rotation:
    """A vehicle that yaws steadily, rolled by 0.2 rad."""
    yaw = Rotation.from_euler("z", (YAW_RATE * 1e-9 * time_ns)[:, None])
    return yaw * Rotation.from_euler("x", 0.2)


def imu_samples(acceleration: Array, seconds: float = 1.0) -> Records:
    """What an IMU with a gyro bias gives at an acceleration (3,) or (N, 3) in the world."""
    time_ns = stamps(500.0, seconds)
    attitude = turning(time_ns)
    imu = np.zeros(len(time_ns), IMU_SAMPLE)
    imu["time_ns"] = time_ns
    imu["rates"] = attitude.apply([0.0, 0.0, YAW_RATE], inverse=True) + BIAS
    imu["specific_force"] = attitude.apply(acceleration - [0.0, 0.0, GRAVITY], inverse=True)
    return imu


def measurements(kind: int, time_ns: Array, vector: Array) -> Records:
    found = np.zeros(len(time_ns), MEASUREMENT)
    found["time_ns"], found["kind"], found["vector"] = time_ns, kind, vector
    if kind == POSE:
        found["attitude"] = turning(time_ns).as_quat(scalar_first=True)
    return found


def poses(rate_hz: float = 100.0, until_ns: int = SECOND) -> Records:
    time_ns = stamps(rate_hz)
    time_ns = time_ns[time_ns <= until_ns]
    return measurements(POSE, time_ns, 1e-9 * time_ns[:, None] * [1.0, -2.0, 0.5])


def test_poses_give_place_velocity_attitude_and_gyro_bias() -> None:
    initial = initial_from_poses(imu_samples(np.zeros(3)), poses(), NOISE, GRAVITY)
    assert initial is not None
    assert initial.time_ns == initial.imu_ns == SECOND
    estimate = initial.estimate[0]
    np.testing.assert_allclose(estimate["position"], [1.0, -2.0, 0.5])
    np.testing.assert_allclose(estimate["velocity"], [1.0, -2.0, 0.5], rtol=1e-9)
    np.testing.assert_allclose(estimate["gyro_bias"], BIAS, atol=1e-9)
    np.testing.assert_allclose(estimate["attitude"], poses()["attitude"][-1])
    assert np.all(np.linalg.eigvalsh(estimate["covariance"]) >= 0.0)


def test_an_unknown_delay_widens_what_moves() -> None:
    """A delay of unknown 20 ms is 4 cm of a place that moves by 2 m/s."""
    imu, unknown = imu_samples(np.zeros(3)), replace(NOISE, mocap_delay_std_s=0.02)
    known, widened = (initial_from_poses(imu, poses(), noise, GRAVITY) for noise in (NOISE, unknown))
    assert known
    assert widened
    before, after = (np.diag(one.estimate["covariance"][0]) for one in (known, widened))
    assert after[DELAY] == pytest.approx(0.02**2)
    assert after[1] - before[1] == pytest.approx(0.04**2, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "starts"),
    [
        (poses(), True),
        (poses(until_ns=610_000_000), True),
        (poses(until_ns=590_000_000), False),  # later than 0.4 s
        (poses(rate_hz=30.0), True),
        (poses(rate_hz=15.0), False),  # fewer than 5 in 0.2 s
        (poses()[:15], False),  # of the first 0.15 s alone
    ],
)
def test_poses_must_be_recent_and_frequent(given: Records, starts: bool) -> None:
    assert (initial_from_poses(imu_samples(np.zeros(3)), given, NOISE, GRAVITY) is not None) == starts


def test_velocities_of_the_world_give_heading_where_the_acceleration_turns() -> None:
    time_ns = stamps(500.0)
    phase = 2.0 * np.pi * 1e-9 * time_ns[:, None]
    circle = 4.0 * np.hstack((np.cos(phase), np.sin(phase), 0.0 * phase))
    imu = imu_samples(circle)
    imu["rates"] -= BIAS
    velocity = 4.0 / (2.0 * np.pi) * np.hstack((np.sin(phase), 1.0 - np.cos(phase), 0.0 * phase))
    velocities = measurements(WORLD_VELOCITY, time_ns[::5], velocity[::5])
    initial = initial_from_velocities(imu, velocities, NOISE, GRAVITY)
    assert initial is not None
    found = Rotation.from_quat(initial.estimate["attitude"][0], scalar_first=True)
    assert (found.inv() * turning(time_ns[-1:])).magnitude() < 0.02
    np.testing.assert_allclose(initial.estimate["velocity"][0], velocity[-1], atol=1e-9)


def test_velocities_of_the_body_level_it_and_leave_the_heading_free() -> None:
    imu = imu_samples(np.zeros(3))
    imu["rates"] -= BIAS
    velocities = measurements(BODY_VELOCITY, stamps(100.0), np.zeros((101, 3)))
    initial = initial_from_velocities(imu, velocities, NOISE, GRAVITY)
    assert initial is not None
    estimate = initial.estimate[0]
    yaw, _, roll = Rotation.from_quat(estimate["attitude"], scalar_first=True).as_euler("ZYX")
    assert roll == pytest.approx(0.2, abs=1e-3)
    assert yaw == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(np.diag(estimate["covariance"])[VELOCITY], NOISE.mocap_velocity_m_s**2)


def stds(initial: Initial | None) -> Array:
    """Standard deviations (16,) of the error state."""
    assert initial is not None
    return np.sqrt(np.diag(initial.estimate["covariance"][0]))


def test_the_first_estimate_is_as_uncertain_as_what_it_is_made_from() -> None:
    """A line through poses, a gyro whose bias they show, an accelerometer whose bias nothing shows."""
    found = stds(initial_from_poses(imu_samples(np.zeros(3)), poses(), NOISE, GRAVITY))
    np.testing.assert_allclose(found[POSITION], NOISE.mocap_position_m)
    np.testing.assert_allclose(found[VELOCITY], 1.0)
    np.testing.assert_allclose(found[ATTITUDE], NOISE.mocap_attitude_rad)
    np.testing.assert_allclose(found[GYRO_BIAS], np.hypot(0.02, np.sqrt(2.0) * NOISE.mocap_attitude_rad))
    np.testing.assert_allclose(found[ACCELEROMETER_BIAS], 0.3)


@pytest.mark.parametrize(("acceleration", "heading_std"), [(0.0, 1.8), (0.9, 1.8), (1.2, 0.6), (40.0, 0.05)])
def test_a_heading_is_known_from_accelerations_of_0_3_m_s_in_a_second(
    acceleration: float, heading_std: float
) -> None:
    """Flown in a circle within the second."""
    time_ns = stamps(500.0)
    phase = 2.0 * np.pi * 1e-9 * time_ns[:, None]
    imu = imu_samples(acceleration * np.hstack((np.cos(phase), np.sin(phase), 0.0 * phase)))
    imu["rates"] -= BIAS
    speed = acceleration / (2.0 * np.pi)
    velocity = speed * np.hstack((np.sin(phase), 1.0 - np.cos(phase), 0.0 * phase))
    velocities = measurements(WORLD_VELOCITY, time_ns[::5], velocity[::5])
    noise = replace(NOISE, mocap_velocity_m_s=0.1)
    initial = initial_from_velocities(imu, velocities, noise, GRAVITY)
    assert initial is not None
    covariance = initial.estimate["covariance"][0][ATTITUDE, ATTITUDE]
    lowest, _, highest = np.sqrt(np.linalg.eigvalsh(covariance))
    assert lowest == pytest.approx(0.1)
    assert np.sqrt(highest**2 - 0.1**2) == pytest.approx(heading_std, rel=0.1)
    np.testing.assert_allclose(stds(initial)[GYRO_BIAS], np.sqrt(2.0) * 0.02)


def test_samples_are_collected_for_a_second_and_old_ones_are_forgotten() -> None:
    collected = CollectedSamples(replace(VEHICLE, noise=NOISE))
    imu, late = imu_samples(np.zeros(3), 3.0), poses()
    late["time_ns"] += SECOND
    for k, sample in enumerate(imu):
        collected.imu.append(imu[k : k + 1])
        block = collected.second_of_imu
        assert (block is None) == (sample["time_ns"] < COLLECT_NS)
        if sample["time_ns"] == 2 * SECOND:
            break
        if block is not None:
            assert collected.initial(block) is None  # there is no pose yet
            assert block["time_ns"][-1] - collected.imu[0]["time_ns"][0] <= COLLECT_NS
    collected.measurements.extend(late[k : k + 1] for k in range(len(late)))
    initial = collected.initial(block)
    assert initial is not None
    assert initial.time_ns == 2 * SECOND
