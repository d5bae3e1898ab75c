# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of the aerodynamics: those of the core by name, and functions of Python."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.state_records import STATE, VEHICLE, apply_to_all, six_columns
from quadpi_core.simulation.truth import STEP_HZ, Reference


def test_a_function_takes_all_states_and_its_numbers():
    def push(state, vehicle, numbers):
        state.wrench[:, 0] += numbers[0, 0] * state.rates[:, 0] * vehicle.mass

    states, vehicle = np.zeros(3, STATE), np.zeros(1, VEHICLE)
    states["rates"][:, 0], vehicle["mass"] = [1.0, 2.0, 3.0], 2.0
    apply_to_all(states, vehicle, push, np.array([[0.5]]))
    np.testing.assert_array_equal(states["wrench"][:, 0], [1.0, 2.0, 3.0])


class _OfPython(RotorLocalModel):
    """The rotor-local law as a function of Python."""

    @property
    def function(self):
        def law(state, vehicle, numbers):
            states = np.zeros(len(state.wrench), STATE)
            for name in STATE.names:
                states[name] = getattr(state, name)
            apply_to_all(states, np.array([tuple(vehicle)], VEHICLE), "rotor_local", numbers)
            for name in ("hub_velocity", "thrusts", "torques", "wrench"):
                getattr(state, name)[:] = states[name]

        return law


def test_a_law_of_python_flies_as_one_of_the_core():
    bebop, reference = SimulatedVehicle.load("bebop2"), Reference.hover(np.array([0.0, 0.0, -3.0]), STEP_HZ)
    wind = np.array([2.0, 1.0, 0.0])
    expected = simulate_flight("hop", bebop, reference, known_wind=wind)
    law = _OfPython(bebop.vehicle, bebop.aerodynamics.coefficients)
    own = SimulatedVehicle(law, bebop.motor_time_constant)
    found = simulate_flight("hop", own, reference, known_wind=wind)
    assert np.ptp(found.rotor_speeds, axis=0).min() > 0.1
    for name in ("position", "attitude", "rates", "rotor_speeds", "wrench"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_law_that_does_not_exist_is_refused(states, record):
    with pytest.raises(ValueError, match="no such law of the aerodynamics"):
        apply_to_all(states.copy(), record, "lattice", np.zeros((0, 0)))


@pytest.mark.parametrize("wrench", [(0.0,) * 5, (0.0,) * 7, (np.zeros(3), *(0.0,) * 5), 1.0])
def test_what_are_not_six_columns_is_refused(wrench):
    with pytest.raises(ValueError, match="an effect gives six forces and moments"):
        six_columns(wrench, 2)
