# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights beyond those that a vehicle was identified on."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.truth import STEP_HZ


def fly(source, scenario, name, seconds=60.0):
    (plan,) = (plan for plan in load_scenario(scenario).flights if plan.name == name)
    whole = plan.reference(STEP_HZ)
    part = {column.name: getattr(whole, column.name)[: int(seconds * STEP_HZ)] for column in fields(whole)}
    return simulate_flight(name, SimulatedVehicle.load(source), replace(whole, **part), seed=1)


def test_a_flight_like_those_of_the_identification_is_inside(physical_folder):
    assert fly(physical_folder, "bundled", "train_2").excursion is None


def test_a_faster_one_says_where_it_went(physical_folder):
    found = fly(physical_folder, "dash", "dash", seconds=13.0).excursion
    assert 0.05 < found.share < 1.0
    assert not found.lower <= found.reached <= found.upper
    assert found.input in found.sentence()
    assert f"{found.share:.1%} of its time" in found.sentence()


def test_one_that_is_lost_says_that_it_was_outside(physical_folder):
    with pytest.raises(
        SimulationError, match=r"out of control .*; it was beyond the flights .*identified on"
    ):
        fly(physical_folder, "dash", "dash")


def test_a_vehicle_that_was_not_identified_has_no_range():
    assert fly("bebop2", "dash", "dash", seconds=13.0).excursion is None
