# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the vehicle: it stays one that can exist."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.simulation.applied_effects import EFFECTS, altered_vehicle, read_effects
from quadpi_core.vehicle import Vehicle, is_rigid_body

EACH = pytest.mark.parametrize(
    "effect", [e for e in EFFECTS.values() if e.kind == "vehicle"], ids=lambda effect: effect.name
)
VEHICLES = pytest.mark.parametrize("name", ["bebop2", "hdbeetle", "neurobem"])


def altered(vehicle, effects):
    return altered_vehicle(read_effects(effects, "test"), vehicle)


@EACH
@VEHICLES
def test_typical_size_leaves_a_rigid_body(effect, name):
    vehicle = Vehicle.load(name)
    other = altered(vehicle, {effect.name: None})
    assert other.mass_kg > 0.0
    assert is_rigid_body(other.inertia)
    assert other.fingerprint != vehicle.fingerprint == Vehicle.load(name).fingerprint


@EACH
def test_zero_strength_changes_nothing(effect):
    vehicle = Vehicle.load("bebop2")
    zero = {p.name: 0.0 if p.lowest <= 0.0 else p.default for p in effect.parameters}
    assert altered(vehicle, {effect.name: zero}).fingerprint == vehicle.fingerprint


@EACH
@VEHICLES
def test_any_strength_leaves_a_rigid_body_or_is_refused(effect, name):
    vehicle, rng, refused = Vehicle.load(name), np.random.default_rng(1), 0
    for _ in range(200):
        parameters = {p.name: rng.uniform(p.lowest, p.highest) for p in effect.parameters}
        try:
            assert is_rigid_body(altered(vehicle, {effect.name: parameters}).inertia)
        except SimulationError:
            refused += 1
    assert refused < 200


def test_effects_add_up_and_leave_the_rest():
    vehicle = Vehicle.load("bebop2")
    other = altered(vehicle, {"inertia": {"x_change": 0.1}, "payload": {"mass_kg": 0.1}, "gust": None})
    assert other.mass_kg == pytest.approx(vehicle.mass_kg + 0.1)
    np.testing.assert_allclose(np.diag(other.inertia), np.diag(vehicle.inertia) * [1.1, 1.2, 1.2])
    assert np.array_equal(other.rotor_positions, vehicle.rotor_positions)
    assert other.name == vehicle.name


def test_an_impossible_inertia_is_refused():
    with pytest.raises(
        SimulationError, match="vehicle bebop2: effect `inertia`: changes of 0, 0 and 1 leave moments"
    ):
        altered(Vehicle.load("bebop2"), {"inertia": {"x_change": 0.0, "y_change": 0.0, "z_change": 1.0}})


def test_changes_of_inertia_are_lowered_to_what_a_rigid_body_can_have():
    """Only the largest moment, and by little more than it must."""
    vehicle, inertia = Vehicle.load("bebop2"), EFFECTS["inertia"]
    possible = np.array([0.1, 0.0, 0.0])
    np.testing.assert_array_equal(inertia.feasible(vehicle, possible), possible)
    lowered = inertia.feasible(vehicle, np.array([0.0, 0.0, 0.5]))
    assert lowered[:2].tolist() == [0.0, 0.0]
    assert is_rigid_body(inertia.function(vehicle, lowered).inertia)
    assert not is_rigid_body(inertia.function(vehicle, lowered / [1.0, 1.0, 1.0] + [0.0, 0.0, 0.01]).inertia)
