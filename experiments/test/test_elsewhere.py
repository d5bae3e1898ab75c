# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""RotorPy's flights in quadpi's axes, where RotorPy is installed."""

from __future__ import annotations

import numpy as np
import pytest
from blind import elsewhere

from quadpi_core.simulation.scenario import FlightPlan

pytest.importorskip("rotorpy")
BACK_AND_FORTH = {
    "x": [{"sine": {"amplitude_m": 0.4, "frequency_hz": 0.4, "start_s": 0.0, "fade_s": 1.0}}],
    "y": [{"sine": {"amplitude_m": 0.25, "frequency_hz": 0.5, "start_s": 0.0, "fade_s": 1.0}}],
    "yaw": [{"sine": {"amplitude_deg": 15, "frequency_hz": 0.5, "start_s": 0.0, "fade_s": 1.0}}],
}


@pytest.fixture(scope="module")
def flown():
    """flown(effect, …) → the truth of 2 s, parameters otherwise exact and every effect off."""
    from rotorpy.vehicles.hummingbird_params import quad_params

    hover = FlightPlan(name="waves", scenario="test", vehicle="bebop2", seed=0, duration_s=2.0)
    plan = hover.overridden(motion=BACK_AND_FORTH)

    def of(*effects):
        parameters = {**quad_params, **dict.fromkeys(elsewhere.OFF, 0.0)}
        for name in effects:
            parameters |= elsewhere.EFFECTS[name]
        return elsewhere.flown(plan, parameters)

    return of


def test_without_effects_the_simulation_is_exact(flown):
    truth = flown()
    assert np.abs(truth.velocity[:, :2]).max() > 0.5
    assert np.abs(truth.rates).max(axis=0).min() > 0.1
    np.testing.assert_allclose(elsewhere.thrust_and_torque(truth.flight()), truth.wrench, atol=1e-9)


def test_effects_show_where_physics_has_them(flown):
    def added(name):
        truth = flown(name)
        return truth.velocity, truth.wrench - elsewhere.thrust_and_torque(truth.flight())

    for name in ("rotor_drag", "body_drag"):
        velocity, wrench = added(name)
        assert np.sum(velocity * wrench[:, :3]) < 0.0
    _, wrench = added("translational_lift")
    assert wrench[:, 2].min() < 0.0
    velocity, wrench = added("inflow_damping")
    assert np.sum(velocity[:, 2] * wrench[:, 2]) < 0.0
    velocity, wrench = added("blade_flapping")
    # Nose up in forward flight, right side up in flight to the right.
    assert np.sum(velocity[:, 0] * wrench[:, 4]) > 0.0
    assert np.sum(velocity[:, 1] * wrench[:, 3]) < 0.0
