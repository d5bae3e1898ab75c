# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The cases: what a search gets tells nothing of what is hidden, but the flights show it."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields

import numpy as np
import pytest
from blind import elsewhere
from blind.cases import (
    ELSE,
    HOVER,
    NULL,
    OUT,
    PAIR,
    POOR,
    RICH,
    SINGLE,
    VEHICLE,
    Case,
    Hidden,
    all_cases,
    short_cases,
)
from blind.effects import EFFECTS, altered
from blind.specimen import Specimen, flights_of

from quadpi_core.flight import Flight
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.simulated_bags import require_reachable
from quadpi_core.simulation.truth import STEP_HZ


def test_as_many_as_asked_for():
    cases = all_cases()
    kinds = Counter(Hidden.opened(case.seal).kind for case in cases)
    others = {ELSE: 5} if elsewhere.available() else {}
    assert kinds == {NULL: 100, SINGLE: 24 * 3 * 5, OUT: 7 * 5, PAIR: 10 * 5, POOR: 24 * 5, **others}
    assert len({case.key for case in cases}) == len(cases)
    assert not {case.key for case in short_cases()} & {case.key for case in cases}


def test_seals_open_and_do_not_show():
    hidden = Hidden(PAIR, ("wind", "payload"), 0.5, 7)
    assert Hidden.opened(hidden.sealed()) == hidden
    assert "wind" not in hidden.sealed()
    assert "wind" not in Case(hidden.sealed()).key


@pytest.mark.slow
def test_flights_tell_nothing_but_numbers():
    case = Case(Hidden(POOR, ("thrust_coefficient",), 1.0, 3).sealed())
    again, flights = case.flights(), case.flights()
    names = [plan.name for plan in load_scenario(HOVER).flights]
    assert [flight.name for flight in flights] == names
    for flight, other in zip(flights, again, strict=True):
        for column in fields(Flight):
            value = getattr(flight, column.name)
            assert np.array_equal(value, getattr(other, column.name))
            assert not isinstance(value, str) or value in {flight.name, VEHICLE, ""}


@pytest.mark.parametrize("scenario", [RICH, "discovery_check", HOVER])
def test_flights_can_be_flown(scenario):
    vehicle = SimulatedVehicle.load(VEHICLE)
    for plan in load_scenario(scenario).flights:
        require_reachable(plan, vehicle, plan.reference(STEP_HZ))


@pytest.fixture(scope="module")
def residuals():
    """residuals(specimen) → (N, 6) measured less simulated wrench, always with the same noise.

    Of three of the flights: near the ground, in translation, in rotation. Each effect shows in one of them.
    """
    vehicle, suite = SimulatedVehicle.load(VEHICLE), SensorSuite.load("paper")
    plans = [plan for plan in load_scenario(RICH).flights if plan.name in {"low", "coupled", "attitude"}]

    def of(specimen):
        flights = flights_of(specimen, plans, suite, 1)
        return np.vstack(
            [
                measured_wrench(flight, vehicle.vehicle)
                - vehicle.aerodynamics.wrench(flight.velocity, flight.rates, flight.rotor_speeds)
                for flight in flights
            ]
        )

    return of


@pytest.fixture(scope="module")
def noise(residuals):
    """Of a vehicle that is exactly as its file says (6,): N and Nm."""
    return np.sqrt(np.square(residuals(Specimen(SimulatedVehicle.load(VEHICLE)))).mean(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_full_size_stands_out_of_the_noise(name, residuals, noise):
    """By itself in at least one axis, and by less than the weight."""
    specimen = altered(Specimen(SimulatedVehicle.load(VEHICLE)), name, 1.0, np.random.default_rng(5))
    seen = np.sqrt(np.square(residuals(specimen)).mean(axis=0))
    assert np.max(seen / noise) > 1.5
    assert seen[:3].max() < 1.2
    assert seen[3:].max() < 0.05
