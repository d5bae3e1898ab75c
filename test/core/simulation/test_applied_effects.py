# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several effects as one compiled function, in the order of the registry."""

from __future__ import annotations

import numpy as np
import pytest
from numba import types

from quadpi_core.compiled import njit
from quadpi_core.errors import SimulationError
from quadpi_core.simulation.applied_effects import (
    compose,
    effect_wrench,
    remembered_wrenches,
    with_memory,
)
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.simulation.state_records import STATE_TYPE, VEHICLE_TYPE
from quadpi_core.simulation.wrench_functions import FUNCTION_TYPE

WRENCH = [name for name, effect in EFFECTS.items() if effect.kind == "wrench"]
_STATES, _VEHICLES = types.Array(STATE_TYPE, 1, "C"), types.Array(VEHICLE_TYPE, 1, "C")


@njit(types.void(FUNCTION_TYPE, types.float64[:, ::1], _STATES, _VEHICLES))
def apply(function, parameters, states, vehicles):
    for i in range(len(states)):
        function(states[i], vehicles[0], parameters)


def composed(states, record, names, extra=()):
    function, parameters = compose(read_effects(dict.fromkeys(names), "test"), extra)
    states = states.copy()
    apply(function, parameters, states, record)
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
    shaped = {"rotor_drag": {"shape_u": 0.3, "shape_fy": -0.5}, "body_drag": None, "vortex_ring": None}
    function, parameters = compose(read_effects(shaped, "test"))
    expected, found = states.copy(), states.copy()
    for name, values in read_effects(shaped, "test").items():
        expected["wrench"] += effect_wrench(name, values, expected, record)
    for state in found:
        function(state, record[0], parameters)
    np.testing.assert_array_equal(found["wrench"], expected["wrench"])
    assert np.any(found["wrench"] != composed(states, record, list(shaped)))


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
    @njit
    def push(state, vehicle, p):  # noqa: ARG001
        return p[0] * vehicle.mass, p[1], p[2], 0.0, 0.0, 0.0

    @njit
    def follow(state, vehicle, p):  # noqa: ARG001
        return p[0] * state.wrench[0], 0.0, 0.0, 0.0, 0.0, 0.0

    extra = ((push, (0.5, 1.5, -2.5)), (follow, (0.5,)))
    expected = states.copy()
    expected["wrench"][:, :3] += [0.5 * record["mass"][0], 1.5, -2.5]
    expected["wrench"][:, 0] *= 1.5
    assert np.array_equal(composed(states, record, [], extra), expected["wrench"])
    # A displaced centre feels their force too.
    assert np.array_equal(
        composed(states, record, ["cg_offset"], extra), one_after_the_other(expected, record, ["cg_offset"])
    )


def test_the_same_function_for_all_effects_is_not_compiled_again():
    function, _ = compose(read_effects({"rotor_drag": None}, "test"))
    assert compose(read_effects({"tether": None, "gyroscopic": None}, "test"))[0] is function


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
