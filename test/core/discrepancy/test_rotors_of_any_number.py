# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Searches in simulated flights of vehicles with six and eight rotors, coaxial ones too."""

from __future__ import annotations

from dataclasses import replace

import pytest

from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.study import discover
from quadpi_core.errors import SimulationError
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import parse_effects
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.simulated_bags import fly_and_sense

from ..multicopters import framed_file


def flown(plans, file, *effects):
    vehicle, suite = SimulatedVehicle.load(file), SensorSuite.load("paper")
    flights = []
    for plan in plans.values():
        _, sensed = fly_and_sense(replace(plan, effects=parse_effects(effects)), vehicle, suite)
        flights.append(fuse_airborne(sensed.recording, vehicle.vehicle, CUTOFF_HZ["default"]))
    return flights


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["hexa-x", "octo-coaxial-x"])
def test_a_weak_rotor_is_named_and_nothing_without_one(layout, plans, tmp_path):
    file = framed_file(tmp_path, layout)
    simulation = load_simulation(file)
    assert discover(simulation, flown(plans, file)).verdict == "none"
    found = discover(simulation, flown(plans, file, "weak_rotor:rotor=5,loss=0.15"))
    assert (found.verdict, [one.name for one in found.effects]) == ("effects", ["weak_rotor"])
    rotor, loss, _ = (one.value for one in found.effects[0].parameters)
    assert (rotor, loss) == (5.0, pytest.approx(0.15, abs=0.005))


def test_a_rotor_that_the_vehicle_has_not_is_refused(plans):
    with pytest.raises(SimulationError, match="effect `weak_rotor`: rotor 5, vehicle bebop2 has 4"):
        flown(plans, "bebop2", "weak_rotor:rotor=5,loss=0.15")
