# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several effects in the order of the registry, and effects of one's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.errors import SimulationError
from quadpi_core.simulation.applied_effects import (
    EFFECTS,
    compose,
    effect_wrench,
    read_effects,
    remembered_wrenches,
    with_memory,
)
from quadpi_core.simulation.effect_definition import shaped
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.state_records import STATE, VEHICLE, apply_to_all, block_of, six_columns
from quadpi_core.simulation.truth import STEP_HZ, Reference

from .references import sines

SWING = sines([2.0, 1.5, 0.6], [0.3, 0.23, 0.35], seconds=3.0)

WRENCH = [name for name, effect in EFFECTS.items() if effect.kind == "wrench"]


def composed(states, record, names, extra=()):
    return applied(states, record, read_effects(dict.fromkeys(names), "test"), extra)


def applied(states, record, effects, extra=()):
    """Wrench as an integrator's steps compute it: effect after effect, instant by instant."""
    states = states.copy()
    for i in range(len(states)):
        one = states[i : i + 1]
        for law, values, shape in compose(effects, extra):
            if isinstance(law, str):
                wrench = np.empty((1, 6))
                compiled.effect_wrenches(law, one, record, values, shape, wrench)
            else:
                block = block_of(one, record)
                wrench = six_columns(shaped(law(*block, values), *block, shape), 1)
            one["wrench"] += wrench
    return states["wrench"]


def one_after_the_other(states, record, names):
    states = states.copy()
    for name, parameters in read_effects(dict.fromkeys(names), "test").items():
        states["wrench"] += effect_wrench(name, parameters, states, record)
    return states["wrench"]


@pytest.mark.parametrize("name", WRENCH)
def test_one_effect_is_that_effect(name, states, record):
    expected = one_after_the_other(states, record, [name])
    assert np.array_equal(composed(states, record, [name]), expected)


def test_shaped_laws_beside_others(states, record):
    laws = {"rotor_drag": {"shape_u": 0.3, "shape_fy": -0.5}, "body_drag": None, "vortex_ring": None}
    effects, expected = read_effects(laws, "test"), states.copy()
    for name, values in effects.items():
        expected["wrench"] += effect_wrench(name, values, expected, record)
    np.testing.assert_array_equal(applied(states, record, effects), expected["wrench"])
    assert np.any(expected["wrench"] != composed(states, record, list(laws)))


def test_all_effects_add_up_in_order(states, record):
    expected = one_after_the_other(states, record, WRENCH)
    assert np.array_equal(composed(states, record, WRENCH), expected)
    assert np.array_equal(composed(states, record, WRENCH[::-1]), expected)


def test_the_centre_of_gravity_comes_last(states, record):
    assert WRENCH[-1] == "cg_offset"
    together = composed(states, record, ["force_bias", "cg_offset"])
    apart = (
        composed(states, record, ["force_bias"]) + composed(states, record, ["cg_offset"]) - states["wrench"]
    )
    assert np.abs(together - apart)[:, 3:].max() > 1e-4


def test_without_effects_nothing_changes(states, record):
    assert np.array_equal(composed(states, record, []), states["wrench"])
    # Other kinds are no business of the wrench.
    assert np.array_equal(composed(states, record, ["payload", "gust", "gyro_bias"]), states["wrench"])


def test_functions_of_ones_own_act_first_with_their_own_parameters(states, record):
    def push(state, vehicle, p):  # noqa: ARG001
        return p[0] * vehicle.mass, p[1], p[2], 0.0, 0.0, 0.0

    def follow(state, vehicle, p):  # noqa: ARG001
        return p[0] * state.wrench[:, 0], 0.0, 0.0, 0.0, 0.0, 0.0

    extra = ((push, (0.5, 1.5, -2.5)), (follow, (0.5,)))
    expected = states.copy()
    expected["wrench"][:, :3] += [0.5 * record["mass"][0], 1.5, -2.5]
    expected["wrench"][:, 0] *= 1.5
    assert np.array_equal(composed(states, record, [], extra), expected["wrench"])
    # A displaced centre feels their force too.
    assert np.array_equal(
        composed(states, record, ["cg_offset"], extra), one_after_the_other(expected, record, ["cg_offset"])
    )


def test_the_core_has_the_wrench_effects_of_the_library():
    assert sorted(compiled.WRENCH_EFFECTS) == sorted(WRENCH)


@pytest.fixture
def own(monkeypatch):
    """own(name) → name of an effect with the function of another, as a package of one's own declares it."""

    def declare(name):
        effect = replace(EFFECTS[name], name=f"own_{name}")
        monkeypatch.setitem(EFFECTS, effect.name, effect)
        assert effect.law is EFFECTS[name].function
        return effect.name

    return declare


SOME_SHAPE = {"shape_fx": 0.2, "shape_mz": -0.4, "shape_speed": 0.1, "shape_ground": -0.2}


@pytest.mark.parametrize("name", WRENCH)
def test_an_effect_of_ones_own_gives_what_that_of_the_core_gives(name, own, states, record):
    shape = SOME_SHAPE if EFFECTS[name].shape else {}
    values = read_effects({name: dict(shape)}, "test")[name]
    expected = effect_wrench(name, values, states.copy(), record)
    found = effect_wrench(own(name), values, states.copy(), record)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["body_drag", "ground_effect", "rotor_tilt", "slung_load"])
