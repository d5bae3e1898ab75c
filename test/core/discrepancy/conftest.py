# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights with effects in them, through sensors and estimator, each kind flown once."""

from __future__ import annotations

from functools import cache

import pytest

from quadpi_core.identification import CUTOFF_HZ, airborne
from quadpi_core.signals.fusion import fuse
from quadpi_core.simulation.choice import parse_effects
from quadpi_core.simulation.effects import read_effects
from quadpi_core.simulation.flying import simulate_flight
from quadpi_core.simulation.noise import SensorSuite
from quadpi_core.simulation.reference import STEP_HZ
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.vehicle import SimulatedVehicle

FLOWN = ("forward", "climb", "throttle", "turns")


@pytest.fixture(scope="session")
def plans():
    return {plan.name: plan for plan in load_scenario("discovery").flights if plan.name in FLOWN}


@pytest.fixture(scope="session")
def flown(plans):
    """flown("name:parameter=value", …) → four flights of the Bebop 2 that has these effects."""
    vehicle, suite = SimulatedVehicle.load("bebop2"), SensorSuite.load("paper")

    @cache
    def fly(*texts):
        effects = parse_effects(texts) if texts else read_effects(None, "test")
        flights = []
        for plan in plans.values():
            truth = simulate_flight(
                plan.name, vehicle, plan.reference(STEP_HZ), effects=effects, seed=plan.seed
            )
            sensed = sense(truth, vehicle.vehicle, suite, effects, (), plan.seed)
            fused = fuse(sensed.recording, vehicle.vehicle, CUTOFF_HZ["default"])
            flights.append(airborne(fused, vehicle.vehicle.gravity_m_s2))
        return flights

    return fly
