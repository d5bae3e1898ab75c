# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator on simulated flights at 14 m/s: its errors are what it says they are."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import smooth
from quadpi_core.estimator.filter_state import ACCELEROMETER_BIAS, DELAY, GYRO_BIAS, Outcome
from quadpi_core.frames import rotate_body_to_world
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import InertialSensor, SensorSuite, generator, inertial_samples
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.truth import STEP_HZ, Truth
from quadpi_core.vehicle import SensorNoise, Vehicle

RATE = 500.0
SEEDS = 50
SECONDS = 24.0
LOST_FRAMES = 0.2
DELAY_STD_S, DELAY_WALK_S = 0.03, 1e-4
# Instants at which the errors of all flights are compared with their covariances, s.
INSTANTS = np.arange(4.0, SECONDS, 2.5)
STATES = 9
PARTS = {
    "state": slice(0, STATES),
    "gyro bias": GYRO_BIAS,
    "accelerometer bias": ACCELEROMETER_BIAS,
    "delay": slice(DELAY, DELAY + 1),
}


@dataclass(frozen=True)
class Dash:
    truth: Truth
    vehicle: Vehicle
    suite: SensorSuite

    @property
    def velocity(self):
        return rotate_body_to_world(self.truth.attitude, self.truth.velocity)


@pytest.fixture(scope="module")
def dash():
    """The scenario `dash` with the paper's noise; biases and delay are as the filter assumes them."""
    plan = load_scenario("dash").flights[0]
    simulated = SimulatedVehicle.load(plan.vehicle)
    reference = plan.reference(STEP_HZ)
    short = type(reference)(
        **{c.name: getattr(reference, c.name)[: int(SECONDS * STEP_HZ) + 1] for c in fields(reference)}
    )
    truth = simulate_flight(plan.name, simulated, short, seed=plan.seed)
    suite = SensorSuite.load("paper")
    gyro = replace(suite.imu.gyro, bias=0.01, bias_walk=1e-4)
    accelerometer = replace(suite.imu.accelerometer, bias=0.2, bias_walk=1e-3)
    suite = replace(
        suite,
        imu=replace(suite.imu, gyro=gyro, accelerometer=accelerometer),
        mocap=replace(suite.mocap, dropout_probability=LOST_FRAMES),
    )
    noise = SensorNoise(
        accelerometer_noise_m_s2=accelerometer.noise,
        gyro_noise_rad_s=gyro.noise,
        accelerometer_bias_walk=accelerometer.bias_walk,
        gyro_bias_walk=gyro.bias_walk,
        mocap_position_m=suite.mocap.position_noise,
        mocap_attitude_rad=suite.mocap.attitude_noise,
        mocap_delay_std_s=DELAY_STD_S,
    )
    return Dash(truth, replace(simulated.vehicle, noise=noise), suite)


def delay_of(seed: int, pose_ns):
    """How late motion capture's stamps are [s] at poses (N,) taken at `pose_ns`."""
    rng = np.random.default_rng(seed)
    steps = DELAY_WALK_S * np.sqrt(1e-9 * np.diff(pose_ns, prepend=pose_ns[0]))
    return rng.normal(scale=DELAY_STD_S) + np.cumsum(steps * rng.standard_normal(len(pose_ns)))


def bias_of(sensor: InertialSensor, name: str, seed: int, count: int):
    """Bias (N, 3) that a sensor of the flight has: what it sends of nothing, less its white noise."""
    quiet = replace(sensor, noise=0.0, noise_density=0.0)
    return inertial_samples(np.zeros((count, 3)), quiet, RATE, generator(seed, name))


def flown(dash: Dash, seed: int):
    """What the sensors send of a flight, and the biases (N, 3) and delay (N,) at the stamps of its IMU."""
    sensed = sense(dash.truth, dash.vehicle, dash.suite, {}, (), seed)
    imu, pose = sensed.recording.imu, sensed.recording.pose
    delay = delay_of(seed, pose.time_ns)
    stamped_ns = pose.time_ns + np.rint(1e9 * delay).astype(np.int64)
    arrival_ns = sensed.arrival_ns["mocap/pose"] + round(3e9 * DELAY_STD_S)
    after = np.searchsorted(imu.time_ns, arrival_ns, side="right")
    late = replace(pose, time_ns=stamped_ns)
    hidden = np.concatenate(
        (
            bias_of(dash.suite.imu.gyro, "gyro", seed, len(imu)),
            bias_of(dash.suite.imu.accelerometer, "accelerometer", seed, len(imu)),
            np.interp(imu.time_ns, pose.time_ns, delay)[:, None],
        ),
        axis=1,
    )
    return replace(sensed.recording, pose=late, arrivals={pose.topic: after}), hidden


def error_of(state_position, state_velocity, state_attitude, dash: Dash, index):
    """Errors (N, 9) of position, velocity and attitude, true less estimated."""
    true = dash.truth
    first, second = (
        Rotation.from_quat(np.roll(q, -1, axis=1)) for q in (state_attitude, true.attitude[index])
    )
    return np.concatenate(
        (
            true.position[index] - state_position,
            dash.velocity[index] - state_velocity,
            (first.inv() * second).as_rotvec(),
        ),
        axis=1,
    )


class Flown(NamedTuple):
    """Of all flights: NEES by part and NIS (S, T), errors of 12 m/s and more, and rejections."""

    nees: dict[str, np.ndarray]
    nis: np.ndarray
    attitude_rms_deg: float
    velocity_rms_m_s: float
    rejected: float


