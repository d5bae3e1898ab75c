# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors add to the truth: sensor suites, read from config/noise, and noise as pure functions.

Everything random comes from one seed, through a stream of its own for each name: what one sensor is set to
leaves the noise of the others alone.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import Field, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.config import read_config
from quadpi_core.errors import SimulationError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.signals.rotations import from_rotation_vector, product
from quadpi_core.simulation.config_section import Section, Vector
from quadpi_core.vehicle import Vehicle


def _unit(unit: str = "", *, lowest: float = 0.0, highest: float = math.inf) -> dict[str, Any]:
    """About a setting: its unit, which ends its name in a file, and its bounds.

    `{unit}` is the unit of the sensor that the setting belongs to.
    """
    return {"unit": unit, "lowest": lowest, "highest": highest}


# Every default is that of a perfect sensor.


@dataclass(frozen=True)
class InertialSensor:
    """A gyro [rad/s] or an accelerometer [m/s²] of three axes.

    Attributes:
        noise: standard deviation of a sample; or instead
        noise_density: of white noise over all frequencies up to half the sample rate, [1/√Hz], as data sheets
            give it: noise = noise_density √(rate / 2).
        bias: standard deviation of the bias at the start, drawn once per flight and axis.
        bias_walk: standard deviation [1/√s] that the bias gains in one second.
        range: beyond which it saturates.
        resolution: step between the values that it can report; 0 for none.
    """

    noise: float = field(default=0.0, metadata=_unit("{unit}"))
    noise_density: float = field(default=0.0, metadata=_unit("{unit}_sqrt_hz"))
    bias: float = field(default=0.0, metadata=_unit("{unit}"))
    bias_walk: float = field(default=0.0, metadata=_unit("{unit}_sqrt_s"))
    range: float = field(default=math.inf, metadata=_unit("{unit}"))
    resolution: float = field(default=0.0, metadata=_unit("{unit}"))


@dataclass(frozen=True)
class Imu:
    """Gyro and accelerometer in one place.

    Attributes:
        rate: [Hz].
        position: [m] from the centre of gravity, body axes.
        misalignment: [deg] rotation vector from the sensor's axes to the body's.
    """

    rate: float = field(default=500.0, metadata=_unit("hz", lowest=0.1))
    position: Vector = field(default=(0.0, 0.0, 0.0), metadata=_unit("m"))
    misalignment: Vector = field(default=(0.0, 0.0, 0.0), metadata=_unit("deg"))
    gyro: InertialSensor = field(default=InertialSensor(), metadata=_unit("rad_s"))
    accelerometer: InertialSensor = field(default=InertialSensor(), metadata=_unit("m_s2"))


@dataclass(frozen=True)
class RotorSpeedSensor:
    """Electronic speed controllers; noise in electrical rev/min, mechanical where pole pairs are unknown."""

    rate: float = field(default=500.0, metadata=_unit("hz", lowest=0.1))
    noise: float = field(default=0.0, metadata=_unit("erpm"))


@dataclass(frozen=True)
class MotionCapture:
    """Cameras that see markers on the vehicle.

    Attributes:
        rate: [Hz] of the frames.
        position_noise: [m] per axis.
        attitude_noise: [rad] per axis.
        capture_jitter: [s] standard deviation by which a frame is off the even grid; its stamp tells.
        latency: [s] from capture to arrival.
        arrival_jitter: [s] by which a frame is later than that, on average; exponentially distributed.
        dropout_probability: of any frame.
        obscured_angle: [deg] of roll or pitch, beyond which markers may be hidden.
        obscured_share: of the time beyond it in which they are.
        obscured_burst: [s] for which they stay hidden, on average, while the vehicle stays tilted.
    """

    rate: float = field(default=120.0, metadata=_unit("hz", lowest=0.1, highest=1000.0))
    position_noise: float = field(default=0.0, metadata=_unit("m"))
    attitude_noise: float = field(default=0.0, metadata=_unit("rad"))
    capture_jitter: float = field(default=0.0, metadata=_unit("s"))
    latency: float = field(default=0.0, metadata=_unit("s", highest=10.0))
    arrival_jitter: float = field(default=0.0, metadata=_unit("s", highest=10.0))
    dropout_probability: float = field(default=0.0, metadata=_unit(highest=1.0))
    obscured_angle: float = field(default=180.0, metadata=_unit("deg", highest=180.0))
    obscured_share: float = field(default=1.0, metadata=_unit(highest=1.0))
    obscured_burst: float = field(default=0.1, metadata=_unit("s", lowest=1e-3))


@dataclass(frozen=True)
class Anemometer:
    """Wind over ground, noise in m/s per axis."""

    rate: float = field(default=500.0, metadata=_unit("hz", lowest=0.1))
    noise: float = field(default=0.0, metadata=_unit("m_s"))


@dataclass(frozen=True)
class StateNoise:
    """Standard deviations of white noise put straight on the states of a flight (see :func:`contaminate`).

    A simulation has no electrical speeds: that of the rotors is of their mechanical speed.
    """

    velocity: float = field(default=0.0, metadata=_unit("m_s"))
    attitude: float = field(default=0.0, metadata=_unit("rad"))
    rates: float = field(default=0.0, metadata=_unit("rad_s"))
    specific_force: float = field(default=0.0, metadata=_unit("m_s2"))
    rotor_speeds: float = field(default=0.0, metadata=_unit("rad_s"))


