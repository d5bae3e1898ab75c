# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the wrench: what holds for every one of the registry, then sizes and signs of each."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects

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
        "thrust_coefficient",
        "rotor_tilt",
        "weak_rotor",
    ],
)
def test_rotors_at_rest_do_nothing(name, degenerate_states, record):
    at_rest = degenerate_states[np.all(degenerate_states["rotor_speeds"] == 0.0, axis=1)]
    assert len(at_rest) > 0
    assert np.all(effect_wrench(name, typical(name), at_rest, record) == 0.0)


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


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.6, -0.8, 0)])
def test_flapping_raises_the_side_that_flies_ahead(hover, record, direction):
    wrench = effect_wrench("blade_flapping", typical("blade_flapping"), hover(velocity=direction), record)
    np.testing.assert_allclose(wrench[0, 3:], 0.0129 * np.cross([0, 0, 1], direction), atol=1e-9)


def test_precession_follows_the_angular_momentum_of_the_rotors(states, record, model):
    inertia = typical("gyroscopic")["rotor_inertia_kg_m2"]
    momentum = inertia * (states["rotor_speeds"] * model.vehicle.rotor_spins).sum(axis=1)
    along_z = momentum[:, None] * np.array([0.0, 0.0, 1.0])
    moment = effect_wrench("gyroscopic", typical("gyroscopic"), states, record)[:, 3:]
    np.testing.assert_allclose(moment, -np.cross(states["rates"], along_z), atol=1e-15)


def test_ground_effect_grows_down_to_half_a_radius_and_is_gone_far_away(hover, record):
    def lift(height):
        return -effect_wrench("ground_effect", typical("ground_effect"), hover(height=height), record)[0, 2]

    heights = np.array([-1.0, 0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 2.0, 50.0])
    lifts = np.array([lift(height) for height in heights])
    assert lifts[0] == lifts[1] > 0.0
    assert np.all(np.diff(lifts[2:]) < 0.0)
    assert lifts[-1] < 1e-6
    assert lift(2.0 * 0.075 - 0.03) == pytest.approx(0.016 * 3.67, rel=0.03)
    still = hover(height=0.1)
    fast = hover(height=0.1, velocity=(10.0, 0.0, 0.0))
    gains = [
        effect_wrench("ground_effect", typical("ground_effect"), state, record)[0, 2] / state["thrusts"].sum()
        for state in (still, fast)
    ]
    assert 0.0 < gains[1] / gains[0] < 0.5


def test_ground_lifts_the_lower_side(hover, record):
    rolled_right = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    wrench = effect_wrench(
        "ground_effect", typical("ground_effect"), hover(height=0.1, attitude=rolled_right), record
    )
    assert wrench[0, 3] < 0.0


def test_vortex_ring_only_in_descent_and_worst_at_the_induced_velocity(hover, record, model):
    induced = model.vehicle.hover_induced_velocity

    def loss(sink, forward=0.0):
        state = hover(velocity=(forward, 0.0, sink))
        return (
            effect_wrench("vortex_ring", typical("vortex_ring"), state, record)[0, 2] / state["thrusts"].sum()
        )

    assert loss(-induced) == loss(0.0) == 0.0
    assert loss(induced) == pytest.approx(0.13)
    assert loss(0.5 * induced) < loss(induced) > loss(1.5 * induced) > 0.0
    assert loss(induced, forward=10.0) < 0.1 * loss(induced)


@pytest.mark.parametrize(
    ("direction", "axis", "sign"),
    [((10, 0, 0), 4, 1), ((-10, 0, 0), 4, -1), ((0, 10, 0), 3, -1), ((0, -10, 0), 3, 1)],
)
def test_rotors_behind_lose_thrust(hover, record, direction, axis, sign):
    wrench = effect_wrench(
        "rotor_interaction", typical("rotor_interaction"), hover(velocity=direction), record
    )[0]
    assert wrench[2] > 0.0
    assert np.sign(wrench[axis]) == sign
    assert abs(wrench[7 - axis]) < 0.1 * abs(wrench[axis])


def test_one_weak_rotor_moves_all_axes_it_should(hover, record, model):
    state = hover()
    for rotor, (x, y, _) in enumerate(model.vehicle.rotor_positions):
        wrench = effect_wrench("weak_rotor", typical("weak_rotor", rotor=rotor + 1), state, record)[0]
        lost = 0.1 * state["thrusts"][0, rotor]
        np.testing.assert_allclose(wrench[[2, 3, 4]], [lost, y * lost, -x * lost])
        assert wrench[5] == pytest.approx(-0.1 * state["torques"][0, rotor])


def test_tether_pulls_to_its_anchor_and_never_pushes(hover, record):
    slack = effect_wrench("tether", typical("tether"), hover(height=1.9), record)
    assert np.all(slack == 0.0)
    # Nose east, anchor north and up: to the left and up.
    east = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    anchored = typical("tether", north_m=4.0, height_m=6.0)
    pull = effect_wrench("tether", anchored, hover(height=3.0, attitude=east), record)[0, :3]
    np.testing.assert_allclose(pull, 0.6 * (5.0 - 2.0) * np.array([0.0, -0.8, -0.6]), atol=1e-12)


def test_offset_centre_feels_every_force(states, record):
    offset = typical("cg_offset", x_m=0.003, y_m=-0.004, z_m=0.01)
    moment = effect_wrench("cg_offset", offset, states, record)[:, 3:]
    np.testing.assert_allclose(moment, -np.cross(list(offset.values()), states["wrench"][:, :3]), atol=1e-15)


def test_a_shaped_law_adds_its_shares_more(hover, record):
    """In each axis by its own share, and in all by slopes; never turned around, never beyond three times."""
    state = hover(velocity=[4.0, -3.0, 0.0], height=3.0)
    bare = effect_wrench("rotor_drag", typical("rotor_drag"), state, record)

    def shaped(**shape):
        return effect_wrench("rotor_drag", typical("rotor_drag") | shape, state, record)

    induced = record["hover_induced_velocity"][0]
    np.testing.assert_allclose(shaped(shape_fx=0.5), bare * [1.5, 1.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(shaped(shape_speed=0.1), bare * (1.0 + 0.1 * 5.0 / induced))
    np.testing.assert_allclose(shaped(shape_v=0.1), bare * (1.0 - 0.1 * 3.0 / induced))
    np.testing.assert_allclose(shaped(shape_ground=0.1), bare * (1.0 + 0.1 * record["rotor_radius"][0] / 3.0))
    np.testing.assert_allclose(shaped(shape_load=-4.0), 0.0 * bare)
    np.testing.assert_allclose(shaped(shape_fx=4.0)[:, 0], 3.0 * bare[:, 0])


def test_only_laws_that_may_be_off_are_shaped():
    assert read_effects({"rotor_drag": {"shape_u": 0.2}}, "test")["rotor_drag"]["shape_u"] == 0.2
    with pytest.raises(SimulationError, match="effect `payload`: unknown parameter `shape_u`"):
        read_effects({"payload": {"shape_u": 0.2}}, "test")
    with pytest.raises(SimulationError, match="`shape_u` must be between -100 and 100, found 900"):
        read_effects({"rotor_drag": {"shape_u": 900.0}}, "test")
