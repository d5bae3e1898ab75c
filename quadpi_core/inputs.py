# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The aerodynamic input vector X (van Beers and de Visser, Eq. 4 to 10).

X = [u, v, w, v_in, p, q, r, ω_avg, sin φ, cos φ, sin θ, cos θ, U_p, U_q, U_r, μ_x, μ_y, μ_z, μ_vin],
in SI units and body axes forward-right-down. (u, v, w) is the velocity relative to the air.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, isnan
from typing import Annotated, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.flight import Flight, Recording
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, ROTORS_MAX, PerRotor, Records, Threshold, Vector3, record_dtype
from quadpi_core.vehicle import Vehicle

INPUT_NAMES = (
    "u",
    "v",
    "w",
    "v_in",
    "p",
    "q",
    "r",
    "omega_avg",
    "sin_phi",
    "cos_phi",
    "sin_theta",
    "cos_theta",
    "U_p",
    "U_q",
    "U_r",
    "mu_x",
    "mu_y",
    "mu_z",
    "mu_v_in",
)
INPUT_INDEX = {name: index for index, name in enumerate(INPUT_NAMES)}
# Columns of u, v, w.
VELOCITY_INPUTS = [INPUT_INDEX[name] for name in ("u", "v", "w")]


class Derivatives:
    """Derivatives that a model may use beside the input vector, after the same low-pass.

    Attributes:
        angular_acceleration: rad/s², measured, body axes.
        rotor_speeds: rad/s; the input vectors have their root mean square and three differences.
        rotor_accelerations: rad/s².
        rotor_jerks: rad/s³, the derivative of `rotor_accelerations`.
        density_excess: by what share the air is denser than the vehicle file says; 0 where nothing tells.
    """

    angular_acceleration: Vector3
    rotor_speeds: PerRotor
    rotor_accelerations: PerRotor
    rotor_jerks: PerRotor
    density_excess: float


class VehicleConstants:
    """Numbers of a vehicle that inputs and wrench follow from, in SI units."""

    rotors: int
    control_signs: Annotated[Array, 3, ROTORS_MAX]  # of U_p, U_q, U_r
    rotor_radius: float
    hover_induced_velocity: float
    air_density: float
    mass: float
    inertia: Annotated[Array, 3, 3]


# Of four rotors.
DERIVATIVES = record_dtype(Derivatives, 4)
_VEHICLE_CONSTANTS = record_dtype(VehicleConstants)


def derivatives_like(values: object) -> np.dtype[np.void]:
    """The dtype of derivatives of as many rotors as some values have that are such; else of four."""
    speeds = getattr(getattr(values, "dtype", None), "fields", None) or {}
    shape = speeds["rotor_speeds"][0].shape if "rotor_speeds" in speeds else (4,)
    return record_dtype(Derivatives, min(shape[0], ROTORS_MAX)) if shape else DERIVATIVES


def whole_derivatives(values: Records) -> Records:
    """Derivatives (N,) as the core takes them: with room for more rotors, which numpy drops in joining."""
    return np.ascontiguousarray(values, derivatives_like(values))


def flight_derivatives(flight: Flight) -> Records:
    """Derivatives (N,) of a whole flight that has passed its low-pass; those of rotors by cubic splines."""
    # Slow to import, and most importers of this module need no spline.
    from scipy.interpolate import CubicSpline

    speeds, rotors = CubicSpline(flight.time, flight.rotor_speeds), flight.rotor_speeds.shape[1]
    derivatives = np.zeros(len(flight), record_dtype(Derivatives, rotors))
    derivatives["angular_acceleration"] = flight.angular_acceleration
    derivatives["rotor_speeds"] = flight.rotor_speeds
    derivatives["rotor_accelerations"] = speeds(flight.time, 1)
    derivatives["rotor_jerks"] = speeds(flight.time, 2)
    return derivatives


def flight_inputs(flight: Flight, vehicle: Vehicle) -> Array:
    """Input vectors (N, 19) of a whole flight.

    Raises:
        LogError: for a flight with another number of rotors than the vehicle.
    """
    rotors = flight.rotor_speeds.shape[1]
    if rotors != vehicle.rotor_count:
        raise LogError(
            f"{flight.source or flight.name}: rotor_speeds: {rotors} rotors, vehicle {vehicle.name} has "
            f"{vehicle.rotor_count}"
        )
    velocity_air = relative_to_air(flight.velocity, flight.attitude, flight.wind)
    return aerodynamic_inputs(velocity_air, flight.attitude, flight.rates, flight.rotor_speeds, vehicle)


