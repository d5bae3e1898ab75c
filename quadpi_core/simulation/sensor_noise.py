# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor noise: suites of sensors, read from config/noise, and noise as pure functions.

All random numbers come from one seed, with a separate stream for each name: a change of one sensor does not
change the noise of the others.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np

from quadpi_core.config_schema import Key, NotNegative, Section, Share, Vector, Within, load_config
from quadpi_core.errors import SimulationError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, from_rotation_vector, products
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.simulation.simulated_file import model_folder
from quadpi_core.vehicle import SensorNoise, Vehicle

Rate: TypeAlias = Annotated[float, Within(0.1)]
Delay: TypeAlias = Annotated[float, Within(0.0, 10.0)]

# Every default is that of a perfect sensor. Keys of a file end with their unit.


@dataclass(frozen=True)
class InertialSensor(Section):
    """A gyro [rad/s] or an accelerometer [m/s²] of three axes.

    Attributes:
        noise: standard deviation of a sample; or
        noise_density: spectral density [1/√Hz] of white noise up to half the sample rate, as in data sheets:
            noise = noise_density √(rate / 2).
        bias: standard deviation of the bias at the start, drawn once per flight and axis.
        bias_walk: standard deviation [1/√s] that the bias gains in one second.
        range: beyond which it saturates.
        resolution: step between the values that it can report; 0 for none.
    """

    noise: NotNegative = 0.0
    noise_density: NotNegative = 0.0
    bias: NotNegative = 0.0
    bias_walk: NotNegative = 0.0
    range: NotNegative = math.inf
    resolution: NotNegative = 0.0

    def __post_init__(self) -> None:
        if self.noise > 0.0 and self.noise_density > 0.0:
            raise ValueError("give the noise of a sample or its density, not both")


@dataclass(frozen=True)
class Gyro(InertialSensor):
    """The keys of a gyro."""

    noise: Annotated[NotNegative, Key("noise_rad_s")] = 0.0
    noise_density: Annotated[NotNegative, Key("noise_density_rad_s_sqrt_hz")] = 0.0
    bias: Annotated[NotNegative, Key("bias_rad_s")] = 0.0
    bias_walk: Annotated[NotNegative, Key("bias_walk_rad_s_sqrt_s")] = 0.0
    range: Annotated[NotNegative, Key("range_rad_s")] = math.inf
    resolution: Annotated[NotNegative, Key("resolution_rad_s")] = 0.0


@dataclass(frozen=True)
class Accelerometer(InertialSensor):
    """The keys of an accelerometer."""

    noise: Annotated[NotNegative, Key("noise_m_s2")] = 0.0
    noise_density: Annotated[NotNegative, Key("noise_density_m_s2_sqrt_hz")] = 0.0
    bias: Annotated[NotNegative, Key("bias_m_s2")] = 0.0
    bias_walk: Annotated[NotNegative, Key("bias_walk_m_s2_sqrt_s")] = 0.0
    range: Annotated[NotNegative, Key("range_m_s2")] = math.inf
    resolution: Annotated[NotNegative, Key("resolution_m_s2")] = 0.0


@dataclass(frozen=True)
class Imu(Section):
    """Gyro and accelerometer in one place.

    Attributes:
        rate: [Hz].
        position: [m] from the centre of gravity, body axes.
        misalignment: [deg] rotation vector from the sensor's axes to the body's.
    """

    rate: Annotated[Rate, Key("rate_hz")] = 500.0
    position: Annotated[Vector, Key("position_m")] = (0.0, 0.0, 0.0)
    misalignment: Annotated[Vector, Key("misalignment_deg")] = (0.0, 0.0, 0.0)
    gyro: Gyro = Gyro()
    accelerometer: Accelerometer = Accelerometer()


@dataclass(frozen=True)
class RotorSpeedSensor(Section):
    """Electronic speed controllers; noise in electrical rev/min, mechanical where pole pairs are unknown."""

    rate: Annotated[Rate, Key("rate_hz")] = 500.0
    noise: Annotated[NotNegative, Key("noise_erpm")] = 0.0


@dataclass(frozen=True)
class MotionCapture(Section):
    """Cameras that see markers on the vehicle.

    Attributes:
        rate: [Hz] of the frames.
        position_noise: [m] per axis.
        attitude_noise: [rad] per axis.
        capture_jitter: [s] standard deviation of a frame's time from the even grid; its stamp shows it.
        latency: [s] from capture to arrival.
        arrival_jitter: [s] mean of the exponentially distributed delay beyond the latency.
        dropout_probability: probability that a frame is lost.
        obscured_angle: [deg] of roll or pitch, beyond which markers may be hidden.
        obscured_share: share of the time beyond that angle in which they are.
        obscured_burst: [s] for which they stay hidden, on average, while the vehicle stays tilted.
    """

    rate: Annotated[float, Within(0.1, 1000.0), Key("rate_hz")] = 120.0
    position_noise: Annotated[NotNegative, Key("position_noise_m")] = 0.0
    attitude_noise: Annotated[NotNegative, Key("attitude_noise_rad")] = 0.0
    capture_jitter: Annotated[NotNegative, Key("capture_jitter_s")] = 0.0
    latency: Annotated[Delay, Key("latency_s")] = 0.0
    arrival_jitter: Annotated[Delay, Key("arrival_jitter_s")] = 0.0
    dropout_probability: Share = 0.0
    obscured_angle: Annotated[float, Within(0.0, 180.0), Key("obscured_angle_deg")] = 180.0
    obscured_share: Share = 1.0
    obscured_burst: Annotated[float, Within(1e-3), Key("obscured_burst_s")] = 0.1


