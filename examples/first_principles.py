# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulation from first principles: every rotor gives thrust k ω² and torque c ω², and nothing else does.

Functions like these are what `quadpi discrepancy first_principles:neurobem … --vehicle neurobem` asks: they
take a flight and give its wrench.
"""

from __future__ import annotations

import numpy as np

from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

NEUROBEM = Vehicle.load("neurobem")
CRAZYFLIE = Vehicle.load("crazyflie_rpm")


def thrust_and_torque(flight: Flight, vehicle: Vehicle, thrust_n_s2: float, torque_nm_s2: float) -> Array:
    """Wrench (N, 6) [N, Nm], body axes forward-right-down, of rotors in still air.

    Args:
        flight: gives the rotor speeds.
        vehicle: gives places and directions of the rotors.
        thrust_n_s2: k of a rotor.
        torque_nm_s2: c of a rotor; the body turns against it.
    """
    squares = np.square(flight.rotor_speeds)
    thrusts, torques = thrust_n_s2 * squares, -torque_nm_s2 * squares * vehicle.rotor_spins
    x, y, _ = vehicle.rotor_positions.T
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -thrusts.sum(axis=1)
    wrench[:, 3], wrench[:, 4] = -thrusts @ y, thrusts @ x
    wrench[:, 5] = torques.sum(axis=1)
    return wrench


def neurobem(flight: Flight) -> Array:
    """The NeuroBEM vehicle.

    k carries the weight at the rotor speeds of slow flight, below 0.7 m/s (four flights: 1.49e-6 to 1.54e-6).
    c/k is that of 5-inch propellers, C_Q R / C_T near 0.015 m: assumed.
    """
    return thrust_and_torque(flight, NEUROBEM, 1.5e-6, 2.3e-8)


def crazyflie(flight: Flight) -> Array:
    """The Crazyflie with the RPM deck.

    k carries the weight in slow flight (3.68e-8); c/k is 0.00596 m: Förster, "System identification of the
    Crazyflie 2.0", ETH Zurich 2015.
    """
    return thrust_and_torque(flight, CRAZYFLIE, 3.68e-8, 2.19e-10)