def aerodynamic_inputs(
    velocity_air: Array, attitude: Array, rates: Array, rotor_speeds: Array, vehicle: Vehicle
) -> Array:
    """Input vectors X (N, 19), columns as :data:`INPUT_NAMES`.

    Args:
        velocity_air: (N, 3) m/s, relative to the air, body axes.
        attitude: (N, 4) unit quaternions w, x, y, z, body to world (NED).
        rates: (N, 3) rad/s.
        rotor_speeds: (N, rotors) rad/s, rotor order of the vehicle file.
        vehicle: gives rotor radius, rotor layout and the induced velocity in hover.
    """
    inputs = np.empty((len(velocity_air), len(INPUT_NAMES)))
    velocity, rates, speeds = map(np.ascontiguousarray, (velocity_air, rates, rotor_speeds))
    constants = vehicle_constants(vehicle)
    compiled.fill_inputs(velocity, np.ascontiguousarray(attitude), rates, speeds, constants, inputs)
    return inputs


def vehicle_constants(vehicle: Vehicle) -> Records:
    """The :class:`VehicleConstants` (1,) of a vehicle.

    The rows of the signs give U_p, U_q, U_r from the rotor speeds (Eq. 5 to 7) for any order of the
    rotors: left minus right, front minus rear, clockwise minus counterclockwise; a rotor on an axis is on
    neither side of it. Eq. 7 writes the last
    as S_R [(ω1 + ω3) − (ω2 + ω4)] with S_R = 1 where the first rotor turns clockwise.
    """
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    constants = np.zeros(1, _VEHICLE_CONSTANTS)
    constants["rotors"] = vehicle.rotor_count
    constants["control_signs"][..., : vehicle.rotor_count] = (-np.sign(y), np.sign(x), vehicle.rotor_spins)
    constants["rotor_radius"] = vehicle.rotor_radius_m
    constants["hover_induced_velocity"] = vehicle.hover_induced_velocity
    constants["air_density"] = vehicle.air_density_kg_m3
    constants["mass"], constants["inertia"] = vehicle.mass_kg, vehicle.inertia
    return constants


def relative_to_air(velocity: Array, attitude: Array, wind: Array) -> Array:
    """Velocity (N, 3) m/s relative to the air, body axes: ground velocity (body) less wind (world)."""
    out = np.empty((len(velocity), 3))
    velocity, attitude, wind = map(np.ascontiguousarray, (velocity, attitude, wind))
    compiled.relative_to_air(velocity, attitude, wind, out)
    return out


# At the same velocities and rotor speeds the wrench of the air goes with its density: 5 K change it by 1.7 %,
# 1000 m of height by 10 %. Models hold it at the density of the vehicle file, the standard atmosphere's
# unless it says another.

_Number = TypeVar("_Number", float, Array)

# At the sea, and the gas constant of dry air (ISO 2533).
STANDARD_DENSITY = 1.225
_GAS, ZERO_CELSIUS = 287.053, 273.15
# Of air that multirotors fly in [kg/m³]: from 9 km above the sea (ISO 2533) to sea level at -60 °C.
DENSITY_MIN, DENSITY_MAX = 0.4, 1.8
# Pressures there [Pa], and temperatures [°C], up to a barometer's board 30 K above the warmest air. What is
# beyond is of another unit, hPa or K above all, or of a dead sensor.
PRESSURE_MIN, PRESSURE_MAX = 3e4, 1.1e5
CELSIUS_MIN, CELSIUS_MAX = -60.0, 90.0
NOTICED = Threshold(
    "change of the density from which a flight goes on in another one",
    0.002,
    "",
    "16 m of height, or 0.6 K, change it by as much: a fifth of the percent that is asked of thrust",
    CONVENTION,
)
# Source of the density of a flight: none (assumed), sensors of the air, or a barometer on a board.
ASSUMED, MEASURED, BOARD = "", "measured", "barometer"
UNKNOWN_AIR = Threshold(
    "least and largest density of the air flown in, over the standard one, where nothing tells it",
    (0.62, 1.15),
    "",
    "multirotors fly from sea level at -30 °C to 3500 m at 30 °C",
    "ISO 2533",
)
STATED_AIR = Threshold(
    "the same, over the density of a vehicle file that says another than the standard one",
    (0.95, 1.05),
    "",
    "whoever wrote it knew the place; weather and season change it by 15 K",
    CONVENTION,
)
BOARD_AIR = Threshold(
    "the same, over the density by a barometer's own temperature",
    (1.0, 1.1),
    "",
    "it is that of its board, which reads up to 30 K above the air (ArduPilot's AP_Baro)",
    "two barometers of px4_sample_small.ulg in ../shared/data differ by 11 K",
)


