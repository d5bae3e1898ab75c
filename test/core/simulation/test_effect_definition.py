# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect is, and the laws that flights shape."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects, state_modulators
from quadpi_core.simulation.effect_definition import SHAPE, Parameter, effect, three


def test_an_effect_is_named_and_described_by_its_function():
    @effect("wind", "Fx Fy", Parameter("size_n", "N", 1.0, 0.0, 2.0), symbols="k", form=0.1, formula="F = k")
    def breath(*_):
        """A little air.

        Source: none.
        """

    assert (breath.name, breath.summary, breath.kind) == ("breath", "A little air", "wind")
    assert (breath.axes, breath.symbols, breath.form) == (("Fx", "Fy"), ("k",), 0.1)
    assert [p.name for p in breath.parameters] == ["size_n"]


@pytest.mark.parametrize(("kind", "form", "shaped"), [("wrench", 0.1, True), ("wrench", 0.0, False)])
def test_a_law_that_may_be_wrong_can_be_shaped(kind, form, shaped):
    @effect(kind, "Fx", form=form)
    def law(*_):
        """Law."""

    assert law.shape == (SHAPE if shaped else ())


def test_the_inverse_of_an_effect_is_its_negative_unless_given():
    @effect("sensor", "Fx")
    def plain(*_):
        """Plain."""

    @effect("sensor", "Fx", inverse=lambda p: 1.0 / p)
    def scale(*_):
        """Scale."""

    np.testing.assert_array_equal(plain.undo(np.array([2.0, -4.0])), [-2.0, 4.0])
    np.testing.assert_array_equal(scale.undo(np.array([2.0, -4.0])), [0.5, -0.25])


def test_three_parameters_of_one_size():
    x, y, z = three("n", "N", 0.1, 5.0)
    assert (x.name, y.name, z.name) == ("x_n", "y_n", "z_n")
    assert (z.unit, z.default, z.lowest, z.highest) == ("N", 0.1, -5.0, 5.0)
    assert three("n", "N", 0.1, 5.0, lowest=0.0)[0].lowest == 0.0


def test_modulators_are_the_state_without_dimension(states, record, model):
    """Airspeed, its components, load, rates, nearness of the ground, square of the climb."""
    found = state_modulators(states, record).T
    velocity = states["velocity_air"] / model.vehicle.hover_induced_velocity
    radius = model.vehicle.rotor_radius_m
    turning = radius * np.linalg.norm(states["rates"], axis=1) / model.vehicle.hover_induced_velocity
    height = np.maximum(-states["position"][:, 2], radius)
    expected = (
        np.linalg.norm(velocity, axis=1),
        *velocity.T,
        np.square(states["rotor_speeds"] / model.hover_rotor_speed).mean(axis=1),
        turning,
        radius / height,
        velocity[:, 2] ** 2,
    )
    assert [p.name for p in SHAPE[6:]] == [
        f"shape_{name}" for name in ("speed", "u", "v", "w", "load", "rates", "ground", "w2")
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_shaped_law_adds_its_shares_more(hover, record, added):
    """In each axis by its own share, and in all by slopes; never turned around, never beyond three times."""
    state = hover(velocity=[4.0, -3.0, 0.0], height=3.0)
    bare = added("rotor_drag", state)

    def shaped(**shape):
        return added("rotor_drag", state, **shape)

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


# What an effect declares, and what a file may say about it.


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
