# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles: mass, inertia, rotors and sensors, read from a YAML file under config/vehicles."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.config import read_config
from quadpi_core.errors import VehicleError
from quadpi_core.frames import Array

ROTORS = 4
_SPIKE_MARGIN = 1.1
# About z, over mass times squared distance of the rotors; quadrotors from 27 g to 0.8 kg have 0.29 to 0.7.
_YAW_INERTIA = (0.02, 10.0)
SPIN_SIGN = {"clockwise": 1.0, "counterclockwise": -1.0}


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the sensors that the estimator fuses, one standard deviation.

    ``*_noise`` of the IMU are per sample; ``*_bias_walk`` are in units per square-root second. Motion capture
    that stamps s was true at s - `mocap_delay_s`, known to `mocap_delay_std_s`: the estimator finds the rest;
    with a deviation of zero it takes that delay as exact.
    """

    accelerometer_noise_m_s2: float = 0.3
    gyro_noise_rad_s: float = 0.02
    accelerometer_bias_walk: float = 0.02
    gyro_bias_walk: float = 0.001
    mocap_position_m: float = 0.003
    mocap_attitude_rad: float = 0.01
    mocap_velocity_m_s: float = 0.05
    mocap_delay_s: float = 0.0
    mocap_delay_std_s: float = 0.05


@dataclass(frozen=True)
class Vehicle:
    """A quadrotor as the model sees it; SI units, body axes forward-right-down.

    Attributes:
        inertia: (3, 3), about the centre of gravity.
        rotor_positions: (4, 3), from the centre of gravity; the row order is the rotor order.
        rotor_spins: (4,), +1 where the rotor turns clockwise seen from above, else -1.
        pole_pairs: mechanical speed = electrical speed / pole_pairs; None where the source of the
            vehicle does not say, and then electrical speeds are refused.
        thrust_coefficient: C_T = thrust / (ρ π R⁴ ω²) of a rotor in still air, where it is known, to hold the
            flights against.
    """

    name: str
    mass_kg: float
    inertia: Array
    rotor_radius_m: float
    rotor_positions: Array
    rotor_spins: Array
    pole_pairs: int | None
    rotor_speed_max_rad_s: float = 1e4
    air_density_kg_m3: float = 1.225
    gravity_m_s2: float = 9.80665
    noise: SensorNoise = field(default_factory=SensorNoise)
    thrust_coefficient: float | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> Vehicle:
        """Read a vehicle by the name of a file in config/vehicles, or by path.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        return _parse(*read_config("vehicle", name_or_path, VehicleError))

    @cached_property
    def hover_induced_velocity(self) -> float:
        """v_h [m/s]: induced velocity in hover by momentum theory, from weight and disc area."""
        disc_area = ROTORS * np.pi * self.rotor_radius_m**2
        weight = self.mass_kg * self.gravity_m_s2
        return float(np.sqrt(weight / (2.0 * self.air_density_kg_m3 * disc_area)))

    @property
    def rotor_speed_spike_rad_s(self) -> float:
        """Beyond which a measured speed is a spike: a rotor at its largest, read with noise, is none."""
        return _SPIKE_MARGIN * self.rotor_speed_max_rad_s

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the numbers that inputs and measured wrench depend on: a model fits only these."""
        numbers = np.concatenate(
            [
                [self.mass_kg, self.rotor_radius_m, self.air_density_kg_m3, self.gravity_m_s2],
                self.inertia.ravel(),
                np.sign(self.rotor_positions[:, :2]).ravel(),
                self.rotor_spins,
            ]
        )
        return hashlib.sha256(numbers.astype("<f8").tobytes()).hexdigest()

    def rotor_speeds_from_erpm(self, erpm: Array) -> Array:
        """Convert electrical rev/min (..., 4) to mechanical rad/s.

        Raises:
            VehicleError: if the vehicle file does not give the pole pairs.
        """
        if self.pole_pairs is None:
            raise VehicleError(
                f"vehicle {self.name}: electrical rotor speeds need `pole_pairs` in the vehicle file"
            )
        return erpm * (2.0 * np.pi / 60.0 / self.pole_pairs)


_REQUIRED = ("mass_kg", "inertia_kg_m2", "rotor_radius_m", "rotors", "pole_pairs")
_OPTIONAL_NUMBERS = ("rotor_speed_max_rad_s", "air_density_kg_m3", "gravity_m_s2", "thrust_coefficient")
# What `simulation` holds is read by quadpi_core.simulation.
_KNOWN = (*_REQUIRED, *_OPTIONAL_NUMBERS, "noise", "simulation", "source")


def _parse(path: Path, data: Any) -> Vehicle:
    if not isinstance(data, dict):
        raise VehicleError(f"{path}: expected keys and values, found {type(data).__name__}")
    for key in _REQUIRED:
        if key not in data:
            raise VehicleError(f"{path}: missing key `{key}`")
    for key in data:
        if key not in _KNOWN:
            raise VehicleError(f"{path}: unknown key `{key}`; known: {', '.join(_KNOWN)}")
    rotors = data["rotors"]
    if not isinstance(rotors, list) or len(rotors) != ROTORS:
        raise VehicleError(f"{path}: `rotors` must list {ROTORS} rotors")
    positions = np.array([_rotor_position(path, i, rotor) for i, rotor in enumerate(rotors)])
    spins = np.array([_rotor_spin(path, i, rotor) for i, rotor in enumerate(rotors)])
    inertia, mass = _inertia(path, data["inertia_kg_m2"]), _positive(path, data, "mass_kg")
    _require_quadrotor(path, positions, spins)
    _require_inertia_of(path, inertia, mass, positions)
    pole_pairs = data["pole_pairs"]
    if pole_pairs is not None and (not isinstance(pole_pairs, int) or pole_pairs < 1):
        raise VehicleError(f"{path}: `pole_pairs` must be a positive integer or null")
    return Vehicle(
        name=path.stem,
        mass_kg=mass,
        inertia=inertia,
        rotor_radius_m=_positive(path, data, "rotor_radius_m"),
        rotor_positions=positions,
        rotor_spins=spins,
        pole_pairs=pole_pairs,
        noise=_noise(path, data.get("noise") or {}),
        **{key: _positive(path, data, key) for key in _OPTIONAL_NUMBERS if key in data},
    )


def _positive(path: Path, data: dict[str, Any], key: str) -> float:
    value = data[key]
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 < value < np.inf:
        raise VehicleError(f"{path}: `{key}` must be a positive number, found {value!r}")
    return float(value)


def _require_quadrotor(path: Path, positions: Array, spins: Array) -> None:
    """Refuse rotors that cannot hold a quadrotor: one in each quadrant, opposite ones of the same spin."""
    if len({tuple(signs) for signs in np.sign(positions[:, :2]).tolist()}) < ROTORS:
        raise VehicleError(
            f"{path}: `rotors` must lie one in each quadrant: front left, front right, rear left, rear right"
        )
    along = np.sign(positions[:, 0] * positions[:, 1])
    if abs(float(np.sum(along * spins))) < ROTORS:
        raise VehicleError(
            f"{path}: `rotors`: opposite rotors must turn the same way and neighbours the other way, or "
            "nothing holds the yaw"
        )


def _require_inertia_of(path: Path, inertia: Array, mass: float, positions: Array) -> None:
    """Refuse an inertia that no vehicle of this mass and size has, such as one in g m²."""
    ratio = float(inertia[2, 2] / (mass * np.mean(np.sum(positions[:, :2] ** 2, axis=1))))
    if not _YAW_INERTIA[0] < ratio < _YAW_INERTIA[1]:
        raise VehicleError(
            f"{path}: `inertia_kg_m2`: about z it is {ratio:.3g} times mass times squared distance of the "
            "rotors from the centre, expected 0.2 to 1: wrong unit?"
        )


def is_rigid_body(inertia: Array) -> bool:
    """Whether a body has this inertia (3, 3): symmetric, positive, no moment above the sum of the others."""
    moments = np.linalg.eigvalsh(inertia)
    return bool(np.allclose(inertia, inertia.T) and moments[0] > 0 and moments[0] + moments[1] >= moments[2])


def _inertia(path: Path, value: Any) -> Array:
    """Full (3, 3) matrix from three diagonal numbers or three rows; must be a real body's inertia."""
    try:
        inertia = np.array(value, dtype=float)
    except (TypeError, ValueError):
        inertia = np.empty(0)
    if inertia.shape == (3,):
        inertia = np.diag(inertia)
    if inertia.shape != (3, 3) or not np.all(np.isfinite(inertia)):
        raise VehicleError(f"{path}: `inertia_kg_m2` must be 3 numbers or a 3x3 matrix")
    if not is_rigid_body(inertia):
        raise VehicleError(
            f"{path}: `inertia_kg_m2` is not the inertia of a rigid body "
            f"(symmetric, principal moments positive and obeying the triangle inequality)"
        )
    return inertia


