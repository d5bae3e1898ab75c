# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The hidden formulas: their physics, and that they owe the library nothing."""

from __future__ import annotations

import ast
from pathlib import Path

import blind
import numpy as np
import pytest
from blind.effects import EFFECTS, OUTSIDE, altered
from blind.formulas import Formulas
from blind.geometry import induced_ratio
from blind.specimen import CENTRE_M, Specimen, ordinary

from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.state_records import block_of

NAMES = {
    *("rotor_drag", "body_drag", "translational_lift", "inflow_damping", "blade_flapping", "ground_effect"),
    *("rotor_interaction", "vortex_ring", "rate_damping", "gyroscopic", "spin_up", "thrust_coefficient"),
    *("payload", "cg_offset", "inertia", "rotor_tilt", "weak_rotor", "wind", "force_bias", "moment_bias"),
    *("imu_misalignment", "sensor_delay", "rotor_speed_scale", "tether"),
}


@pytest.fixture(scope="module")
def model() -> RotorLocalModel:
    return RotorLocalModel.load("bebop2")


@pytest.fixture
def wrench(model):
    """wrench(name, parameters, velocity, …) → (N, 6) of one formula, its memory new for each row."""

    def of(name, parameters, velocity=((0.0, 0.0, 0.0),), *, rates=None, height=5.0, accelerations=None):
        velocity = np.array(velocity, dtype=float)
        count = len(velocity)
        hover = np.full((count, 4), model.hover_rotor_speed)
        states = model.states(
            velocity,
            np.zeros((count, 3)) if rates is None else np.array(rates, dtype=float),
            hover * np.array([1.0, 1.1, 0.95, 1.05]),
            rotor_accelerations=None if accelerations is None else np.array(accelerations, dtype=float),
            position=np.tile([0.0, 0.0, -height], (count, 1)),
        )
        record = model.record()
        return np.array(
            [Formulas({name: parameters})(*block_of(states[i : i + 1], record), ()) for i in range(count)]
        )

    return of


def test_every_effect_of_the_vocabulary_is_hidden():
    assert set(EFFECTS) == NAMES
    assert not set(OUTSIDE) & set(EFFECTS)


