# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A search by rotor speeds that are made of commands: what their errors hide, and what they do not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.discrepancy_result import discovery_json
from quadpi_core.discrepancy.study import discover
from quadpi_core.vehicle import Motors

from .regressions import of_sound_flights

SOUGHT = ["body_drag", "payload", "rotor_speed_scale", "weak_rotor"]
# Of a flight with its own gain, and of flights all alike.
SCATTERED, ALL_FAST = (1.02, 0.985, 1.01, 0.98), (1.03,) * 4


def motors(error=(0.002,) * 4, gain=0.02):
    coefficients = ((0.0, 1000.0, 0.0, 0.0, 0.0),) * 4
    return Motors(source="test", coefficients=coefficients, lag_s=0.03, error=error, gain=gain)


def by_commands(flights, factors=(1.0,) * 4, **options):
    """The flights as if their rotor speeds were made of commands, off by a factor each."""
    pairs = zip(flights, factors, strict=True)
    made = motors(**options)
    return [replace(own, rotor_speeds=own.rotor_speeds * by, motors=made) for own, by in pairs]


def test_a_gain_of_each_flight_is_no_effect(simulation, flights):
    found = discover(simulation, by_commands(flights, SCATTERED), names=SOUGHT)
    assert (found.verdict, found.effects) == ("none", ())
    as_measured = [replace(own, motors=None) for own in by_commands(flights, SCATTERED)]
    assert discover(simulation, as_measured, names=SOUGHT).verdict != "none"


def test_what_speeds_do_not_resemble_is_named_as_by_measured_ones(simulation, dragged):
    measured = discover(simulation, dragged, names=SOUGHT)
    found = discover(simulation, by_commands(dragged), names=SOUGHT)
    assert [one.name for one in found.effects] == ["body_drag"]
    for one, other in zip(found.effects[0].parameters, measured.effects[0].parameters, strict=True):
        assert one.value == pytest.approx(other.value, rel=0.02)
    assert found.commanded.alike == ()
    assert measured.commanded is None


def test_a_gain_of_all_flights_is_named_where_its_scatter_is_known_and_said_to_look_like_one(
    simulation, flights
):
    of_known_noise = of_sound_flights(simulation)
    found = discover(of_known_noise, by_commands(flights, ALL_FAST, gain=0.002), names=SOUGHT)
    assert [one.name for one in found.effects] == ["rotor_speed_scale"]
    ((name, gains),) = found.commanded.alike
    assert name == "rotor_speed_scale"
    assert np.abs(gains) == pytest.approx(0.03, abs=0.01)
    assert "only its size speaks for it" in found.commanded.sentences[-1]
    data = discovery_json(found)["rotor_speeds_from_commands"]
    assert json.loads(json.dumps(data))["alike"].keys() == {"rotor_speed_scale"}


def test_motors_known_by_thrust_alone_hide_a_mass(simulation, flights):
    """Their scale is that of the searched flights, so nothing that scales thrust is found."""
    by_thrust, of_known_noise = by_commands(flights, ALL_FAST, error=()), of_sound_flights(simulation)
    found = discover(of_known_noise, by_thrust, names=SOUGHT)
    assert (found.verdict, found.effects) == ("none", ())
    assert not found.commanded.scale_known
    assert "cannot be told apart" in " ".join(found.commanded.sentences)
    assert {"payload", "rotor_speed_scale"} <= set(found.commanded.hidden)
    flown = replace(simulation.vehicle, motors=by_thrust[0].motors)
    known = replace(of_known_noise, model=simulation.model.carrying(flown))
    assert discover(known, by_thrust, names=SOUGHT).commanded.scale_known
