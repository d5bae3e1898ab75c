# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What single flights have of their own beside what all share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.closure import left_out_squares
from quadpi_core.discrepancy.flight_conditions import Condition

from .dense_noise import Normal
from .regressions import (
    DRAG,
    VARIANCE,
    of_sound_flights,
    regression_of,
    rows,
)

BIAS = 1


@pytest.fixture(scope="module")
def pulled(simulation, flights):
    """Of four flights up to 5 Hz, on drag and a constant force, beside a simulation whose noise is known."""
    return regression_of(of_sound_flights(simulation), flights, ["body_drag", "force_bias"], highest_hz=5.0)


def with_forces(pulled, values):
    """The regression with a force (F, 3), in prior deviations, in each flight."""
    columns = pulled.blocks[BIAS].columns
    forces = pulled.residual.plus(lambda place: rows(columns, place) @ values[place][:, None])
    return replace(pulled, residual=forces)


def log_density(own):
    """Of the residual of all flights without effects."""
    return Normal.of(own.noise, own.residual, own.base[1:], range(len(own.flights))).log_density


def test_what_flights_have_of_their_own_is_told_from_what_they_share(pulled):
    """A constant force: the same along x in all flights, and another one along y in each."""
    values = np.array([[0.4, y, 0.0] for y in (-0.5, 0.5, -0.5, 0.5)])
    changed = with_forces(pulled, values)
    sizes = changed.sizes_of_condition(BIAS, (DRAG,))
    np.testing.assert_allclose(sizes[:, 1], 0.5, rtol=0.3)
    assert sizes[:, 0].max() < 0.1
    condition = Condition(BIAS, sizes)
    conditioned = changed.with_condition(condition)
    gain = conditioned.fit(()).log_evidence - changed.fit(()).log_evidence
    assert gain == pytest.approx(log_density(conditioned) - log_density(changed))
    assert gain > 20.0
    # Beside another condition.
    conditioned = conditioned.with_condition(Condition(DRAG, np.full((4, 3), 1e-3)))
    both, scale = conditioned.fit((DRAG, BIAS)), changed.candidates[BIAS].scale
    for place in range(4):
        value, deviation = (own / scale for own in conditioned.of_condition(condition, place, both))
        assert abs(value[1] - values[place, 1]) < 4.0 * deviation[1] < 0.4
    # What all share stays for an effect to explain.
    assert conditioned.found(BIAS, both)[0] == pytest.approx(0.4, abs=0.1)


def test_a_flight_that_differs_by_much_does_not_hide_what_the_others_share(pulled):
    values = np.full((4, 3), 0.2)
    values[0] = -2.0
    changed = with_forces(pulled, values)
    conditioned = changed.with_condition(Condition(BIAS, changed.sizes_of_condition(BIAS, ())))
    np.testing.assert_allclose(conditioned.found(BIAS, conditioned.fit((BIAS,)))[:2], 0.2, atol=0.05)


def test_flights_that_are_alike_gain_nothing_by_parameters_of_their_own(pulled):
    alike, both = with_forces(pulled, np.full((4, 3), 0.4)), (DRAG, BIAS)
    conditioned = alike.with_condition(Condition(BIAS, alike.sizes_of_condition(BIAS, both)))
    assert conditioned.fit(both).log_evidence - alike.fit(both).log_evidence < 1.0


def test_what_flights_may_have_of_their_own_is_no_noise_beside_an_effect(pulled):
    odd = with_forces(pulled, np.array([[1.0, 0.0, 0.0], *np.zeros((3, 3))]))
    assert odd.conditions_to_come == [BIAS]
    assert odd.with_condition(Condition(BIAS, np.ones((4, 3)))).conditions_to_come == []
    # What no flight may have of its own.
    alone = replace(odd, candidates=odd.candidates[:1], blocks=odd.blocks[:1])
    slow = [own.beside((), own.fit(())).noise.variance[:, 0, 0] / VARIANCE[0] for own in (odd, alone)]
    np.testing.assert_allclose(slow[0], 1.0)
    assert slow[1][0] > 1.1 * slow[1][1:].max() > 10.0
    # Nor does it count against an effect on flights left out.
    assert 10.0 * left_out_squares(odd, ())[0] < left_out_squares(alone, ())[0]
