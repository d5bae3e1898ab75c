# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the wrench: what holds for every one of the registry, then sizes and signs of each."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import EFFECTS, effect_wrench, read_effects

WRENCH = [effect for effect in EFFECTS.values() if effect.kind == "wrench"]
EACH = pytest.mark.parametrize("effect", WRENCH, ids=lambda effect: effect.name)
# These name one side of the vehicle.
ONE_SIDED = {"rotor_tilt", "weak_rotor", "force_bias", "moment_bias", "cg_offset"}
MIRROR_WRENCH = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


def typical(name, **changes):
    return dict(read_effects({name: changes}, "test")[name])


def random_parameters(effect, rng):
    return {
        p.name: float(rng.integers(int(p.lowest), int(p.highest) + 1))
        if p.whole
        else rng.uniform(p.lowest, p.highest)
        for p in effect.parameters
    }


def power(wrench, states):
    return np.sum(wrench * np.hstack((states["velocity_air"], states["rates"])), axis=1)


@EACH
def test_typical_size_is_felt_and_finite(effect, states, record):
    wrench = effect_wrench(effect.name, typical(effect.name), states, record)
    assert np.all(np.isfinite(wrench))
    assert np.any(wrench != 0.0)


@EACH
def test_zero_strength_changes_nothing(effect, states, degenerate_states, record):
    zero = {p.name: 0.0 if p.lowest <= 0.0 else p.default for p in effect.parameters}
    for some in (states, degenerate_states):
        assert np.all(effect_wrench(effect.name, zero, some, record) == 0.0)


@EACH
def test_finite_where_formulas_break(effect, degenerate_states, record):
    extremes = [
        {p.name: getattr(p, bound) for p in effect.parameters} for bound in ("default", "lowest", "highest")
    ]
    for parameters in extremes:
        assert np.all(np.isfinite(effect_wrench(effect.name, parameters, degenerate_states, record)))


@EACH
def test_shows_in_its_axes_and_in_no_other(effect, states, record):
    rng = np.random.default_rng(2)
    felt = np.zeros(6, dtype=bool)
    for _ in range(20):
        felt |= np.any(
            effect_wrench(effect.name, random_parameters(effect, rng), states, record) != 0.0, axis=0
        )
    assert tuple(np.array(AXES)[felt]) == effect.axes


@pytest.mark.parametrize("name", [effect.name for effect in WRENCH if effect.name not in ONE_SIDED])
def test_a_mirrored_flight_has_the_mirrored_wrench(name, model, states, record):
    mirrored = mirror(model, states)
    expected = MIRROR_WRENCH * effect_wrench(name, typical(name), states, record)
    wrench = effect_wrench(name, typical(name), mirrored, record)
    np.testing.assert_allclose(wrench, expected, rtol=1e-9, atol=1e-12)


def mirror(model, states):
    """Left and right exchanged: the rotor on the other side turns the other way at the same speed."""
    positions = model.vehicle.rotor_positions
    partner = [int(np.argmin(np.linalg.norm(positions - p * [1, -1, 1], axis=1))) for p in positions]
    assert np.array_equal(model.vehicle.rotor_spins[partner], -model.vehicle.rotor_spins)
    vector, axial = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
    return model.states(
        states["velocity_air"] * vector,
        states["rates"] * axial,
        states["rotor_speeds"][:, partner],
        rotor_accelerations=states["rotor_accelerations"][:, partner],
        position=states["position"] * vector,
        attitude=states["attitude"] * np.array([1.0, -1.0, 1.0, -1.0]),
    )


