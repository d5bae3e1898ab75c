# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights with effects in them, through sensors and estimator, each kind flown once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from threadpoolctl import threadpool_limits

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.other_simulations import of_coefficient
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.simulation.applied_effects import read_effects
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario, parse_effects
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.simulated_bags import fly_and_sense

from .regressions import NAMES, of_sound_flights, regression_of

FLOWN = ("forward", "climb", "throttle", "turns")


@pytest.fixture(autouse=True)
def one_thread():
    """As in a search: products are so small that two threads take twice the time of one."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def plans():
    return {plan.name: plan for plan in load_scenario("discovery").flights if plan.name in FLOWN}


@pytest.fixture(scope="session")
def flown(plans):
    """flown("name:parameter=value", …) → four flights of the Bebop 2 that has these effects.

    With hover=True they are of nothing but hover and throttle.
    """
    hovers = {plan.name: plan for plan in load_scenario("discovery_hover").flights}
    vehicle, suite = SimulatedVehicle.load("bebop2"), SensorSuite.load("paper")

    @cache
    def fly(*texts, hover=False):
        effects = parse_effects(texts) if texts else read_effects(None, "test")
        flights = []
        for plan in (hovers if hover else plans).values():
            _, sensed = fly_and_sense(replace(plan, effects=effects), vehicle, suite)
            flights.append(fuse_airborne(sensed.recording, vehicle.vehicle, CUTOFF_HZ["default"]))
        return flights

    return fly


@pytest.fixture(scope="session")
def flight(flown):
    """A flight of the Bebop 2 without effects."""
    return flown()[0]


@pytest.fixture(scope="session")
def sounded(simulation, flights):
    """Of two flights beside a simulation whose noise is known, and no error."""
    return regression_of(of_sound_flights(simulation), flights[:2], NAMES)


@pytest.fixture(scope="session")
def moved_tolerances():
    """moved_tolerances(flights, simulation) → by name what a fit without effects moves a coefficient by.

    In its tolerances; of axes that a law moves together, with what it moves them by.
    """

    def moved(flights, simulation):
        compared = Compared.together(flights, simulation)
        regression = Regression.from_flights(compared, candidates(simulation.vehicle, ["payload"]))
        found = regression.fit(())
        assert found is not None
        names, laws = regression.tolerances.names, regression.tolerances.laws
        values = dict(zip(names, regression.moved_by(found), strict=True))
        return {
            name: of_coefficient(values[name], values[law]) if law else values[name]
            for name, law in zip(names, laws, strict=True)
        }

    return moved
