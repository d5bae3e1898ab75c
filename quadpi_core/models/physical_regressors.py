# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regressors of the physical model: the wrench of each of its terms, per unit of its parameter.

Rotor i at r_i with spin s_i and speed ω sees V + Ω × r_i = (u, v, w), with h = √(u² + v²) in its plane and
its own induced velocity v_i; `physical_terms` says what each term means and where it comes from.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.physical_terms import TERMS
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, record_dtype
from quadpi_core.vehicle import Vehicle


class MotionSample:
    """What the regressors of a sample follow from; SI, body axes.

    Attributes:
        velocity: m/s relative to the air.
        rates: rad/s.
        angular_acceleration: rad/s².
        rotor_speeds: rad/s.
        rotor_accelerations: rad/s².
    """

    velocity: Annotated[Array, 3]
    rates: Annotated[Array, 3]
    angular_acceleration: Annotated[Array, 3]
    rotor_speeds: PerRotor
    rotor_accelerations: PerRotor


class PhysicalVehicle:
    """The numbers of a vehicle that the regressors need.

    Attributes:
        mass: kg.
        reference_thrust: N s², of a rotor per ω², for the induced velocity.
        disc: kg/m, 2 ρ π R² of momentum theory.
        rotors: their number.
        positions: m, of the rotors.
        spins: +1 where a rotor turns clockwise seen from above.
    """

    mass: float
    reference_thrust: float
    disc: float
    rotors: int
    positions: Annotated[Array, ROTORS_MAX, 3]
    spins: PerRotor


# Of four rotors.
MOTION = record_dtype(MotionSample, 4)
PHYSICAL_VEHICLE = record_dtype(PhysicalVehicle, 4)


def physical_vehicle(vehicle: Vehicle, reference_thrust: float) -> Records:
    """Record PHYSICAL_VEHICLE (1,) of a vehicle.

    Args:
        vehicle: that flew.
        reference_thrust: [N s²] thrust of a rotor over ω², near hover.

    Raises:
        ModelError: naming the vehicle, see :func:`control_signs`.
    """
    record = numbers_of(vehicle, reference_thrust)
    with named_in(f"vehicle {vehicle.name}"):
        control_signs(record)
    return record


def numbers_of(vehicle: Vehicle, reference_thrust: float) -> Records:
    """Record PHYSICAL_VEHICLE (1,) as `physical_vehicle` gives it, for any layout of the rotors."""
    record = np.zeros(1, record_dtype(PhysicalVehicle, vehicle.rotor_count))
    record["rotors"] = vehicle.rotor_count
    record["mass"] = vehicle.mass_kg
    record["reference_thrust"] = reference_thrust
    record["disc"] = 2.0 * vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**2
    record["positions"] = vehicle.rotor_positions
    record["spins"] = vehicle.rotor_spins
    return record


def control_signs(vehicle: Records) -> Array:
    """Signs (3, rotors) that give U_p, U_q and U_r of the rotor speeds, see `inputs.vehicle_constants`.

    Raises:
        ModelError: where the rotor speeds of four rotors do not follow from these and their root mean square.
    """
    positions, spins = vehicle["positions"][0], vehicle["spins"][0]
    signs: Array = np.stack((-np.sign(positions[:, 1]), np.sign(positions[:, 0]), spins))
    every = np.vstack((np.ones(len(spins)), signs))
    if len(spins) == 4 and signs.all() and not np.array_equal(every @ every.T, 4.0 * np.eye(4)):
        raise ModelError(
            "the physical model needs a rotor in each quadrant, neighbours turning in opposite ways"
        )
    return signs


@cache
def acting_terms() -> npt.NDArray[np.bool_]:
    """Which axes (P, 6) each term acts on, for a vehicle without any symmetry."""
    motion = np.zeros(2, MOTION)
    motion["velocity"] = [[3.0, 2.0, 1.0], [-1.0, 2.0, -3.0]]
    motion["rates"] = [[0.3, 0.2, 0.1], [0.1, -0.2, 0.3]]
    motion["angular_acceleration"] = [1.0, 2.0, 3.0]
    motion["rotor_speeds"] = [900.0, 1000.0, 1100.0, 1250.0]
    motion["rotor_accelerations"] = [1.0, 2.0, 4.0, 8.0]
    vehicle = np.zeros(1, PHYSICAL_VEHICLE)
    vehicle["mass"], vehicle["reference_thrust"], vehicle["disc"] = 1.0, 1e-6, 0.1
    vehicle["positions"] = [[-0.1, 0.11, 0.0], [0.12, 0.13, 0.0], [-0.14, -0.15, 0.0], [0.16, -0.17, 0.0]]
    vehicle["spins"], vehicle["rotors"] = [1.0, -1.0, -1.0, 1.0], 4
    acts: npt.NDArray[np.bool_] = np.any(regressors(motion, vehicle) != 0.0, axis=0)
    return acts


def regressors(motion: Records, vehicle: Records) -> Array:
    """Regressors (N, P, 6) of samples, the terms in the order of TERMS.

    Args:
        motion: MOTION (N,).
        vehicle: PHYSICAL_VEHICLE (1,).
    """
    rows = np.empty((len(motion), len(TERMS), len(AXES)))
    compiled.fill_regressors(_whole(motion, vehicle), vehicle, rows)
    return rows


def wrenches(motion: Records, vehicle: Records, parameters: Array) -> Array:
    """Wrench (N, 6) of samples, by parameters (P,) in the order of TERMS."""
    out = np.empty((len(motion), len(AXES)))
    compiled.physical_wrenches(_whole(motion, vehicle), vehicle, np.ascontiguousarray(parameters), out)
    return out


def _whole(motion: Records, vehicle: Records) -> Records:
    """Motion with room for more rotors, which what numpy has joined lacks."""
    return np.ascontiguousarray(motion, record_dtype(MotionSample, int(vehicle["rotors"][0])))