@pytest.fixture(scope="module")
def flights(dash):
    start_ns = dash.truth.time_ns[0]
    edges = start_ns + np.rint(1e9 * INSTANTS).astype(np.int64)
    fast = np.linalg.norm(dash.velocity, axis=1) > 12.0
    nees, nis, squares, rejected, used = [], [], [], 0, 0
    for seed in range(SEEDS):
        recording, hidden = flown(dash, seed)
        imu, pose = recording.imu, recording.pose
        after = recording.arrivals_of(pose)
        ekf, row, begin_ns = Ekf(dash.vehicle, RATE), [], 0
        for end_ns in edges:
            of_imu = (imu.time_ns > begin_ns) & (imu.time_ns <= end_ns)
            first, last = np.searchsorted(imu.time_ns, (begin_ns, end_ns), side="right")
            of_pose = (after >= first) & (after < last)
            part = replace(
                recording,
                imu=taken(imu, of_imu),
                pose=taken(pose, of_pose),
                arrivals={pose.topic: after[of_pose] - first},
            )
            trace = ekf.run(part)
            index = np.searchsorted(dash.truth.time_ns, trace.time_ns)
            error = error_of(trace.position, trace.velocity, trace.attitude, dash, index)
            squares.append(error[fast[index], 3:] ** 2)
            estimated = (trace.gyro_bias[-1], trace.accelerometer_bias[-1], trace.delay_s[-1:])
            at = np.searchsorted(imu.time_ns, trace.time_ns[-1])
            whole = np.concatenate((error[-1], hidden[at] - np.concatenate(estimated)))
            row.append([nees_of(whole, ekf.state.covariance, part) for part in PARTS.values()])
            begin_ns = end_ns
        nees.append(row)
        (segment,) = Ekf(dash.vehicle, RATE).segments(recording)
        first = np.searchsorted(segment.journal["time_ns"], edges)
        nis.append(segment.journal["nis"][np.minimum(first, len(segment.journal) - 1)])
        rejected += ekf.pose_counts[Outcome.REJECTED]
        used += ekf.pose_counts[Outcome.USED]
    mean = np.concatenate(squares).mean(axis=0)
    return Flown(
        dict(zip(PARTS, np.moveaxis(nees, -1, 0), strict=True)),
        np.array(nis),
        float(np.degrees(np.sqrt(mean[3:].sum()))),
        float(np.sqrt(mean[:3].sum())),
        rejected / (rejected + used),
    )


def nees_of(error, covariance, part):
    """Squared error (16,) of some states in units of their covariance."""
    return error[part] @ np.linalg.solve(covariance[part, part], error[part])


def taken(stream, keep):
    return replace(stream, **{column.name: getattr(stream, column.name)[keep] for column in fields(stream)})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "freedom"), [("state", STATES), ("gyro bias", 3), ("accelerometer bias", 3), ("nis", 6)]
)
def test_errors_and_innovations_are_within_their_bounds_over_50_flights(flights, name, freedom):
    of_flights = flights.nis if name == "nis" else flights.nees[name]
    per_instant = of_flights.mean(axis=0)
    low, high = chi2.ppf([0.025, 0.975], SEEDS * freedom) / SEEDS
    print(name, per_instant.round(2), "within", (low, high), "mean", per_instant.mean())
    inside = (per_instant > low) & (per_instant < high)
    assert inside.sum() >= len(inside) - 1, per_instant
    assert low < per_instant.mean() < high


@pytest.mark.slow
def test_the_error_of_the_delay_is_within_its_bounds_once_it_has_shown_for_a_while(flights):
    """A delay of two standard deviations or more is beyond the linear model, in the first seconds."""
    per_instant = flights.nees["delay"].mean(axis=0)
    low, high = chi2.ppf([0.025, 0.975], SEEDS) / SEEDS
    print("delay", per_instant.round(2), "within", (low, high))
    late = per_instant[INSTANTS >= 9.0]
    assert np.all((late > low) & (late < high))
    assert np.all(per_instant < 2.0)


@pytest.mark.slow
def test_errors_at_14_m_s_are_small_with_a_fifth_of_the_poses_lost(dash, flights):
    print(flights[2:], np.linalg.norm(dash.velocity, axis=1).max())
    assert np.linalg.norm(dash.velocity, axis=1).max() > 13.5
    assert flights.attitude_rms_deg < 1.0
    assert flights.velocity_rms_m_s < 0.1
    assert flights.rejected < 0.002


@pytest.mark.slow
def test_smoothed_errors_are_smaller_than_filtered_ones_and_as_stated(dash):
    filtered, smoothed, scaled = [], [], []
    for seed in range(10):
        recording, _ = flown(dash, seed)
        for estimate, squares in (
            (Ekf(dash.vehicle, RATE).run(recording), filtered),
            (smooth(recording.imu, Ekf(dash.vehicle, RATE).segments(recording)), smoothed),
        ):
            index = np.searchsorted(dash.truth.time_ns, estimate.time_ns)
            error = error_of(estimate.position, estimate.velocity, estimate.attitude, dash, index)[1000:]
            squares.append((error**2).mean(axis=0))
        scaled.append((error**2 / estimate.variance[1000:, :STATES]).mean(axis=0))
    before, after = (np.sqrt(np.mean(squares, axis=0)) for squares in (filtered, smoothed))
    print(before, after, np.mean(scaled, axis=0))
    assert np.all(after[3:] < 0.75 * before[3:])
    assert np.all(after[:3] < before[:3])
    assert np.all(np.abs(np.mean(scaled, axis=0) - 1.0) < 0.45)