@pytest.mark.parametrize("name", ["rotor_drag", "body_drag", "cubic_drag", "inflow_damping", "rate_damping"])
def test_drag_and_damping_take_power_out(name, states, record):
    rng = np.random.default_rng(3)
    for _ in range(5):
        positive = {key: abs(value) for key, value in random_parameters(EFFECTS[name], rng).items()}
        taken = power(effect_wrench(name, positive, states, record), states)
        assert np.all(taken < 1e-12)
        assert np.all(taken[: len(taken) // 2] < 0.0)


@pytest.mark.parametrize("name", ["gyroscopic", "cross_flow"])
def test_does_no_work(name, states, record):
    wrench = effect_wrench(name, typical(name), states, record)
    scale = np.linalg.norm(wrench, axis=1).max()
    np.testing.assert_allclose(power(wrench, states), 0.0, atol=1e-12 * scale * 100.0)


@pytest.mark.parametrize(
    "name",
    [
        "rotor_drag",
        "cross_flow",
        "blade_flapping",
        "translational_lift",
        "inflow_damping",
        "rotor_dissymmetry",
        "vortex_ring",
        "rotor_interaction",
        "ground_effect",
        "ceiling_effect",
        "gyroscopic",
        "rotor_tilt",
        "weak_rotor",
    ],
)
def test_rotors_at_rest_do_nothing(name, degenerate_states, record):
    at_rest = degenerate_states[np.all(degenerate_states["rotor_speeds"] == 0.0, axis=1)]
    assert len(at_rest) > 0
    assert np.all(effect_wrench(name, typical(name), at_rest, record) == 0.0)


def test_a_denser_air_drags_the_airframe_of_rotors_at_rest_too(degenerate_states, record):
    at_rest = degenerate_states[np.all(degenerate_states["rotor_speeds"] == 0.0, axis=1)]
    added = effect_wrench("thrust_coefficient", {"change": 0.1}, at_rest, record)
    np.testing.assert_allclose(added, 0.1 * at_rest["aerodynamics"])
    assert np.any(added != 0.0)


SIZES = {
    "rotor_drag": ({"velocity": (1, 0, 0)}, "Fx", -0.11),
    "cross_flow": ({"velocity": (1, 0, 0)}, "Fy", 0.0),
    "body_drag": ({"velocity": (0, 10, 0)}, "Fy", -0.27),
    "cubic_drag": ({"velocity": (10, 0, 0)}, "Fx", -0.075),
    "rate_damping": ({"rates": (0, 0, 1)}, "Mz", -2.3e-3),
    # Nose up in forward flight.
    "blade_flapping": ({"velocity": (1, 0, 0)}, "My", 0.0129),
    "translational_lift": ({"velocity": (14, 0, 0)}, "Fz", -0.31 * 3.67),
    "inflow_damping": ({"velocity": (0, 0, -1)}, "Fz", 0.09 * 3.67),
    # Roll at 10 rad/s in a descent at 3 m/s: the right side goes down faster and lifts more.
    "rotor_dissymmetry": ({"velocity": (0, 0, 3), "rates": (10, 0, 0)}, "Mx", -4e-4),
    "gyroscopic": ({"rates": (1, 0, 0)}, "My", 0.0),
    "spin_up": ({"rotor_accelerations": (-3000, 3000, -3000, 3000)}, "Mz", -0.096),
    "thrust_coefficient": ({}, "Fz", -0.367),
    "weak_rotor": ({}, "Fz", 0.0918),
    # 1.4° of 0.92 N.
    "rotor_tilt": ({}, "Fx", 0.0224),
    "tether": ({"height": 3.0}, "Fz", 0.6),
    # Of 30 g below 374 g that thrust carries.
    "slung_load": ({}, "Fz", 0.03 * 9.8 / (1.0 + 0.03 / 0.374)),
    "force_bias": ({}, "Fx", 0.1),
    "moment_bias": ({}, "Mx", 0.005),
    # Centre of gravity ahead of the thrust: nose down.
    "cg_offset": ({}, "My", -0.0035 * 3.67),
    # Hubs, 0.03 m above the centre, at R from ground and ceiling.
    "ground_effect": ({"height": 0.075 - 0.03}, "Fz", -0.067 * 3.67),
    "ceiling_effect": ({"height": 4.0 - 0.075 - 0.03}, "Fz", -0.2 * 3.67),
}


@pytest.mark.parametrize("name", SIZES)
def test_typical_size_and_sign(name, hover, record):
    arguments, axis, expected = SIZES[name]
    wrench = effect_wrench(name, typical(name), hover(**arguments), record)
    assert wrench[0, AXES.index(axis)] == pytest.approx(expected, rel=0.03, abs=1e-9)
