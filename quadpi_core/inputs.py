# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The aerodynamic input vector X (van Beers and de Visser, Eq. 4 to 10).

X = [u, v, w, v_in, p, q, r, ω_avg, sin φ, cos φ, sin θ, cos θ, U_p, U_q, U_r, μ_x, μ_y, μ_z, μ_vin],
in SI units and body axes forward-right-down. (u, v, w) is the velocity relative to the air.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Vector3, record_dtype
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
# Which inputs are cosines of an angle: near 1 they go with its square.
COSINES = np.array([name.startswith("cos_") for name in INPUT_NAMES])


class Derivatives:
    """What a model may know of the motion beside the input vector; it has passed the same low-pass.

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
