# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far effects close the gap on flights left out of the fit, and the shape that flights give a law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import Accepted
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import Closing
from quadpi_core.discrepancy.effect_regression import Regression, law_fit, left_out_squares
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Condition
from quadpi_core.discrepancy.whitening import rows_of
from quadpi_core.simulation.applied_effects import effect_wrench

DRAG = {"x_n_s2_m2": 0.006, "y_n_s2_m2": 0.006, "z_n_s2_m2": 0.006}


@pytest.fixture(scope="module")
def closing(found):
    return found.discovery.found.closing


def gap_of(closing, **changes):
    """The gap above the noise of the regression."""
    return closing.gap(closing.regression.noise.variance, np.zeros(6), **changes)


def reduction_of(gap):
    """Closed share of the squares above the floor."""
    before, after = (np.maximum(np.square(own / gap.floor) - 1.0, 0.0) for own in (gap.before, gap.after))
    return 1.0 - after.sum() / before.sum()


@pytest.mark.parametrize("adjusted", [True, False])
def test_the_gap_is_that_of_the_residual_and_of_what_flights_left_out_leave(closing, adjusted):
    """With coefficients as stated it is what their columns leave."""
    regression, gap = closing.regression, gap_of(closing, adjusted=adjusted)
    samples = sum(len(flight.thinned) for flight in regression.flights)
    expected = np.zeros((3, 6))
    for place, flight in enumerate(regression.flights):
        residual, band = flight.spectrum(flight.residual[:, :, None])
        left = rows_of(closing.left_out[place].residual(), place)
        if not adjusted:
            left += rows_of(regression.of_tolerances(regression.moved_by(closing.left_out[place])), place)
        rows = residual[:, :, 0], left, np.sqrt(regression.noise.variance[place][:, band])
        expected += [np.square(own).sum(axis=1) for own in rows]
    np.testing.assert_allclose((gap.before, gap.after, gap.floor), np.sqrt(expected / samples), rtol=1e-9)
    assert gap.reduction == pytest.approx(reduction_of(gap))
    assert gap.reduction > 0.98


def test_squares_are_those_of_flights_after_the_fit_of_all_others_by_the_laws(closing):
    regression, squares = closing.regression, np.zeros(6)
    for place, own in enumerate(regression.residual.spectra):
        left = rows_of(law_fit(regression, closing.chosen, place).residual(), place)
        squares += np.sum(left**2 / regression.noise.variance[place][:, own.band], axis=1)
    np.testing.assert_allclose(left_out_squares(regression, closing.chosen), squares)


def test_disagreement_is_the_jackknife_of_flights_over_what_a_fit_leaves_open(closing):
    """Or over what the fits without a flight say that they know less, where that is more."""
    regression, (index,), count = closing.regression, closing.chosen, len(closing.regression.flights)
    # No bound holds one of these fits.
    whole, *laws = (law_fit(regression, (index,), without) for without in (None, *range(count)))
    spread = np.sqrt((count - 1) * np.var([regression.found(index, law) for law in laws], axis=0))
    assert (spread > 0.0).all()
    ratio = closing.disagreement(index, np.array([10.0, 0.0, 20.0]))
    np.testing.assert_allclose(ratio, spread / [10.0, np.inf, 20.0], rtol=1e-6)
    known = regression.deviation(index, whole) ** 2
    lost = [regression.deviation(index, law) ** 2 - known for law in laws]
    narrow = np.full(3, 1e-9)
    free = closing.disagreement(index, narrow)
    np.testing.assert_allclose(free, spread / np.sqrt((count - 1) / count * np.sum(lost, axis=0)), rtol=1e-5)
    # Nor would bounds so near that every fit without a flight would leave them, as where the flight that
    # alone shows an effect is left out, and noise would turn its sign.
    blocks, at = list(regression.blocks), regression.found(index, whole)
    blocks[index] = replace(blocks[index], lowest=at - 1e-9, highest=at + 1e-9)
    held = replace(closing, regression=replace(regression, blocks=tuple(blocks)))
    assert not np.any(regression.found(index, law_fit(held.regression, (index,), 0)))
    np.testing.assert_allclose(held.disagreement(index, narrow), free, rtol=1e-9)