def test_nothing_comes_from_the_library():
    for path in Path(blind.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = []
            if isinstance(node, ast.Import):
                modules = [name.name for name in node.names]
            if isinstance(node, ast.ImportFrom):
                modules = [f"{node.module}.{name.name}" for name in node.names]
            for module in modules:
                assert not module.startswith("quadpi_core.simulation.effect"), path
                # Whose simulations are compared is no secret; what is searched for is.
                for secret in ("candidates", "effect_response", "search", "evidence"):
                    assert not module.startswith(f"quadpi_core.discrepancy.{secret}"), path


def test_induced_velocity_fulfils_momentum_theory():
    advance = np.linspace(0.0, 4.0, 9)
    ratio = np.array([induced_ratio(v) for v in advance])
    np.testing.assert_allclose(ratio * np.hypot(advance, ratio), 1.0)


@pytest.mark.parametrize("name", ["rotor_drag", "body_drag"])
def test_drag_brakes(wrench, name):
    velocity = np.random.default_rng(1).normal(0.0, 5.0, (50, 3))
    drag = wrench(name, {"rotor_drag": (0.1,), "body_drag": (0.002, 0.002, 0.002, 1.8)}[name], velocity)
    assert np.all(np.sum(drag[:, :3] * velocity, axis=1) < 0.0)


def test_body_drag_grows_with_its_exponent(wrench):
    drag = wrench("body_drag", (0.002, 0.002, 0.002, 1.8), [[3.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    assert drag[1, 0] / drag[0, 0] == pytest.approx(2.0**1.8)


def test_rate_damping_brakes_and_gyroscopic_moment_does_no_work(wrench):
    rates = np.random.default_rng(2).normal(0.0, 4.0, (50, 3))
    still = np.zeros((50, 3))
    damped = wrench("rate_damping", (2e-3, 2e-3, 2e-3), still, rates=rates)
    assert np.all(np.sum(damped[:, 3:] * rates, axis=1) < 0.0)
    turned = wrench("gyroscopic", (8e-6,), still, rates=rates)
    assert np.abs(turned[:, 3:]).max() > 1e-4
    np.testing.assert_allclose(np.sum(turned[:, 3:] * rates, axis=1), 0.0, atol=1e-12)


def test_spin_up_pushes_back(wrench, model):
    one = [[100.0, 0.0, 0.0, 0.0]]
    moment = wrench("spin_up", (8e-6,), accelerations=one)[0, 5]
    assert moment == pytest.approx(-8e-4 * model.vehicle.rotor_spins[0])


def test_thrust_near_the_ground(wrench):
    lift = [-wrench("ground_effect", (1.0,), height=height)[0, 2] for height in (0.15, 0.3, 0.6, 3.0)]
    weight = 3.67
    assert 0.07 < lift[0] / weight < 0.12
    assert lift[0] > 2.0 * lift[1] > 4.0 * lift[2] > 0.0
    assert lift[3] < 1e-3 * weight


def test_vortex_ring_is_of_descent_alone(wrench):
    climb, slow, fast, out = wrench(
        "vortex_ring", (0.13,), [[0, 0, -4.0], [0, 0, 5.0], [0, 0, 9.0], [9.0, 0, 5.0]]
    )[:, 2]
    assert climb == 0.0
    assert slow > 5.0 * abs(fast)
    assert slow > 5.0 * out > 0.0


def test_climb_costs_thrust_and_descent_gives_it(wrench):
    climb, hover, descent = -wrench("inflow_damping", (0.33,), [[0, 0, -1.0], [0, 0, 0.0], [0, 0, 1.0]])[:, 2]
    assert climb < 0.0 == hover < descent
    assert climb == pytest.approx(-0.33, rel=0.15)


def test_lift_and_interaction_come_with_speed(wrench):
    hover, slow, fast = -wrench("translational_lift", (0.105, 0.2), [[0, 0, 0], [4.0, 0, 0], [8.0, 0, 0]])[
        :, 2
    ]
    assert 0.0 == hover < slow < fast
    assert fast == pytest.approx(0.37, rel=0.15)
    hover, forward = wrench("rotor_interaction", (0.09,), [[0, 0, 0], [8.0, 0, 0]])
    assert np.all(hover == 0.0)
    # The rear rotors lose: less thrust, and the nose comes up.
    assert forward[2] > 0.0
    assert forward[4] > 0.0


def test_flapping_lifts_the_nose_in_forward_flight(wrench):
    forward = wrench("blade_flapping", (0.0129, 0.1, 0.02, 0.1), [[5.0, 0.0, 0.0]])[0]
    assert forward[4] == pytest.approx(5.0 * 0.0129, rel=0.25)
    assert forward[0] < 0.0


def test_tether_pulls_towards_its_anchor_and_only_when_taut(wrench):
    assert np.all(wrench("tether", (0.1, 2.0, 0.02, 0.0, 0.0, 0.01), height=1.9) == 0.0)
    taut = wrench("tether", (0.1, 2.0, 0.02, 0.0, 0.0, 0.01), height=5.0)[0]
    assert taut[2] == pytest.approx(0.1 * (4.99 - 2.0))
    sinking = wrench("tether", (0.1, 2.0, 0.5, 0.0, 0.0, 0.01), [[0.0, 0.0, 3.0]], height=5.0)
    assert np.all(sinking[0, :3] == 0.0)


def test_tilted_rotor_keeps_its_thrust(wrench, model):
    tilt = np.radians(2.0)
    turned = wrench("rotor_tilt", (2, 0.7, tilt))[0]
    thrust = model.states(np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 4), 0.95 * model.hover_rotor_speed))
    whole = thrust["thrusts"][0, 2]
    assert np.hypot(*turned[:2]) == pytest.approx(whole * np.sin(tilt))
    assert turned[2] == pytest.approx(whole * (1.0 - np.cos(tilt)))


def test_wind_is_as_flying_the_other_way(model):
    states = model.states(
        np.array([[0.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]), np.zeros((2, 3)), np.full((2, 4), 700.0),
        position=np.tile([0.0, 0.0, -3.0], (2, 1)),
    )  # fmt: skip
    Formulas({"wind": (2.0, 0.0, 0.0, 0.1)})(*block_of(states[:1], model.record()), ())
    np.testing.assert_allclose(states["wrench"][0], states["wrench"][1])


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("rotor_drag", (0.1,)),
        ("blade_flapping", (0.01, 0.1, 0.02, 0.1)),
        ("translational_lift", (0.1, 0.2)),
        ("vortex_ring", (0.1,)),
        ("rotor_interaction", (0.1,)),
    ],
)
def test_what_comes_with_speed_is_nothing_at_rest(wrench, name, parameters):
    assert np.all(wrench(name, parameters) == 0.0)


def test_memory_begins_anew_with_each_flight(model):
    still, hover = np.zeros((1, 3)), np.full((1, 4), model.hover_rotor_speed)
    block = block_of(model.states(still, still, hover), model.record())
    first, second = Formulas({"thrust_fade": (0.1,)}), Formulas({"thrust_fade": (0.1,)})
    begun = first(*block, ())
    assert first(*block, ()) != begun
    assert second(*block, ()) == begun


def test_specimens_differ_as_their_tolerances_say():
    nominal = SimulatedVehicle.load("bebop2")
    made = [ordinary(nominal, np.random.default_rng(seed)) for seed in range(400)]
    thrust = np.array([s.coefficients.thrust[0] for s in made]) / nominal.aerodynamics.coefficients.thrust[0]
    assert np.std(thrust) == pytest.approx(0.01, rel=0.2)
    assert np.std([s.centre for s in made]) == pytest.approx(CENTRE_M, rel=0.1)
    moments = np.array([np.diag(s.vehicle.inertia) for s in made]) / np.diag(nominal.vehicle.inertia)
    assert np.std(moments, axis=0) == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
def test_size_scales_every_effect_down_to_nothing(name):
    bare = Specimen(SimulatedVehicle.load("bebop2"))
    full, half = (altered(bare, name, size, np.random.default_rng(3)) for size in (1.0, 0.5))

    def numbers(specimen):
        formula = [value for values in specimen.formulas.values() for value in values]
        vehicle = [specimen.vehicle.mass_kg, *specimen.vehicle.inertia.ravel(), *specimen.centre]
        return np.array([*formula, *vehicle, specimen.vehicle.air_density_kg_m3])

    if full.sensors:
        assert len(full.sensors) == 1
    else:
        assert not np.allclose(numbers(full), numbers(half))
        assert numbers(full).shape == numbers(half).shape
