# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What every law of the aerodynamics has in common."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics, airframe_area, vehicle_record


@pytest.mark.parametrize("name", ["bebop2", "hdbeetle"])
def test_effectiveness_in_hover_agrees_with_differences_of_the_wrench(name):
    model = RotorLocalModel.load(name)
    by_differences = SimulatedAerodynamics.effectiveness.func(model)
    np.testing.assert_allclose(by_differences, model.effectiveness, rtol=1e-9, atol=1e-18)


def test_record_of_a_vehicle():
    model = RotorLocalModel.load("bebop2")
    record = vehicle_record(model.vehicle, 700.0, 0.03)
    assert (record["mass"], record["hover_rotor_speed"], record["motor_time_constant"]) == (
        0.374,
        700.0,
        0.03,
    )
    np.testing.assert_allclose(record["inertia"][0] @ record["inverse_inertia"][0], np.eye(3), atol=1e-12)
    assert airframe_area(model.vehicle) == pytest.approx(4.0 * 0.0875 * 0.115)