def density_of(pressure: _Number, celsius: _Number) -> _Number:
    """Density of dry air [kg/m³] from pressure [Pa] and temperature (ideal gas, ISO 2533)."""
    return pressure / (_GAS * (celsius + ZERO_CELSIUS))


def celsius_of(pressure: Array, density: Array) -> Array:
    """Temperature of dry air of a pressure [Pa] and density [kg/m³]."""
    return pressure / (_GAS * density) - ZERO_CELSIUS


def is_pressure(pascal: Array) -> npt.NDArray[np.bool_]:
    """Which pressures (N,) can be of air that multirotors fly in."""
    return (pascal >= PRESSURE_MIN) & (pascal <= PRESSURE_MAX)


def is_celsius(celsius: Array) -> npt.NDArray[np.bool_]:
    """Which temperatures (N,) can be of that air, or of a board in it."""
    return (celsius >= CELSIUS_MIN) & (celsius <= CELSIUS_MAX)


def flown_in(recording: Recording) -> tuple[float, str] | None:
    """Median density of the air of a flight [kg/m³] and its source; None without one.

    A temperature that a source tells alone counts before that of a barometer, which warms itself.
    """
    nothing, barometer, apart = np.empty(0), recording.pressure, recording.temperature
    pressure = nothing if barometer is None else barometer.pressure
    celsius = nothing if apart is None else apart.celsius[is_celsius(apart.celsius)]
    if not len(celsius) and barometer is not None:
        celsius = barometer.celsius[is_celsius(barometer.celsius)]
    pressure = pressure[is_pressure(pressure)]
    if not len(pressure) or not len(celsius):
        return None
    density = density_of(float(np.median(pressure)), float(np.median(celsius)))
    if not DENSITY_MIN <= density <= DENSITY_MAX:
        return None
    return density, BOARD if recording.board_air else MEASURED


def density_range(told_by: str, file_density: float) -> tuple[float, float]:
    """Least and largest density of the air over that which a flight is taken to have been in."""
    if told_by == MEASURED:
        return 1.0, 1.0
    if told_by == BOARD:
        least, largest = BOARD_AIR.value
    else:
        least, largest = (UNKNOWN_AIR if file_density == STANDARD_DENSITY else STATED_AIR).value
    return least, largest


class Air:
    """Takes pressures and temperatures as they come, in flight or in replay.

    Attributes:
        density: kg/m³, which follows the last of both in steps of `NOTICED`; 0 before both are known.
    """

    def __init__(self) -> None:
        self.density = 0.0
        # Whether a source tells the temperature alone: a barometer, which warms itself, does not count then.
        self._apart = False
        self._pressure = self._celsius = float("nan")

    def hear(self, pressure: float, celsius: float) -> bool:
        """Take what a message tells, NaN for what it does not; whether the density is another now.

        What can be no pressure or temperature of the air counts as not told.
        """
        if CELSIUS_MIN <= celsius <= CELSIUS_MAX:
            self._apart = self._apart or isnan(pressure)
            celsius = celsius if isnan(pressure) or not self._apart else float("nan")
        self._pressure = pressure if PRESSURE_MIN <= pressure <= PRESSURE_MAX else self._pressure
        self._celsius = celsius if CELSIUS_MIN <= celsius <= CELSIUS_MAX else self._celsius
        if not isfinite(self._pressure + self._celsius):
            return False
        density = density_of(self._pressure, self._celsius)
        if not DENSITY_MIN <= density <= DENSITY_MAX:
            return False
        if self.density and abs(density / self.density - 1.0) < NOTICED.value:
            return False
        self.density = density
        return True

    def changes(self, block: Recording) -> Iterator[tuple[int, float]]:
        """After how many IMU samples of a block the density is another, and which."""
        rows = []
        for order, stream in enumerate((block.pressure, block.temperature)):
            if stream is not None:
                counts = block.arrivals_of(stream).tolist()
                told = zip(
                    stream.time_ns.tolist(), stream.pressure.tolist(), stream.celsius.tolist(), strict=True
                )
                rows += [
                    (count, time_ns, order, *one) for count, (time_ns, *one) in zip(counts, told, strict=True)
                ]
        for count, _, _, pressure, celsius in sorted(rows, key=lambda row: row[:3]):
            if self.hear(pressure, celsius):
                yield count, self.density
