# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects on the body as a whole: forces and moments, air, surfaces nearby."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.simulation.applied_effects import EFFECTS, added_wind, read_effects


def test_drag_is_along_the_airspeed_with_its_square_and_cube(states, added):
    velocity = states["velocity_air"]
    airspeed = np.linalg.norm(velocity, axis=1, keepdims=True)
    alike = added("body_drag", states, x_n_s2_m2=0.002, y_n_s2_m2=0.002, z_n_s2_m2=0.002)
    np.testing.assert_allclose(alike[:, :3], -0.002 * airspeed * velocity, rtol=1e-12)
    steeper = added("cubic_drag", states, drag_n_s3_m3=1e-4)
    np.testing.assert_allclose(steeper[:, :2], -1e-4 * airspeed**2 * velocity[:, :2], rtol=1e-12)
    for wrench in (alike, steeper):
        assert not wrench[:, 3:].any()


def test_each_axis_of_drag_and_damping_has_its_coefficient(states, added):
    drag = {"x_n_s2_m2": 0.001, "y_n_s2_m2": 0.002, "z_n_s2_m2": 0.003}
    force = added("body_drag", states, **drag)[:, :3]
    alike = added("body_drag", states, **dict.fromkeys(drag, 0.001))[:, :3]
    np.testing.assert_allclose(force, alike * [1.0, 2.0, 3.0], rtol=1e-12)
    moment = added("rate_damping", states, x_nm_s=1e-3, y_nm_s=2e-3, z_nm_s=3e-3)[:, 3:]
    np.testing.assert_allclose(moment, -1e-3 * states["rates"] * [1.0, 2.0, 3.0], rtol=1e-12)


def test_biases_are_the_same_in_every_state(states, added):
    force = added("force_bias", states, x_n=0.1, y_n=-0.2, z_n=0.3)
    np.testing.assert_array_equal(force, np.tile([0.1, -0.2, 0.3, 0.0, 0.0, 0.0], (len(states), 1)))
    moment = added("moment_bias", states, x_nm=0.01, y_nm=-0.02, z_nm=0.03)
    np.testing.assert_array_equal(moment, np.tile([0.0, 0.0, 0.0, 0.01, -0.02, 0.03], (len(states), 1)))


def test_tether_pulls_to_its_anchor_and_never_pushes(hover, added):
    slack = added("tether", hover(height=1.9))
    assert np.all(slack == 0.0)
    # Nose east, anchor north and up: to the left and up.
    east = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    pull = added("tether", hover(height=3.0, attitude=east), north_m=4.0, height_m=6.0)
    force = 0.6 * (5.0 - 2.0) * np.array([0.0, -0.8, -0.6])
    np.testing.assert_allclose(pull[0, :3], force, atol=1e-12)
    # At the hook, a centimetre below the centre.
    np.testing.assert_allclose(pull[0, 3:], np.cross([0.0, 0.0, 0.01], force), atol=1e-12)


def test_offset_centre_feels_every_force(states, added):
    offset = {"x_m": 0.003, "y_m": -0.004, "z_m": 0.01}
    moment = added("cg_offset", states, **offset)[:, 3:]
    np.testing.assert_allclose(moment, -np.cross(list(offset.values()), states["wrench"][:, :3]), atol=1e-15)


# Wind that nothing measures: repeatable, and with the statistics that it promises.


EACH = pytest.mark.parametrize(
    "effect", [e for e in EFFECTS.values() if e.kind == "wind"], ids=lambda e: e.name
)
TIME = np.arange(0.0, 5.0, 0.002)


def wind(effects, time=TIME, seed=0):
    return added_wind(read_effects(effects, "test"), time, np.random.default_rng(seed))


@EACH
def test_typical_size_blows_and_zero_does_not(effect):
    blowing = wind({effect.name: None})
    assert blowing.shape == (len(TIME), 3)
    assert np.all(np.isfinite(blowing))
    assert np.any(blowing != 0.0)
    zero = {p.name: 0.0 if p.lowest <= 0.0 else p.default for p in effect.parameters}
    assert np.all(wind({effect.name: zero}) == 0.0)


@EACH
def test_the_seed_decides(effect):
    assert np.array_equal(wind({effect.name: None}), wind({effect.name: None}))


def test_another_seed_is_another_gust():
    assert np.abs(wind({"gust": None}) - wind({"gust": None}, seed=1)).max() > 0.5


def test_steady_wind_has_its_direction_and_adds_to_gusts():
    steady = {"north_m_s": 3.0, "east_m_s": -1.0, "down_m_s": 0.5}
    assert np.all(wind({"wind": steady}) == [3.0, -1.0, 0.5])
    both = wind({"wind": steady, "gust": None})
    np.testing.assert_allclose(both - wind({"gust": None}), np.tile([3.0, -1.0, 0.5], (len(TIME), 1)))


