# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far effects close the gap on flights left out of the fit, and the shape that flights give a law."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import Closing, law_fit, left_out_squares
from quadpi_core.discrepancy.effect_regression import Regression, settled
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Block, fit
from quadpi_core.discrepancy.linearisation import NO_COLUMNS
from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import effect_wrench

DRAG = {"x_n_s2_m2": 0.006, "y_n_s2_m2": 0.006, "z_n_s2_m2": 0.006}


@pytest.fixture(scope="module")
def closing(found):
    return found.discovery.found.closing


def gap_of(closing, **changes):
    """The gap above the noise of the regression."""
    return closing.gap(closing.regression.noise, np.zeros(6), **changes)


def rms(rows, samples):
    return np.sqrt(sum(np.square(own).sum(axis=1) for own in rows) / samples)


@pytest.mark.parametrize("adjusted", [True, False])
def test_the_gap_is_that_of_the_residual_and_of_what_flights_left_out_leave(closing, adjusted):
    """With coefficients as stated it is what their columns leave."""
    regression, gap = closing.regression, gap_of(closing, adjusted=adjusted)
    columns = regression.columns
    samples = sum(len(flight.thinned) for flight in regression.flights)
    residual = [flight.spectrum(flight.residual[:, :, None]).rows[:, :, 0] for flight in regression.flights]
    np.testing.assert_allclose(gap.before, rms(residual, samples), rtol=1e-9)
    left = [fit.left.copy() for fit in closing.left_out]
    for weights in left:
        weights[columns.tolerances] *= adjusted
    after = [columns.combined(place, weights) for place, weights in enumerate(left)]
    np.testing.assert_allclose(gap.after, rms(after, samples), rtol=1e-9)
    noise = [np.sqrt(regression.noise[:, band]) for band in columns.bands]
    np.testing.assert_allclose(gap.floor, rms(noise, samples), rtol=1e-9)
    excess = [np.maximum(own**2 - gap.floor**2, 0.0) / gap.floor**2 for own in (gap.before, gap.after)]
    assert gap.reduction == pytest.approx(1.0 - excess[1].sum() / excess[0].sum())
    assert gap.reduction > 0.98


def test_a_flight_is_left_after_the_fit_of_all_others(closing):
    """Each fit is that of a regression that never had the flight."""
    regression, squares = closing.regression, np.zeros(6)
    for place, band in enumerate(regression.columns.bands):
        gram = sum(own for k, own in enumerate(regression.weighting.per_flight) if k != place)
        alone = regression.fit(closing.chosen, gram, form=False)
        np.testing.assert_allclose(
            closing.fits(place)[0].coefficients, alone.coefficients, rtol=1e-5, atol=1e-8
        )
        left = regression.columns.combined(place, law_fit(regression, closing.chosen, place).left)
        squares += np.sum(left**2 / regression.noise[:, band], axis=1)
    np.testing.assert_allclose(left_out_squares(regression, closing.chosen), squares)


def test_disagreement_is_the_jackknife_of_flights_over_what_a_fit_leaves_open(closing):
    """Or over what the fits without a flight say that they know less, where that is more."""
    (index,), count = closing.chosen, len(closing.regression.flights)
    block = closing.regression.block(index)
    # No bound holds one of these fits.
    whole, laws = closing.fits()[0], [closing.fits(without=place)[0] for place in range(count)]
    spread = np.sqrt((count - 1) * np.var([law.of(block.parameters) for law in laws], axis=0))
    assert (spread > 0.0).all()
    ratio = closing.disagreement(index, np.array([10.0, 0.0, 20.0]))
    np.testing.assert_allclose(ratio, spread / [10.0, np.inf, 20.0], rtol=1e-6)
    lost = [law.deviation(block.parameters) ** 2 - whole.deviation(block.parameters) ** 2 for law in laws]
    known_less = np.sqrt((count - 1) / count * np.sum(lost, axis=0))
    narrow = np.full(3, 1e-9)
    free = closing.disagreement(index, narrow)
    np.testing.assert_allclose(free, spread / known_less, rtol=1e-5)
    # Nor would bounds so near that every fit without a flight would leave them, as where the flight that
    # alone shows an effect is left out, and noise would turn its sign.
    blocks, at = list(closing.regression.columns.blocks), whole.of(block.parameters)
    blocks[index] = replace(block, lowest=at - 1e-9, highest=at + 1e-9)
    columns = replace(closing.regression.columns, blocks=tuple(blocks))
    held = replace(closing, regression=replace(closing.regression, columns=columns))
    assert any(fit.columns.size < whole.columns.size for fit, _ in map(held.fits, range(4)))
    np.testing.assert_allclose(held.disagreement(index, narrow), free, rtol=1e-9)


