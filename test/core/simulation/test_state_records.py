# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the compiled physics hold each number under its name, in the order of the vehicle file."""

from __future__ import annotations

import numpy as np

from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.state_records import STATE, VEHICLE


def test_the_record_of_a_vehicle_is_its_file():
    simulated = SimulatedVehicle.load("bebop2")
    vehicle, model = simulated.vehicle, simulated.aerodynamics
    (record,) = simulated.record()
    assert record.dtype == VEHICLE
    expected = {
        "mass": vehicle.mass_kg,
        "gravity": vehicle.gravity_m_s2,
        "air_density": vehicle.air_density_kg_m3,
        "inertia": vehicle.inertia,
        "inverse_inertia": np.linalg.inv(vehicle.inertia),
        "rotors": 4,
        "rotor_positions": vehicle.rotor_positions,
        "rotor_spins": vehicle.rotor_spins,
        "rotor_radius": vehicle.rotor_radius_m,
        "hover_induced_velocity": vehicle.hover_induced_velocity,
        "hover_rotor_speed": model.hover_rotor_speed,
        "motor_time_constant": simulated.motor_time_constant,
        "rotor_speed_max": vehicle.rotor_speed_max_rad_s,
        "airframe_area": 4.0 * 0.0875 * 0.115,
        # Counted in the torque of the rotors.
        "rotor_inertia": 0.0,
        **vars(model.coefficients),
    }
    assert set(expected) == set(VEHICLE.names)
    for name, values in expected.items():
        np.testing.assert_allclose(record[name], values, rtol=1e-12, err_msg=name)


def test_states_hold_what_they_are_made_of(states, model):
    """Hub velocities are those of a rigid body; rotors push along -z and turn the body."""
    assert states.dtype == STATE
    turning = np.cross(states["rates"][:, None], model.vehicle.rotor_positions)
    np.testing.assert_allclose(states["hub_velocity"], states["velocity_air"][:, None] + turning, atol=1e-12)
    # What belongs to an effect is not filled by the aerodynamics.
    for name in set(STATE.names) - {"force_is_measured", "memory", "memory_slope"}:
        assert states[name].any(), name
