# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A made-up flight that all live figures are measured on, and a model of each method for its vehicle."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream, Stamps, Stream
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bag_writer import mcap_writer
from quadpi_core.logs.bags import recording_topics, write_bag
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.vehicle import Vehicle

VEHICLE = "neurobem"
FLIGHT_S = 120.0
IMU_HZ, ROTOR_HZ, MOCAP_HZ = 500.0, 500.0, 120.0
METHODS = ("polynomial", "bootstrap", "quality-driven")

_CUTOFF_HZ = 30.0
_START_NS = 1_700_000_000_000_000_000
_SWING_M: Array = np.array([1.5, 1.0, 0.4])
# Whole multiples of 0.1 rad/s, so that the swings repeat after 20 π seconds.
_SWING_RAD_S: Array = np.array([1.1, 1.7, 2.3])
REPEATS_AFTER_S = 20.0 * np.pi
_TILT_RAD = 0.4


def three_models(folder: Path, vehicle: Vehicle) -> dict[str, AerodynamicModel]:
    """A model of six axes for each method, stored in folders of their names.

    The polynomial is identified on the swings; the networks are of random weights, as heavy as trained ones.
    """
    bag = folder / "training.mcap"
    write_bag(bag, swings(vehicle))
    flights = prepare_flights([bag], vehicle, _CUTOFF_HZ)
    options = IdentifyOptions(method=METHODS[0], cutoff_hz=_CUTOFF_HZ, settings="paper")
    polynomial = identify(flights, vehicle, load_pools("quadrotor"), options).save(folder / METHODS[0])
    models = {METHODS[0]: polynomial}
    for method in METHODS[1:]:
        ensembles = random_ensembles(method, flights[0].inputs, simulation_inputs())
        model = replace(polynomial, name="", fitted=ensembles, identity="")
        # Names of models are parts of topics, which know no hyphen.
        models[method] = model.save(folder / method.replace("-", "_"))
    return models


def swings(vehicle: Vehicle, seconds: float = FLIGHT_S, seed: int = 7) -> Recording:
    """Swings along three axes, rolling and pitching, with the noise of the vehicle's sensors."""
    rng = np.random.default_rng(seed)
    noise = vehicle.noise
    imu_ns, rotor_ns, mocap_ns = (_stamps(rate, seconds) for rate in (IMU_HZ, ROTOR_HZ, MOCAP_HZ))
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


def write_long_bag(path: Path, vehicle: Vehicle, seconds: float) -> None:
    """The swings again and again, from a process that holds them once."""
    once = swings(vehicle, REPEATS_AFTER_S)
    period_ns, count = round(1e9 * REPEATS_AFTER_S), int(np.ceil(seconds / REPEATS_AFTER_S))
    end_ns = _START_NS + round(1e9 * seconds)
    with mcap_writer(path, {"vehicle": vehicle.name}) as writer:
        for begin_ns in range(0, count * period_ns, period_ns):
            for topic in recording_topics(_later(once, begin_ns)):
                writer.add(topic.split(end_ns)[0])
            writer.flush(_START_NS + begin_ns + period_ns - 1)


def _later(recording: Recording, by_ns: int) -> Recording:
    streams: dict[str, Any] = {
        column.name: replace(stream, time_ns=stream.time_ns + by_ns)
        for column in fields(recording)
        if isinstance(stream := getattr(recording, column.name), Stream)
    }
    return replace(recording, **streams)


def _tilt(time_ns: Stamps) -> tuple[Array, Array]:
    """Attitude (N, 4) that rolls and pitches, and its body rates (N, 3)."""
    roll, pitch, _ = (_TILT_RAD * np.sin(_phase(time_ns))).T
    roll_rate, pitch_rate, _ = (_TILT_RAD * _SWING_RAD_S * np.cos(_phase(time_ns))).T
    attitude = Rotation.from_euler("YX", np.stack((pitch, roll), axis=1)).as_quat(scalar_first=True)
    rates = np.stack((roll_rate, pitch_rate * np.cos(roll), -pitch_rate * np.sin(roll)), axis=1)
    return attitude, rates


def _stamps(rate_hz: float, seconds: float) -> Stamps:
    return _START_NS + np.round(np.arange(0.0, seconds, 1.0 / rate_hz) * 1e9).astype(np.int64)


def _phase(time_ns: Stamps) -> Array:
    phase: Array = (1e-9 * (time_ns - _START_NS))[:, None] * _SWING_RAD_S
    return phase