@dataclass(frozen=True)
class SensorSuite:
    """All sensors of a vehicle and of the room that it flies in; `name` is the stem of its file."""

    name: str
    imu: Imu = field(default=Imu())
    rotor_speeds: RotorSpeedSensor = field(default=RotorSpeedSensor())
    mocap: MotionCapture = field(default=MotionCapture())
    wind: Anemometer = field(default=Anemometer())
    states: StateNoise = field(default=StateNoise())

    @classmethod
    def load(cls, name_or_path: str | Path) -> SensorSuite:
        """Read a suite by the name of a file in config/noise, or by path; what it leaves out is perfect.

        Raises:
            SimulationError: naming the file and the key that is unknown or impossible.
        """
        path, data = read_config("noise", name_or_path, SimulationError)
        parts = {part.name: part.default for part in fields(cls) if part.name != "name"}
        section = Section(data, str(path), ("source", *parts))
        read = {name: _read(part, section.get(name, {}), f"{path}: {name}") for name, part in parts.items()}
        return cls(path.stem, **read)


def _read(perfect: Any, data: Any, where: str, unit: str = "") -> Any:
    """Settings like `perfect`, with what a file gives instead."""
    keys = {setting.name: _key(setting, unit) for setting in fields(perfect)}
    section = Section(data, where, tuple(keys.values()))
    given: dict[str, Any] = {}
    for setting in fields(perfect):
        key, metadata = keys[setting.name], setting.metadata
        if key not in section:
            continue
        if is_dataclass(setting.default):
            part = section.get(key, None)
            given[setting.name] = _read(setting.default, part, f"{where}.{key}", metadata["unit"])
        elif isinstance(setting.default, tuple):
            given[setting.name] = section.vector(key, setting.default)
        else:
            given[setting.name] = section.number(key, lowest=metadata["lowest"], highest=metadata["highest"])
    if given.keys() >= {"noise", "noise_density"}:
        raise SimulationError(f"{where}: give `{keys['noise']}` or `{keys['noise_density']}`, not both")
    return replace(perfect, **given)


def _key(setting: Field[Any], unit: str) -> str:
    """Name of a setting in a file: with its unit, unless it is a part with settings of its own."""
    if is_dataclass(setting.default) or not setting.metadata["unit"]:
        return setting.name
    return f"{setting.name}_{setting.metadata['unit'].format(unit=unit)}"


def generator(seed: int, name: str) -> np.random.Generator:
    """Random numbers that depend on seed and name alone, independent of those of any other name."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def inertial_samples(
    ideal: Array, sensor: InertialSensor, rate_hz: float, random: np.random.Generator
) -> Array:
    """What a gyro or an accelerometer reports (N, 3) where `ideal` (N, 3) is true.

    Bias and white noise are added, then the sensor saturates, then it rounds.
    """
    white = max(sensor.noise, sensor.noise_density * math.sqrt(0.5 * rate_hz))
    samples = ideal + white * random.standard_normal(ideal.shape)
    samples += sensor.bias * random.standard_normal(3)
    steps = random.standard_normal(ideal.shape)
    steps[:1] = 0.0
    samples += sensor.bias_walk / math.sqrt(rate_hz) * np.cumsum(steps, axis=0)
    np.clip(samples, -sensor.range, sensor.range, out=samples)
    return sensor.resolution * np.rint(samples / sensor.resolution) if sensor.resolution else samples


@njit(cache=True)
def turned(attitude: Array, rotation: Array) -> Array:
    """Attitudes (N, 4) turned by rotation vectors (N, 3) rad, body axes."""
    result = np.empty_like(attitude)
    for row in range(len(attitude)):
        quaternion = product(attitude[row], from_rotation_vector(rotation[row]))
        for component in range(4):
            result[row, component] = quaternion[component]
    return result


def rotor_speed_unit(vehicle: Vehicle) -> float:
    """One electrical rev/min [rad/s] of the rotors; one mechanical where the pole pairs are unknown."""
    return 2.0 * math.pi / 60.0 / (vehicle.pole_pairs or 1)


def contaminate(flight: Flight, noise: StateNoise, seed: int) -> Flight:
    """A flight with white noise on its states and measurements, as the paper's validation adds it.

    The angular acceleration stays as it is, for the paper's table has no noise for it: the derivative of the
    noise of the rates would be three times as large as Mz, of which the paper explains 98 %. Noise of the
    attitude is about the body's axes: in level flight that of roll, pitch and yaw.

    Source: van Beers and de Visser, appendix "Gaussian Noise Statistics".
    """

    def noisy(name: str, deviation: float) -> Array:
        values: Array = getattr(flight, name)
        return values + deviation * generator(seed, f"states.{name}").standard_normal(values.shape)

    turn = noise.attitude * generator(seed, "states.attitude").standard_normal(flight.rates.shape)
    return replace(
        flight,
        velocity=noisy("velocity", noise.velocity),
        attitude=turned(flight.attitude, turn),
        rates=noisy("rates", noise.rates),
        specific_force=noisy("specific_force", noise.specific_force),
        rotor_speeds=noisy("rotor_speeds", noise.rotor_speeds),
    )