def test_an_effect_of_ones_own_flies_as_that_of_the_core(name, own):
    """Beside others of the core, and with a state of its own that the flight integrates."""
    vehicle = SimulatedVehicle.load("bebop2")
    others = {"rotor_drag": None, "payload": None}
    expected, found = (
        simulate_flight("swing", vehicle, SWING, effects=read_effects({one: None, **others}, "test"))
        for one in (name, own(name))
    )
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(found.wrench, expected.wrench, atol=1e-9)
    without = simulate_flight("swing", vehicle, SWING, effects=read_effects(others, "test"))
    assert np.abs(without.wrench - found.wrench).max() > 1e-4


@pytest.mark.parametrize("given", [(0.0,) * 5, 1.0, ("push",) * 6, (np.zeros(2),) * 6])
def test_an_effect_that_gives_no_wrench_is_refused(given):
    vehicle = SimulatedVehicle.load("bebop2")
    with pytest.raises(ValueError, match="an effect gives six forces and moments"):
        simulate_flight("swing", vehicle, SWING, extra=[(lambda *_: given, ())])


def test_what_fails_in_an_effect_of_ones_own_is_raised():
    def fail(*_):
        raise ZeroDivisionError("no air")

    vehicle = SimulatedVehicle.load("bebop2")
    with pytest.raises(ZeroDivisionError, match="no air"):
        simulate_flight("swing", vehicle, SWING, extra=[(fail, ())])


def test_what_is_no_wrench_effect_is_refused(states, record):
    with pytest.raises(
        SimulationError, match="`rotor_darg` is no effect on the wrench; did you mean `rotor_drag`"
    ):
        effect_wrench("rotor_darg", {}, states, record)
    with pytest.raises(SimulationError, match="no effect on the wrench"):
        effect_wrench("payload", {"mass_kg": 1.0}, states, record)


@pytest.mark.parametrize("length", [0, 1, 2, None])
@pytest.mark.parametrize("name", [name for name in WRENCH if EFFECTS[name].at_rest])
def test_wrenches_from_several_starts_are_those_from_each(states, record, name, length):
    (parameters,), flight = read_effects({name: None}, "test").values(), states[:length]
    before, spread = flight.tobytes(), np.diag(EFFECTS[name].start_spread)
    starts = np.array(EFFECTS[name].at_rest) + 0.1 * spread
    found = remembered_wrenches(name, parameters, flight, record, starts, 0.01)
    assert flight.tobytes() == before
    assert found.shape == (len(flight), 6, len(starts))
    for start, wrench in zip(starts, found.transpose(2, 0, 1), strict=True):
        own = with_memory(name, parameters, flight, record, start, 0.01)
        assert np.array_equal(wrench, effect_wrench(name, parameters, own, record))


@pytest.mark.parametrize("name", [name for name in WRENCH if EFFECTS[name].at_rest])
def test_a_state_of_ones_own_goes_on_as_in_the_core(name, own, states, record):
    (parameters,), starts = read_effects({name: None}, "test").values(), np.array(EFFECTS[name].at_rest)
    starts = starts + 0.1 * np.diag(EFFECTS[name].start_spread)
    expected = remembered_wrenches(name, parameters, states, record, starts, 0.01)
    found = remembered_wrenches(own(name), parameters, states, record, starts, 0.01)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
    memory, other = (
        with_memory(one, parameters, states, record, starts[0], 0.01)["memory"]
        for one in (name, f"own_{name}")
    )
    np.testing.assert_allclose(other, memory, rtol=1e-7, atol=1e-7)


# Laws of the aerodynamics: those of the core by name, and functions of Python.


def test_a_function_takes_all_states_and_its_numbers():
    def push(state, vehicle, numbers):
        state.wrench[:, 0] += numbers[0, 0] * state.rates[:, 0] * vehicle.mass

    states, vehicle = np.zeros(3, STATE), np.zeros(1, VEHICLE)
    states["rates"][:, 0], vehicle["mass"] = [1.0, 2.0, 3.0], 2.0
    apply_to_all(states, vehicle, push, np.array([[0.5]]))
    np.testing.assert_array_equal(states["wrench"][:, 0], [1.0, 2.0, 3.0])


class _OfPython(RotorLocalModel):
    """The rotor-local law as a function of Python."""

    @property
    def function(self):
        def law(state, vehicle, numbers):
            states = np.zeros(len(state.wrench), STATE)
            for name in STATE.names:
                states[name] = getattr(state, name)
            apply_to_all(states, np.array([tuple(vehicle)], VEHICLE), "rotor_local", numbers)
            for name in ("hub_velocity", "thrusts", "torques", "wrench"):
                getattr(state, name)[:] = states[name]

        return law


def test_a_law_of_python_flies_as_one_of_the_core():
    bebop, reference = SimulatedVehicle.load("bebop2"), Reference.hover(np.array([0.0, 0.0, -3.0]), STEP_HZ)
    wind = np.array([2.0, 1.0, 0.0])
    expected = simulate_flight("hop", bebop, reference, known_wind=wind)
    law = _OfPython(bebop.vehicle, bebop.aerodynamics.coefficients)
    own = SimulatedVehicle(law, bebop.motor_time_constant)
    found = simulate_flight("hop", own, reference, known_wind=wind)
    assert np.ptp(found.rotor_speeds, axis=0).min() > 0.1
    for name in ("position", "attitude", "rates", "rotor_speeds", "wrench"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_law_that_does_not_exist_is_refused(states, record):
    with pytest.raises(ValueError, match="no such law of the aerodynamics"):
        apply_to_all(states.copy(), record, "lattice", np.zeros((0, 0)))


@pytest.mark.parametrize("wrench", [(0.0,) * 5, (0.0,) * 7, (np.zeros(3), *(0.0,) * 5), 1.0])
def test_what_are_not_six_columns_is_refused(wrench):
    with pytest.raises(ValueError, match="an effect gives six forces and moments"):
        six_columns(wrench, 2)
