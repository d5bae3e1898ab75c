# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the owner of a vehicle gets of a flight: a table of noisy sensors, of onboard states, of a simulation.

One table serves both mappings: `mocap.yaml` reads raw IMU and poses, `odometry.yaml` the onboard estimate and
the IMU that it has corrected. The simulated wrench is computed from what the table holds, noise included.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from independent.airframes import Airframe, Array
from independent.flying import RATE_HZ, Truth
from independent.hidden_effects import Flown
from independent.nominal import nominal_wrench

# Biases of the raw IMU, drawn for each flight; and what the onboard estimator leaves of them.
_GYRO_BIAS_RAD_S, _ACCELEROMETER_BIAS_M_S2 = 0.005, 0.05
_LEFT_OF_BIAS = 0.1
# Motion capture sees every second sample, and loses one frame of a hundred.
_MOCAP_STEP, _LOST = 2, 0.01
# Errors of the onboard estimate: a slow part with its time constant, and a white one.
_VELOCITY_M_S, _ATTITUDE_RAD, _POSITION_M = (0.02, 0.5, 0.03), (0.006, 1.0, 0.004), (0.01, 2.0, 0.002)


def table(flown: Flown, truth: Truth, rng: np.random.Generator) -> pa.Table:
    """One flight as its log."""
    airframe, samples = flown.airframe, len(truth.time)
    attitude = Rotation.from_quat(truth.attitude)
    # Sensors and markers sit about the centre of gravity of the file.
    arm = -flown.centre
    place = truth.position + attitude.apply(arm)
    velocity = truth.velocity + attitude.apply(np.cross(truth.rates, arm))
    felt = attitude.inv().apply(truth.acceleration)
    felt += np.cross(truth.turning, arm) + np.cross(truth.rates, np.cross(truth.rates, arm))
    axes = Rotation.from_rotvec(flown.sensing.turned).inv()
    gyro = axes.apply(truth.rates) + airframe.gyro_rad_s * rng.standard_normal((samples, 3))
    force = axes.apply(felt) + airframe.accelerometer_m_s2 * rng.standard_normal((samples, 3))
    gyro_bias = _GYRO_BIAS_RAD_S * rng.standard_normal(3)
    force_bias = _ACCELEROMETER_BIAS_M_S2 * rng.standard_normal(3)
    speeds = _reported_speeds(flown, truth, rng)

    odometry_velocity = velocity + _wandering(samples, *_VELOCITY_M_S, rng)
    odometry_attitude = attitude * Rotation.from_rotvec(_wandering(samples, *_ATTITUDE_RAD, rng))
    odometry_place = place + _wandering(samples, *_POSITION_M, rng)
    seen = attitude * Rotation.from_rotvec(airframe.mocap_rad * rng.standard_normal((samples, 3)))
    pose = np.hstack((place + airframe.mocap_m * rng.standard_normal((samples, 3)), seen.as_quat()))
    lost = rng.random(samples) < _LOST
    lost |= np.arange(samples) % _MOCAP_STEP != 0
    pose[lost] = np.nan

    corrected = gyro + _LEFT_OF_BIAS * gyro_bias
    simulated = nominal_wrench(airframe, odometry_attitude.inv().apply(odometry_velocity), corrected, speeds)
    blocks: dict[str, Array] = {
        "t": truth.time[:, None],
        "raw_gyro": gyro + gyro_bias,
        "raw_acc": force + force_bias,
        "gyro": corrected,
        "acc": force + _LEFT_OF_BIAS * force_bias,
        "rotor": speeds,
        "position": odometry_place,
        "attitude": odometry_attitude.as_quat(),
        "velocity": odometry_velocity,
        "mocap": pose,
        "simulated": simulated,
    }
    columns = {
        f"{name}_{index}" if block.shape[1] > 1 else name: block[:, index].astype(np.float64)
        for name, block in blocks.items()
        for index in range(block.shape[1])
    }
    return pa.table(columns)


def write(flown: Flown, truth: Truth, rng: np.random.Generator, folder: Path) -> Path:
    """The table as a Parquet file."""
    path = folder / f"{truth.name}.parquet"
    parquet.write_table(table(flown, truth, rng), path, compression="zstd")
    return path


def _reported_speeds(flown: Flown, truth: Truth, rng: np.random.Generator) -> Array:
    """Rotor speeds filtered, late, scaled and noisy."""
    sensing, airframe = flown.sensing, flown.airframe
    speeds = truth.rotor_speeds.copy()
    if sensing.rotor_filter_s > 0.0:
        keep = np.exp(-1.0 / (RATE_HZ * sensing.rotor_filter_s))
        for k in range(1, len(speeds)):
            speeds[k] = keep * speeds[k - 1] + (1.0 - keep) * speeds[k]
    if sensing.rotor_delay_s > 0.0:
        at = truth.time - sensing.rotor_delay_s
        speeds = np.stack([np.interp(at, truth.time, column) for column in speeds.T], axis=1)
    noise = airframe.rotor_speed_rad_s * rng.standard_normal(speeds.shape)
    return np.maximum(sensing.rotor_scale * speeds + noise, 0.0)


def _wandering(samples: int, slow: float, time_s: float, white: float, rng: np.random.Generator) -> Array:
    """Errors (N, 3) of an estimator: a process of Ornstein and Uhlenbeck, and white noise."""
    keep = np.exp(-1.0 / (RATE_HZ * time_s))
    fresh = slow * np.sqrt(1.0 - keep**2) * rng.standard_normal((samples, 3))
    errors = np.empty((samples, 3))
    errors[0] = slow * rng.standard_normal(3)
    for k in range(1, samples):
        errors[k] = keep * errors[k - 1] + fresh[k]
    errors += white * rng.standard_normal((samples, 3))
    return errors


def describe(airframe: Airframe) -> str:
    """The vehicle file that belongs to an airframe, as text."""
    flip = np.array([1.0, -1.0, -1.0])
    moments = ", ".join(f"{value:.4g}" for value in np.diag(airframe.inertia))
    rotors = "\n".join(
        f"  - {{position_m: [{', '.join(f'{value + 0.0:.5f}' for value in place * flip)}], "
        f"spin: {'clockwise' if turn > 0 else 'counterclockwise'}}}"
        for place, turn in zip(airframe.rotors, airframe.parameters["rotor_directions"], strict=True)
    )
    return f"""# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
source: RotorPy 3.0.0, as the owner of the simulated vehicle knows it
mass_kg: {airframe.mass_kg:g}
inertia_kg_m2: [{moments}]
rotor_radius_m: {airframe.radius_m:g}
rotor_speed_max_rad_s: {airframe.parameters["rotor_speed_max"]:g}
pole_pairs: null
rotors:  # forward-right-down
{rotors}
noise:
  accelerometer_noise_m_s2: {airframe.accelerometer_m_s2:g}
  gyro_noise_rad_s: {airframe.gyro_rad_s:g}
  accelerometer_bias_walk: 0.002
  gyro_bias_walk: 0.0002
  mocap_position_m: {airframe.mocap_m:g}
  mocap_attitude_rad: {airframe.mocap_rad:g}
"""
