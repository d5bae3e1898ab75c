# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect declares, and what a file may say about it."""

from __future__ import annotations

import math

import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects

EACH = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.name)
KINDS = ["wrench", "vehicle", "wind", "sensor"]


@EACH
def test_declaration_is_complete(effect):
    assert effect.kind in KINDS
    assert effect.axes == tuple(axis for axis in AXES if axis in effect.axes) != ()
    assert effect.summary == effect.summary.strip() != ""
    assert "\n\n" in effect.function.__doc__
    names = [parameter.name for parameter in effect.parameters]
    assert len(set(names)) == len(names) > 0
    for parameter in effect.parameters:
        assert parameter.lowest <= parameter.default <= parameter.highest
        assert all(map(math.isfinite, (parameter.lowest, parameter.highest)))
        # The unit is in the name, too, where there is one.
        assert ("_" in parameter.name and not parameter.name.endswith("change")) == bool(parameter.unit)


def test_kinds_act_one_after_the_other():
    order = [KINDS.index(effect.kind) for effect in EFFECTS.values()]
    assert order == sorted(order)


@EACH
def test_typical_size_unless_given(effect):
    defaults = {parameter.name: parameter.default for parameter in effect.parameters}
    for nothing in (None, {}):
        assert read_effects({effect.name: nothing}, "file") == {effect.name: defaults}
    last = effect.parameters[-1]
    given = read_effects({effect.name: {last.name: last.highest}}, "file")[effect.name]
    assert given == {**defaults, last.name: last.highest}
    assert list(given) == [parameter.name for parameter in effect.parameters]


@EACH
def test_beyond_what_is_possible(effect):
    for parameter in effect.parameters:
        step = 1.0 if parameter.whole else 1e-3
        for value in (parameter.lowest - step, parameter.highest + step):
            with pytest.raises(
                SimulationError, match=f"file: effect `{effect.name}`: `{parameter.name}` must be"
            ):
                read_effects({effect.name: {parameter.name: value}}, "file")


@pytest.mark.parametrize("value", ["1", None, True, math.nan, math.inf, [1.0]])
def test_what_is_no_number(value):
    with pytest.raises(SimulationError, match="`loss` must be a number, found"):
        read_effects({"weak_rotor": {"loss": value}}, "file")


def test_half_a_rotor():
    with pytest.raises(SimulationError, match=r"`rotor` must be a whole number, found 1\.5"):
        read_effects({"weak_rotor": {"rotor": 1.5}}, "file")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"rotor_darg": None}, "file: unknown effect `rotor_darg`; did you mean `rotor_drag`?"),
        (
            {"payload": {"mass": 1}},
            "file: effect `payload`: unknown parameter `mass`; did you mean `mass_kg`?",
        ),
        ({"payload": {"q": 1}}, "file: effect `payload`: unknown parameter `q`; known: mass_kg"),
        ({"payload": 3}, "file: effect `payload`: expected parameters and their values, found 3"),
        (["payload"], "file: expected names of effects and their parameters, found ['payload']"),
        (
            {"payload": {"mass_kg": 9}},
            "file: effect `payload`: `mass_kg` must be between 0 and 5 kg, found 9",
        ),
        (
            {"translational_lift": {"lift_n_s2_m2": -0.001}},
            "file: effect `translational_lift`: `lift_n_s2_m2` must be between 0 and 0.1 N s²/m², found",
        ),
        ({7: None}, "file: unknown effect `7`; known: body_drag, "),
    ],
)
def test_errors_name_place_and_remedy(data, message):
    with pytest.raises(SimulationError) as caught:
        read_effects(data, "file")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_no_effects():
    assert read_effects(None, "file") == read_effects({}, "file") == {}


def test_order_is_that_of_the_registry():
    assert list(read_effects({"gust": None, "rotor_drag": None}, "file")) == ["rotor_drag", "gust"]