def test_what_the_simulation_states_that_it_errs_by_is_no_gap(closing):
    """Of each axis, where that is more than the noise; all of it, where it is more than the residual."""
    regression, noisy = closing.regression, gap_of(closing)
    stated = np.square(noisy.floor) * [4.0, 0.5, 4.0, 0.5, 4.0, 0.5]
    gap = closing.gap(regression.noise, stated)
    np.testing.assert_allclose(gap.floor, noisy.floor * [2.0, 1.0, 2.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(gap.before, noisy.before)
    assert closing.gap(regression.noise, 1.001 * np.square(noisy.before)).reduction == 0.0


def test_without_effects_the_gap_stays(closing):
    gap = gap_of(Closing.of(closing.regression, ()))
    np.testing.assert_array_equal(gap.after, gap.before)
    assert gap.reduction == 0.0


def test_axes_that_the_simulation_holds_are_not_judged_on_flights_left_out(closing):
    """The gap tells them as all others, but its closed share is that of the rest."""
    regression, held = closing.regression, np.array([axis.startswith("M") for axis in AXES])
    forces = Regression.of(regression.flights, regression.candidates, held)
    squares = left_out_squares(forces, closing.chosen)
    assert np.all(squares[:3] > 0.0)
    assert not squares[3:].any()
    gap = gap_of(Closing.of(forces, closing.chosen))
    beyond = [np.maximum(np.square(own / gap.floor) - 1.0, 0.0) for own in (gap.before, gap.after)]
    assert gap.reduction == pytest.approx(1.0 - beyond[1][:3].sum() / beyond[0][:3].sum())


@pytest.mark.parametrize(("odd", "adjusted"), [(1.0, True), (-1.0, False)])
def test_coefficients_are_adjusted_where_flights_left_out_gain(odd, adjusted):
    """As far as the odd flights ask for the same as the even ones."""
    rng = np.random.default_rng(0)
    flights = []
    for place in range(6):
        motion = rng.standard_normal(400)
        rows = 0.1 * rng.standard_normal((6, 400))
        rows[0] += motion * (odd if place % 2 else 1.0)
        flights.append(np.stack((rows, np.outer([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], motion)), axis=2))
    grams = np.array([np.einsum("abi,abj->ij", own, own) / 0.01 for own in flights])
    columns = SimpleNamespace(
        tolerances=np.array([1]),
    )
    block = Block(NO_COLUMNS, NO_COLUMNS, 1.0, None, np.empty(0), np.empty(0), np.empty(0))
    regression = SimpleNamespace(
        columns=columns,
        weighting=SimpleNamespace(per_flight=grams),
        gram=grams.sum(axis=0),
        flights=flights,
        candidates=[SimpleNamespace(effect=SimpleNamespace(shape=False))],
        block=lambda _: block,
        fit=lambda _, gram, **__: fit(gram, columns.tolerances, []),
    )
    assert bool(len(Closing.of(regression, [0]).adjusted)) is adjusted


def test_flights_shape_a_law_that_is_off(simulation, flights, pushed):
    """Drag that grows less than the law says: found with its shape, it is the drag that acted."""
    true = {**DRAG, "shape_speed": -0.25}

    def drag(flight, parameters):
        return effect_wrench("body_drag", parameters, simulation.states(flight), simulation.record())

    made = [pushed(flight, simulation.vehicle, drag(flight, true)) for flight in flights]
    compared = [Compared(flight, simulation) for flight in made]
    closing = Closing.of(
        settled(Regression.of(compared, candidates(simulation.vehicle, ["body_drag"]))), (0,)
    )
    assert closing.shaped == (0,)
    law, whole = closing.fits()
    values = closing.regression.parameters(0, law)
    parameters = dict(zip(DRAG, values, strict=True))
    shape = closing.shape(0, law, whole)
    assert shape["shape_speed"] < -0.1

    def missed(found):
        error = np.concatenate([drag(flight, found) - drag(flight, true) for flight in flights])
        return np.sqrt(np.square(error[:, :3]).mean())

    acted = np.sqrt(np.square(np.concatenate([drag(f, true)[:, :3] for f in flights])).mean())
    assert missed(parameters | shape) < 0.5 * missed(parameters)
    assert missed(parameters | shape) < 0.05 * acted
    # The shape is that of the law, whatever size of it the columns were made for.
    halved = Closing.of(closing.regression.moved({0: 0.5 * closing.regression.columns.points[0]}), (0,))
    again = halved.shape(0, *halved.fits())
    assert again["shape_speed"] == pytest.approx(shape["shape_speed"], rel=0.2)
    columns = closing.regression.columns
    exact = Closing(closing.regression, (0,), (), closing.regression.weighting.per_flight, columns.tolerances)
    assert gap_of(closing).reduction > gap_of(exact).reduction


def test_a_law_that_holds_needs_no_shape(closing):
    (index,) = closing.chosen
    assert all(abs(value) < 0.2 for value in closing.shape(index, *closing.fits()).values())
