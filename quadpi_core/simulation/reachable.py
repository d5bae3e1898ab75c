# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a vehicle can follow a reference at all, before it tries."""

from __future__ import annotations

import numpy as np

from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.controller import TILT_MAX_DEG
from quadpi_core.simulation.flight_plan import FlightPlan
from quadpi_core.simulation.reference import Reference
from quadpi_core.simulation.simulated_vehicle import SimulatedVehicle

# The rotor-local model was measured up to 14 m/s; flights against such a wind go forward in it too.
AIRSPEED_MAX_M_S = 16.0
# With what is put on top of the path's.
EXCITED_TILT_MAX_DEG = 75.0
YAW_RATE_MAX_DEG_S = 360.0


def require_reachable(plan: FlightPlan, vehicle: SimulatedVehicle, reference: Reference) -> None:
    """Refuse a reference that asks for more than the vehicle has; drag is left out.

    Args:
        plan: of the flight.
        vehicle: that flies it.
        reference: of the plan, from its first to its last instant.

    Raises:
        SimulationError: naming flight and instant, what is demanded and what there is.
    """
    nominal = vehicle.vehicle
    wind = 0.0 if plan.known_wind is None else plan.known_wind
    gravity = np.array([0.0, 0.0, nominal.gravity_m_s2])
    force = reference.acceleration - gravity
    upright = np.arctan2(np.hypot(force[:, 0], force[:, 1]), -force[:, 2])
    thrust = _size(force) + reference.thrust * nominal.gravity_m_s2
    limits: tuple[tuple[str, str, Array, float], ...] = (
        ("specific force", "m/s²", thrust, vehicle.greatest_thrust / nominal.mass_kg),
        ("specific force downward", "m/s²", -thrust, 0.0),
        ("airspeed", "m/s", _size(reference.velocity - wind), AIRSPEED_MAX_M_S),
        ("tilt along the path", "degrees", np.degrees(upright), TILT_MAX_DEG),
        ("tilt", "degrees", np.degrees(upright + _size(reference.tilt)), EXCITED_TILT_MAX_DEG),
        ("yaw rate", "degrees/s", np.degrees(np.abs(reference.yaw_rate)), YAW_RATE_MAX_DEG_S),
    )
    for quantity, unit, demanded, available in limits:
        worst = int(np.argmax(demanded))
        # Written so that what is no number is refused too.
        if not demanded[worst] <= available:
            seconds = plan.duration_s * worst / (len(reference) - 1)
            raise SimulationError(
                f"flight {plan.name}: unreachable reference: at {seconds:.2f} s it demands "
                f"{demanded[worst]:.1f} {unit} of {quantity}, and {nominal.name} has {available:.1f}"
            )


def _size(vectors: Array) -> Array:
    size: Array = np.sqrt((vectors * vectors).sum(axis=1))
    return size