def test_what_the_simulation_states_that_it_errs_by_is_no_gap(closing):
    """Of each axis, where that is more than the noise; all of it, where it is more than the residual."""
    variance, noisy = closing.regression.noise.variance, gap_of(closing)
    gap = closing.gap(variance, np.square(noisy.floor) * [4.0, 0.5, 4.0, 0.5, 4.0, 0.5])
    np.testing.assert_allclose(gap.floor, noisy.floor * [2.0, 1.0, 2.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(gap.before, noisy.before)
    assert closing.gap(variance, 1.001 * np.square(noisy.before)).reduction == 0.0


def test_axes_that_intervals_hold_are_no_gap(closing):
    """However far they are above the floor, with effects and without."""
    whole, held = gap_of(closing), np.array([True, False, True, True, True, True])
    only = gap_of(closing, held=held)
    for one, other in zip(whole[:3], only[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    before, after = (np.square(own[1] / whole.floor[1]) - 1.0 for own in (whole.before, whole.after))
    assert only.reduction == pytest.approx(1.0 - max(after, 0.0) / before)
    assert only.reduction != whole.reduction


def test_without_effects_the_gap_stays(closing):
    gap = gap_of(Closing.from_regression(closing.regression, ()))
    np.testing.assert_array_equal(gap.after, gap.before)
    assert gap.reduction == 0.0


def test_what_a_flight_has_of_its_own_is_no_gap(closing):
    """A constant moment in one of the flights, before and after."""
    regression = closing.regression
    index = [own.name for own in regression.candidates].index("moment_bias")
    columns, odd = regression.blocks[index].columns, np.zeros((4, 3))
    odd[0, 0] = 1.0
    residual = regression.residual.plus(lambda place: columns.spectra[place].rows @ odd[place][:, None])
    changed = replace(regression, residual=residual)
    known = changed.with_condition(Condition(index, np.maximum(odd, 1e-4)))
    gaps = [gap_of(Closing.from_regression(own, closing.chosen)) for own in (regression, known, changed)]
    for without, told, all_of_it in zip(*([gap.before[3], gap.after[3]] for gap in gaps), strict=True):
        assert told == pytest.approx(without, rel=0.05)
        assert all_of_it > 2.0 * without


@pytest.mark.parametrize(("odd", "adjusted"), [(1.0, True), (-1.0, False)])
def test_coefficients_are_adjusted_where_flights_left_out_gain(closing, odd, adjusted):
    """As far as the odd flights ask for the same as the even ones."""
    regression = closing.regression
    three = 3.0 * (np.array(regression.tolerances.names) == "thrust")

    def more(place):
        return (odd if place % 2 else 1.0) * rows_of(regression.of_tolerances(three), place)[:, :, None]

    off = replace(regression, residual=regression.residual.plus(more))
    found = Closing.from_regression(off, closing.chosen)
    assert found.adjusted is adjusted
    moved = [np.any(off.moved_by(fit)) for fit in (*found.left_out, found.fits()[1])]
    assert moved == [adjusted] * 5


def test_flights_shape_a_law_that_is_off(simulation, flights, pushed):
    """Drag that grows less than the law says: found with its shape, it is the drag that acted."""
    true = {**DRAG, "shape_speed": -0.25}

    def drag(flight, parameters):
        return effect_wrench("body_drag", parameters, simulation.states(flight), simulation.record())

    def missed(parameters):
        error = np.concatenate([drag(flight, parameters) - drag(flight, true) for flight in flights])
        return np.sqrt(np.square(error[:, :3]).mean())

    made = [Compared(pushed(own, simulation.vehicle, drag(own, true)), simulation) for own in flights]
    start = Regression.from_flights(made, candidates(simulation.vehicle, ["body_drag"]))
    regression = Accepted(start, (0,), start.fit((0,))).refined().regression
    closing = Closing.from_regression(regression, (0,))
    law, whole = closing.fits()
    parameters = dict(zip(DRAG, regression.parameters(0, law), strict=True))
    shape = closing.shape(0, law, whole)
    assert closing.shaped == (0,)
    assert shape["shape_speed"] < -0.1
    assert missed(parameters | shape) < 0.5 * missed(parameters)
    assert missed(parameters | shape) < 0.05 * missed(dict.fromkeys(DRAG, 0.0))
    unshaped = replace(closing, shaped=(), noise=regression.noise)
    assert gap_of(closing).reduction > gap_of(unshaped).reduction
    # The shape is that of the law, whatever size of it the columns were made for.
    halved = Closing.from_regression(regression.moved({0: 0.5 * regression.points[0]}), (0,))
    again = halved.shape(0, *halved.fits())
    assert again["shape_speed"] == pytest.approx(shape["shape_speed"], rel=0.2)


def test_a_law_that_holds_needs_no_shape(closing):
    (index,) = closing.chosen
    assert all(abs(value) < 0.2 for value in closing.shape(index, *closing.fits()).values())
