# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay` of a polynomial model with six axes, against the time that the flight took.

The flight is made up: swings seen by 500 Hz IMU and rotor speeds and 120 Hz motion capture. The first
replay, which loads the compiled kernels, does not count; reading, estimation, monitor and writing all do.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import Result
from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream, Stamps
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.identification import identify, prepare_flights
from quadpi_core.logs.bags import write_bag
from quadpi_core.models import AerodynamicModel
from quadpi_core.models.pool import load_pools
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle

NAMES = ("replay_realtime_polynomial",)

FLIGHT_S = 120.0
IMU_HZ, ROTOR_HZ, MOCAP_HZ = 500.0, 500.0, 120.0
CUTOFF_HZ = 30.0
REPEATS = 3

_START_NS = 1_700_000_000_000_000_000
_SWING_M: Array = np.array([1.5, 1.0, 0.4])
_SWING_RAD_S: Array = np.array([1.1, 1.7, 2.3])
_TILT_RAD = 0.4


def run() -> list[Result]:
    vehicle = Vehicle.load("neurobem")
    with tempfile.TemporaryDirectory() as folder:
        bag, output = Path(folder) / "swings.mcap", Path(folder) / "replayed.mcap"
        write_bag(bag, swings(vehicle))
        flights = prepare_flights([bag], vehicle, CUTOFF_HZ)
        model = identify(
            flights, vehicle, load_pools("quadrotor"), cutoff_hz=CUTOFF_HZ, settings="paper"
        ).save(Path(folder) / "model")
        replay(model, vehicle, bag, output)
        seconds = statistics.median(_one_core_seconds(model, vehicle, bag, output) for _ in range(REPEATS))
    baseline = f"real time: a flight of {FLIGHT_S:.0f} s, replayed in {seconds:.2f} s on one core"
    return [Result(NAMES[0], FLIGHT_S / seconds, "times real time", baseline, goal=100.0)]


def swings(vehicle: Vehicle) -> Recording:
    """Swings along three axes, rolling and pitching, with the noise of the vehicle's sensors."""
    rng = np.random.default_rng(7)
    noise = vehicle.noise
    imu_ns, rotor_ns, mocap_ns = (_stamps(rate) for rate in (IMU_HZ, ROTOR_HZ, MOCAP_HZ))
    acceleration = -_SWING_M * _SWING_RAD_S**2 * np.sin(_phase(imu_ns))
    attitude, rates = _tilt(imu_ns)
    specific_force = rotate_world_to_body(attitude, acceleration - [0.0, 0.0, vehicle.gravity_m_s2])
    position = _SWING_M * np.sin(_phase(mocap_ns))
    return Recording(
        name="swings",
        vehicle=vehicle.name,
        source="swings",
        imu=ImuStream(
            imu_ns,
            rates + noise.gyro_noise_rad_s * rng.standard_normal(rates.shape),
            specific_force + noise.accelerometer_noise_m_s2 * rng.standard_normal(specific_force.shape),
        ),
        rotor_speeds=RotorSpeedStream(rotor_ns, rng.normal(1100.0, 30.0, (len(rotor_ns), 4))),
        pose=PoseStream(
            mocap_ns,
            position + noise.mocap_position_m * rng.standard_normal(position.shape),
            _tilt(mocap_ns)[0],
        ),
    )


def _tilt(time_ns: Stamps) -> tuple[Array, Array]:
    """Attitude (N, 4) that rolls and pitches, and its body rates (N, 3)."""
    roll, pitch, _ = (_TILT_RAD * np.sin(_phase(time_ns))).T
    roll_rate, pitch_rate, _ = (_TILT_RAD * _SWING_RAD_S * np.cos(_phase(time_ns))).T
    attitude = Rotation.from_euler("YX", np.stack((pitch, roll), axis=1)).as_quat(scalar_first=True)
    rates = np.stack((roll_rate, pitch_rate * np.cos(roll), -pitch_rate * np.sin(roll)), axis=1)
    return attitude, rates


def _stamps(rate_hz: float) -> Stamps:
    return _START_NS + np.round(np.arange(0.0, FLIGHT_S, 1.0 / rate_hz) * 1e9).astype(np.int64)


def _phase(time_ns: Stamps) -> Array:
    phase: Array = (1e-9 * (time_ns - _START_NS))[:, None] * _SWING_RAD_S
    return phase


def _one_core_seconds(model: AerodynamicModel, vehicle: Vehicle, bag: Path, output: Path) -> float:
    """Wall time of a replay, or its CPU time where threads made that longer."""
    wall, cpu = time.perf_counter(), time.process_time()
    replay(model, vehicle, bag, output)
    return max(time.perf_counter() - wall, time.process_time() - cpu)