def _rotor_position(path: Path, index: int, rotor: Any) -> Array:
    try:
        position = np.array(rotor["position_m"], dtype=float)
    except (KeyError, TypeError, ValueError):
        position = np.empty(0)
    if position.shape != (3,) or not np.all(np.isfinite(position)):
        raise VehicleError(f"{path}: rotor {index + 1} needs `position_m` with 3 numbers")
    if position[0] == 0 or position[1] == 0:
        raise VehicleError(f"{path}: rotor {index + 1} lies on a body axis; only x layouts are known")
    return position


def _rotor_spin(path: Path, index: int, rotor: Any) -> float:
    spin = rotor.get("spin")
    if not isinstance(spin, str) or spin not in SPIN_SIGN:
        raise VehicleError(f"{path}: rotor {index + 1} needs `spin`: {' or '.join(SPIN_SIGN)}")
    return SPIN_SIGN[spin]


def _noise(path: Path, data: dict[str, Any]) -> SensorNoise:
    known = {f.name for f in fields(SensorNoise)}
    if not isinstance(data, dict):
        raise VehicleError(f"{path}: `noise` must hold keys with numbers, found {data!r}")
    for key in data:
        if key not in known:
            raise VehicleError(f"{path}: unknown key `noise.{key}`; known: {sorted(known)}")
    return SensorNoise(
        **{key: _within(path, data, key) if key in _BOUNDS else _positive(path, data, key) for key in data}
    )


# Of what need not be positive; the estimator's buffer bounds the delay.
_BOUNDS = {"mocap_delay_s": (-0.3, 0.3), "mocap_delay_std_s": (0.0, 0.3)}


def _within(path: Path, data: dict[str, Any], key: str) -> float:
    value, (lowest, highest) = data[key], _BOUNDS[key]
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not lowest <= value <= highest:
        raise VehicleError(
            f"{path}: `noise.{key}` must be a number from {lowest:g} to {highest:g}, found {value!r}"
        )
    return float(value)
