# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference and truth: what follows from their columns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.signals.wrench import newton_euler
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.state_records import STATE, VEHICLE
from quadpi_core.simulation.truth import Reference, read_motion

from .references import COUPLED


def test_a_hover_stands_still():
    hover = Reference.hover(np.array([1.0, 2.0, -3.0]), 5)
    assert len(hover) == 5
    np.testing.assert_array_equal(hover.position, np.tile([1.0, 2.0, -3.0], (5, 1)))
    rest = (hover.velocity, hover.acceleration, hover.yaw, hover.yaw_rate, hover.tilt, hover.thrust)
    assert not any(column.any() for column in rest)


def test_every_second_instant_is_that_of_all_columns():
    every = COUPLED.every(2)
    assert len(every) == (len(COUPLED) + 1) // 2
    np.testing.assert_array_equal(every.position[7], COUPLED.position[14])
    np.testing.assert_array_equal(every.yaw_rate[7], COUPLED.yaw_rate[14])


@pytest.fixture(scope="module")
def truth(swing):
    return swing()


def test_airspeed_is_relative_to_the_wind(truth):
    turn = Rotation.from_quat(np.roll(truth.attitude, -1, axis=1))
    through_air = truth.velocity - turn.inv().apply(truth.wind)
    np.testing.assert_allclose(truth.speed, np.linalg.norm(through_air, axis=1))
    assert truth.speed.max() > 5.0 + np.linalg.norm(truth.velocity, axis=1).min()


def test_position_error_is_the_distance_from_the_reference(truth):
    aside = truth.position - truth.reference.position
    assert truth.position_error == pytest.approx(np.sqrt(np.square(aside).sum(axis=1)), abs=1e-12)


def test_truth_as_a_flight_measures_its_own_wrench(truth):
    """Seconds since the first stamp, the air's true wind, and derivatives that belong together."""
    flight, vehicle = truth.flight(), truth.vehicle
    measured = newton_euler(
        flight.specific_force, flight.rates, flight.angular_acceleration, vehicle.mass_kg, vehicle.inertia
    )
    np.testing.assert_allclose(measured, truth.wrench, atol=1e-12)
    assert (flight.start_ns, flight.time[0]) == (truth.time_ns[0], 0.0)
    np.testing.assert_allclose(np.diff(flight.time), 0.002, atol=1e-9)
    np.testing.assert_array_equal(flight.wind, truth.wind)


def test_axes_of_a_motion_have_one_order_whatever_the_file_s():
    step = {
        "sine": {"amplitude_m": 1.5, "frequency_hz": 0.25, "start_s": 0.5, "duration_s": 7.0, "fade_s": 2.0}
    }
    assert list(read_motion({"height": [step], "y": None, "x": [step]})) == ["x", "height"]


# Records of the compiled physics hold each number under its name, in the order of the vehicle file.


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
