# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A load on a cable: beside two free bodies joined by a spring, and in flight."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.frames import matrix
from quadpi_core.simulation.applied_effects import effect_wrench, memory_at_rest, read_effects, with_memory
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.state_records import STATE
from quadpi_core.simulation.truth import STEP_HZ, Reference

from ..two_bodies import ATTITUDE, flown

LOAD = {"mass_kg": 0.03, "length_m": 0.5, "damping_1_s": 0.0, "hook_m": 0.0}
STEP_S = 0.004


@pytest.fixture(scope="module")
def two_bodies(record):
    return flown(record["mass"][0], LOAD["mass_kg"], LOAD["length_m"])


def pushed(force, measured=1.0):
    """Records at one attitude with this force [N], world."""
    states = np.zeros(len(force), dtype=STATE)
    states["attitude"] = ATTITUDE
    states["wrench"][:, :3] = force @ matrix(ATTITUDE)
    states["force_is_measured"] = measured
    return states


@pytest.mark.parametrize("measured", [True, False])
def test_swing_and_pull_are_those_of_two_bodies(two_bodies, record, measured):
    states = two_bodies.states(measured=measured)
    filled = with_memory("slung_load", LOAD, states, record, np.array([0, 0, 1.0, 0, 0, 0]), STEP_S)
    found = filled["memory"][:, :3] / np.linalg.norm(filled["memory"][:, :3], axis=1, keepdims=True)
    assert np.abs(two_bodies.direction[:, :2]).max() > 0.3
    np.testing.assert_allclose(found, two_bodies.direction, atol=0.01)
    added = effect_wrench("slung_load", LOAD, filled, record)
    # The spring bounces at first.
    still = two_bodies.time > 0.5
    np.testing.assert_allclose(added[still], two_bodies.pull_in_body()[still], atol=0.005)


def test_damping_stops_the_swing(record):
    states = pushed(np.tile([0.0, 0.0, -9.80665 * record["mass"][0]], (1000, 1)), 1.0)
    aside = np.array([np.sin(0.1), 0.0, np.cos(0.1), 0.0, 0.0, 0.0])

    def amplitude(damping):
        swung = with_memory("slung_load", {**LOAD, "damping_1_s": damping}, states, record, aside, STEP_S)
        return np.abs(swung["memory"][-400:, 0]).max()

    assert amplitude(0.0) == pytest.approx(np.sin(0.1), rel=0.01)
    # Its peak decays as exp(-c t / 2), and comes within half a swing of 2.4 s.
    assert amplitude(1.0) == pytest.approx(np.sin(0.1) * np.exp(-1.2), rel=0.35)


def test_without_swing_it_is_a_mass_more(record):
    force = np.array([[0.3, -0.2, -4.0]])
    added = effect_wrench("slung_load", LOAD, pushed(force, 1.0), record)[:, :3]
    np.testing.assert_allclose(added @ matrix(ATTITUDE).T, -0.03 / record["mass"] * force, rtol=1e-12)


def test_a_hook_below_the_centre_of_gravity_turns_the_vehicle(record):
    states = pushed(np.array([[0.3, -0.2, -4.0]]), 1.0)
    added = effect_wrench("slung_load", {**LOAD, "hook_m": 0.02}, states, record)
    np.testing.assert_allclose(added[:, 3:], np.cross([0.0, 0.0, 0.02], added[:, :3]), atol=1e-15)


def test_no_cable_pushes(record):
    states = pushed(np.array([[0.0, 0.0, 4.0]]), 1.0)
    states["memory"][:, 2] = 1.0
    assert not effect_wrench("slung_load", LOAD, states, record).any()


def test_a_vehicle_carries_it_and_feels_it_swing():
    vehicle = SimulatedVehicle.load("bebop2")
    steps = round(6.0 * STEP_HZ) + 1
    time = np.arange(steps) / STEP_HZ
    path = [np.zeros((steps, 3)) for _ in range(3)]
    path[0][:, 2] = -3.0
    for order, column in enumerate(path):
        column[:, 1] = 0.6 * 2.0**order * np.sin(2.0 * time + order * np.pi / 2)
    reference = Reference(*path, *np.zeros((2, steps)), np.zeros((steps, 2)), np.zeros(steps))
    effects = read_effects({"slung_load": {"mass_kg": 0.06}}, "test")
    loaded, bare = (simulate_flight("load", vehicle, reference, effects=acting) for acting in (effects, {}))
    lifted = np.mean(np.sum(loaded.rotor_speeds[1000:] ** 2, axis=1)) / np.mean(
        np.sum(bare.rotor_speeds[1000:] ** 2, axis=1)
    )
    assert lifted == pytest.approx(1.0 + 0.06 / vehicle.vehicle.mass_kg, rel=0.03)
    assert np.abs(loaded.position - bare.position)[:, 1].max() > 0.02


def test_a_flight_integrates_one_state_of_an_effect():
    np.testing.assert_array_equal(
        memory_at_rest(read_effects({"slung_load": None}, "test")), [0, 0, 1, 0, 0, 0]
    )
    assert not memory_at_rest(read_effects({"payload": None}, "test")).any()


def test_shortest_cable_is_that_of_the_bounds():
    with pytest.raises(SimulationError, match=r"`length_m` must be between 0\.05 and 20 m, found 0\.04"):
        read_effects({"slung_load": {"length_m": 0.04}}, "file")