def test_gust_has_its_intensity_and_time_on_any_grid():
    rng = np.random.default_rng(1)
    gust = {"intensity_m_s": 2.0, "time_s": 0.5}
    # 20 000 s: 20 000 independent stretches for each axis.
    even = np.arange(0.0, 20_000.0, 0.1)
    uneven = np.sort(rng.uniform(0.0, 20_000.0, len(even)))
    for time in (even, uneven):
        values = wind({"gust": gust}, time)
        np.testing.assert_allclose(values.std(axis=0), 2.0, rtol=0.04)
        np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=0.06)
        correlation = np.corrcoef(values, rowvar=False)
        np.testing.assert_allclose(correlation, np.eye(3), atol=0.04)
    values = wind({"gust": gust}, even)
    for lag in (1, 5, 15):
        kept = (values[lag:] * values[:-lag]).mean(axis=0) / 4.0
        np.testing.assert_allclose(kept, np.exp(-0.1 * lag / 0.5), atol=0.04)


def test_gust_is_stationary_from_its_first_sample():
    first = np.array([wind({"gust": None}, TIME[:1], seed)[0] for seed in range(2000)])
    np.testing.assert_allclose(first.std(axis=0), 1.2, rtol=0.06)


# Surfaces near the rotors, each rotor at its own height.


TILTED = Rotation.from_euler("ZYX", [70.0, -12.0, 25.0], degrees=True)


@pytest.fixture(scope="module")
def tilted(hover):
    """tilted(height) → one state at rest that leans to the right and forward."""
    return lambda height: hover(height=height, attitude=np.roll(TILTED.as_quat(), 1))


def hub_heights(model, height):
    return height - TILTED.apply(model.vehicle.rotor_positions)[:, 2]


def moments(model, gains):
    """Of more thrust (4,) along -z of each hub."""
    forces = np.outer(gains, [0.0, 0.0, -1.0])
    return np.cross(model.vehicle.rotor_positions, forces).sum(axis=0)


def test_hovering_rotors_gain_what_cheeseman_and_bennett_say(model, tilted, added):
    state = tilted(0.3)
    ratio = model.vehicle.rotor_radius_m / (4.0 * hub_heights(model, 0.3))
    gains = state["thrusts"][0] * (1.0 / (1.0 - ratio**2) - 1.0)
    # Rotors at rest in the air: no speed in the plane.
    wrench = added("ground_effect", state)[0]
    np.testing.assert_allclose(wrench[2:5], [-gains.sum(), *moments(model, gains)[:2]], rtol=1e-9)


def test_rotors_below_a_ceiling_gain_with_the_square_of_their_distance(model, tilted, added):
    state = tilted(3.7)
    distance = 4.0 - hub_heights(model, 3.7)
    gains = state["thrusts"][0] * 0.2 * (model.vehicle.rotor_radius_m / distance) ** 2
    wrench = added("ceiling_effect", state)[0]
    np.testing.assert_allclose(wrench[2:5], [-gains.sum(), *moments(model, gains)[:2]], rtol=1e-9)


def test_ceiling_effect_grows_up_to_half_a_radius(model, hover, added):
    hubs = 0.03 + 0.5 * model.vehicle.rotor_radius_m
    nearest, nearer, beyond = (
        added("ceiling_effect", hover(height=4.0 - hubs + further))[0, 2] for further in (0.0, 0.02, 1.0)
    )
    assert nearest == pytest.approx(nearer) == pytest.approx(beyond)
    assert abs(added("ceiling_effect", hover(height=4.0 - hubs - 0.02))[0, 2]) < 0.7 * abs(nearest)


def test_ground_effect_grows_down_to_half_a_radius_and_is_gone_far_away(hover, added):
    def lift(height):
        return -added("ground_effect", hover(height=height))[0, 2]

    heights = np.array([-1.0, 0.0, 0.01, 0.05, 0.1, 0.2, 0.5, 2.0, 50.0])
    lifts = np.array([lift(height) for height in heights])
    assert lifts[0] == lifts[1] > 0.0
    assert np.all(np.diff(lifts[2:]) < 0.0)
    assert lifts[-1] < 1e-6
    assert lift(2.0 * 0.075 - 0.03) == pytest.approx(0.016 * 3.67, rel=0.03)


def test_ground_effect_fades_with_speed(hover, added, model):
    """At twice the induced velocity in the plane, the source's square of R/4h counts a fifth."""
    speed = 2.0 * model.vehicle.hover_induced_velocity
    state = hover(height=0.1, velocity=(speed, 0.0, 0.0))
    gain = -added("ground_effect", state)[0, 2] / state["thrusts"].sum()
    ratio = model.vehicle.rotor_radius_m / (4.0 * 0.13)
    assert gain == pytest.approx(1.0 / (1.0 - 0.2 * ratio**2) - 1.0)


def test_ground_lifts_the_lower_side(hover, added):
    rolled_right = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    assert added("ground_effect", hover(height=0.1, attitude=rolled_right))[0, 3] < 0.0
