# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect is, and the laws that flights shape."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.simulation.applied_effects import read_effects, state_modulators
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