@dataclass(frozen=True)
class Anemometer(Section):
    """Wind over ground, noise in m/s per axis."""

    rate: Annotated[Rate, Key("rate_hz")] = 500.0
    noise: Annotated[NotNegative, Key("noise_m_s")] = 0.0


@dataclass(frozen=True)
class StateNoise(Section):
    """Standard deviations of white noise put straight on the states of a flight (see :func:`contaminate`).

    A simulation has no electrical speeds: that of the rotors is of their mechanical speed.
    """

    velocity: Annotated[NotNegative, Key("velocity_m_s")] = 0.0
    attitude: Annotated[NotNegative, Key("attitude_rad")] = 0.0
    rates: Annotated[NotNegative, Key("rates_rad_s")] = 0.0
    specific_force: Annotated[NotNegative, Key("specific_force_m_s2")] = 0.0
    rotor_speeds: Annotated[NotNegative, Key("rotor_speeds_rad_s")] = 0.0


@dataclass(frozen=True)
class _SuiteFile(Section):
    """The content of a file in config/noise; sensors without a key are perfect."""

    source: Any = None
    imu: Imu = Imu()
    rotor_speeds: RotorSpeedSensor = RotorSpeedSensor()
    mocap: MotionCapture = MotionCapture()
    wind: Anemometer = Anemometer()
    states: StateNoise = StateNoise()


# Suite whose rates are those of a vehicle's own sensors.
_USUAL = "paper"


@dataclass(frozen=True)
class SensorSuite:
    """All sensors of a vehicle and of the room that it flies in; `name` is the stem of its file."""

    name: str
    imu: Imu = Imu()
    rotor_speeds: RotorSpeedSensor = RotorSpeedSensor()
    mocap: MotionCapture = MotionCapture()
    wind: Anemometer = Anemometer()
    states: StateNoise = StateNoise()

    @classmethod
    def load(cls, name_or_path: str | Path) -> SensorSuite:
        """Read a suite by the name of a file in config/noise, by path, or from the folder of a model.

        A model says what its vehicle file does: noise of IMU and motion capture, and their delay.

        Raises:
            SimulationError: naming the file and the key that is unknown or impossible.
            ModelError, VehicleError: for a folder that is no model, or whose vehicle is not known.
        """
        folder = model_folder(name_or_path)
        if folder is not None:
            return cls.from_vehicle(folder.name, AerodynamicModel.load(folder).load_vehicle().noise)
        path, file = load_config("noise", name_or_path, _SuiteFile, SimulationError)
        return cls(path.stem, file.imu, file.rotor_speeds, file.mocap, file.wind, file.states)

    @classmethod
    def from_vehicle(cls, name: str, noise: SensorNoise) -> SensorSuite:
        """The noise that a vehicle file states; rates, drifts and all else are those of the usual suite."""
        usual = cls.load(_USUAL)
        # Bias walks of a vehicle file tune the estimator; they are not measured drifts.
        gyro = replace(usual.imu.gyro, noise=noise.gyro_noise_rad_s, noise_density=0.0)
        accelerometer = replace(
            usual.imu.accelerometer, noise=noise.accelerometer_noise_m_s2, noise_density=0.0
        )
        mocap = replace(
            usual.mocap,
            position_noise=noise.mocap_position_m,
            attitude_noise=noise.mocap_attitude_rad,
            latency=max(noise.mocap_delay_s, 0.0),
        )
        return replace(
            usual, name=name, imu=replace(usual.imu, gyro=gyro, accelerometer=accelerometer), mocap=mocap
        )


def generator(seed: int, name: str) -> np.random.Generator:
    """Random numbers that depend on seed and name alone, independent between names."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def inertial_samples(
    ideal: Array, sensor: InertialSensor, rate_hz: float, random: np.random.Generator
) -> Array:
    """Readings (N, 3) of a gyro or an accelerometer for true values `ideal` (N, 3).

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


def turned(attitude: Array, rotation: Array) -> Array:
    """Attitudes (N, 4) turned by rotation vectors (N, 3) rad, body axes."""
    return products(attitude, from_rotation_vector(rotation))


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
