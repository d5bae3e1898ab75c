# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory known in closed form, and what sensors would see of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.vehicle import SensorNoise, Vehicle

_SWING = np.array([[2.0, 0.9, 0.3], [1.5, 1.3, 1.1], [0.8, 0.7, 2.0]])  # amplitude m, rad/s, phase
_TILT = np.array([[0.4, 1.7, 0.5], [0.3, 2.1, 1.4], [0.8, 0.6, 0.2]])  # roll, pitch, yaw: rad, rad/s, phase


def _sine(terms, time, derivative):
    """Derivatives of amplitude · sin(frequency · time + phase): (N, 3)."""
    amplitude, frequency, phase = terms.T
    return (
        amplitude * frequency**derivative * np.sin(np.outer(time, frequency) + phase + derivative * np.pi / 2)
    )


@dataclass(frozen=True)
class Truth:
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    rates: np.ndarray
    angular_acceleration: np.ndarray
    specific_force: np.ndarray


def truth(time, gravity=9.80665):
    """The state and what ideal sensors read at times (N,), world NED, body FRD."""
    roll, pitch, _ = _sine(_TILT, time, 0).T
    droll, dpitch, dyaw = _sine(_TILT, time, 1).T
    ddroll, ddpitch, ddyaw = _sine(_TILT, time, 2).T
    rotation = Rotation.from_euler("ZYX", _sine(_TILT, time, 0)[:, ::-1])
    rates = np.stack(
        (
            droll - dyaw * np.sin(pitch),
            dpitch * np.cos(roll) + dyaw * np.sin(roll) * np.cos(pitch),
            -dpitch * np.sin(roll) + dyaw * np.cos(roll) * np.cos(pitch),
        ),
        axis=1,
    )
    angular_acceleration = np.stack(
        (
            ddroll - ddyaw * np.sin(pitch) - dyaw * dpitch * np.cos(pitch),
            ddpitch * np.cos(roll)
            - dpitch * droll * np.sin(roll)
            + ddyaw * np.sin(roll) * np.cos(pitch)
            + dyaw * (droll * np.cos(roll) * np.cos(pitch) - dpitch * np.sin(roll) * np.sin(pitch)),
            -ddpitch * np.sin(roll)
            - dpitch * droll * np.cos(roll)
            + ddyaw * np.cos(roll) * np.cos(pitch)
            - dyaw * (droll * np.sin(roll) * np.cos(pitch) + dpitch * np.cos(roll) * np.sin(pitch)),
        ),
        axis=1,
    )
    acceleration = _sine(_SWING, time, 2)
    return Truth(
        position=_sine(_SWING, time, 0),
        velocity=_sine(_SWING, time, 1),
        attitude=np.roll(rotation.as_quat(), 1, axis=1),
        rates=rates,
        angular_acceleration=angular_acceleration,
        specific_force=rotation.inv().apply(acceleration - [0.0, 0.0, gravity]),
    )


@dataclass(frozen=True)
class Simulated:
    recording: Recording
    truth: Truth
    gyro_bias: np.ndarray
    accelerometer_bias: np.ndarray


def simulate(vehicle, seed, duration=8.0, imu_hz=500.0, pose_hz=120.0):
    """A recording of the trajectory by noisy, biased sensors; truth and biases at the IMU's stamps."""
    rng = np.random.default_rng(seed)
    noise = vehicle.noise
    time = np.arange(0.0, duration, 1.0 / imu_hz)
    exact = truth(time, vehicle.gravity_m_s2)

    def walk(start_std, walk_std):
        steps = rng.normal(scale=walk_std / np.sqrt(imu_hz), size=(len(time), 3))
        return rng.normal(scale=start_std, size=3) + np.cumsum(steps, axis=0)

    gyro_bias = walk(0.05, noise.gyro_bias_walk)
    accelerometer_bias = walk(0.3, noise.accelerometer_bias_walk)
    imu = ImuStream(
        np.rint(time * 1e9).astype(np.int64),
        exact.rates + gyro_bias + rng.normal(scale=noise.gyro_noise_rad_s, size=(len(time), 3)),
        exact.specific_force
        + accelerometer_bias
        + rng.normal(scale=noise.accelerometer_noise_m_s2, size=(len(time), 3)),
    )
    pose_time = np.arange(0.0, duration, 1.0 / pose_hz)
    seen = truth(pose_time)
    turned = Rotation.from_quat(np.roll(seen.attitude, -1, axis=1)) * Rotation.from_rotvec(
        rng.normal(scale=noise.mocap_attitude_rad, size=(len(pose_time), 3))
    )
    sign = rng.choice([-1.0, 1.0], size=(len(pose_time), 1))
    pose = PoseStream(
        np.rint(pose_time * 1e9).astype(np.int64),
        seen.position + rng.normal(scale=noise.mocap_position_m, size=(len(pose_time), 3)),
        sign * np.roll(turned.as_quat(), 1, axis=1),
    )
    rotors = RotorSpeedStream(imu.time_ns, 800.0 + 50.0 * np.sin(np.outer(time, [1.0, 1.1, 1.2, 1.3])))
    recording = Recording("simulated", vehicle.name, "simulated.bag", imu, rotors, pose)
    return Simulated(recording, exact, gyro_bias, accelerometer_bias)


@pytest.fixture(scope="session")
def noisy_vehicle():
    return replace(Vehicle.load("neurobem"), noise=SensorNoise())


@pytest.fixture(scope="session")
def simulated(noisy_vehicle):
    return simulate(noisy_vehicle, seed=0)


@pytest.fixture(scope="session")
def simulate_flight(noisy_vehicle):
    """simulate_flight(seed, …) → Simulated."""
    return lambda seed, vehicle=noisy_vehicle, **settings: simulate(vehicle, seed, **settings)


@pytest.fixture(scope="session")
def true_flight():
    """true_flight(time) → Truth."""
    return truth


def events(recording):
    """Every sample in the order of stamps, the IMU first where they tie."""
    imu, pose = recording.imu, recording.pose
    merged = [(t, 0, i) for i, t in enumerate(imu.time_ns)] + [(t, 1, i) for i, t in enumerate(pose.time_ns)]
    for time_ns, is_pose, index in sorted(merged):
        if is_pose:
            yield "pose", index, (int(time_ns), pose.position[index], pose.attitude[index])
        else:
            yield "imu", index, (int(time_ns), imu.angular_velocity[index], imu.specific_force[index])


def feed(ekf, recording):
    """Feed the samples one by one as live; yields each estimate with its IMU index."""
    for kind, index, sample in events(recording):
        if kind == "pose":
            ekf.update_pose(*sample)
        else:
            step = ekf.step(*sample)
            if step.fused is not None:
                yield index, step
