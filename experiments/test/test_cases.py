# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The cases: what a search gets tells nothing of what is hidden, but the flights show it."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields
from functools import cache

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


@cache
def residuals(name, flight):
    """RMS (6,) of measured less simulated wrench in a flight of a vehicle with an effect: N and Nm.

    With None of one that is exactly as its file says; always with the same noise.
    """
    vehicle, rng = SimulatedVehicle.load(VEHICLE), np.random.default_rng(5)
    specimen = Specimen(vehicle) if name is None else altered(Specimen(vehicle), name, 1.0, rng)
    plans = [plan for plan in load_scenario(RICH).flights if plan.name == flight]
    (flown,) = flights_of(specimen, plans, SensorSuite.load("paper"), 1)
    simulated = vehicle.aerodynamics.wrench(flown.velocity, flown.rates, flown.rotor_speeds)
    return np.sqrt(np.square(measured_wrench(flown, vehicle.vehicle) - simulated).mean(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_full_size_stands_out_of_the_noise(name):
    """By itself in at least one axis, and by less than the weight: near the ground, or in translation."""
    flight = "low" if name in {"ground_effect", "inflow_damping"} else "coupled"
    seen = residuals(name, flight)
    assert np.max(seen / residuals(None, flight)) > 1.5
    assert seen[:3].max() < 1.2
    assert seen[3:].max() < 0.05
