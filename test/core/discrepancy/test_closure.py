# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far effects close the gap on flights left out of the fit, and the shape that flights give a law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import Closing
from quadpi_core.discrepancy.effect_regression import Regression, settled
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.flight import AXES
from quadpi_core.simulation.applied_effects import effect_wrench

DRAG = {"x_n_s2_m2": 0.006, "y_n_s2_m2": 0.006, "z_n_s2_m2": 0.006}


@pytest.fixture(scope="module")
def closing(found):
    return found.discovery.found.closing


def gap_of(closing, stated=0.0, **changes):
    """The gap above the noise of the regression, of a simulation that states errors in all axes."""
    return closing.gap(closing.regression.noise, np.full(6, stated), **changes)


def rms(rows, samples):
    return np.sqrt(sum(np.square(own).sum(axis=1) for own in rows) / samples)


def test_the_gap_is_that_of_the_residual_and_of_what_flights_left_out_leave(closing):
    regression, gap = closing.regression, gap_of(closing)
    samples = sum(len(flight.thinned) for flight in regression.flights)
    residual = [flight.spectrum(flight.residual[:, :, None]).rows[:, :, 0] for flight in regression.flights]
    np.testing.assert_allclose(gap.before, rms(residual, samples), rtol=1e-9)
    left = [regression.columns.combined(place, fit.left) for place, fit in enumerate(closing.left_out)]
    np.testing.assert_allclose(gap.after, rms(left, samples), rtol=1e-9)
    noise = [np.sqrt(regression.noise[:, band]) for band in regression.columns.bands]
    np.testing.assert_allclose(gap.floor, rms(noise, samples), rtol=1e-9)
    excess = [np.maximum(own**2 - gap.floor**2, 0.0) / gap.floor**2 for own in (gap.before, gap.after)]
    assert gap.reduction == pytest.approx(1.0 - excess[1].sum() / excess[0].sum())
    assert gap.reduction > 0.98


def test_a_flight_is_left_after_the_fit_of_all_others(closing):
    """Each fit is that of a regression that never had the flight."""
    regression = closing.regression
    for place in range(2):
        gram = sum(own for k, own in enumerate(regression.weighting.per_flight) if k != place)
        law, _ = closing.fits(without=place)
        alone = regression.fit(closing.chosen, gram, form=False)
        np.testing.assert_allclose(law.coefficients, alone.coefficients, rtol=1e-5, atol=1e-8)


def test_disagreement_is_the_jackknife_of_flights_over_what_a_fit_leaves_open(closing):
    """Or over what the fits without a flight say that they know less, where that is more."""
    (index,), count = closing.chosen, len(closing.regression.flights)
    columns = closing.regression.block(index).parameters
    # No bound holds one of these fits.
    laws = [closing.fits(without=place)[0] for place in range(count)]
    spread = np.sqrt((count - 1) * np.var([law.of(columns) for law in laws], axis=0))
    assert (spread > 0.0).all()
    ratio = closing.disagreement(index, np.array([10.0, 0.0, 20.0]))
    np.testing.assert_allclose(ratio, spread / [10.0, np.inf, 20.0], rtol=1e-6)
    lost = [law.deviation(columns) ** 2 - closing.fits()[0].deviation(columns) ** 2 for law in laws]
    known_less = np.sqrt((count - 1) / count * np.sum(lost, axis=0))
    narrow = closing.disagreement(index, np.full(3, 1e-9))
    np.testing.assert_allclose(narrow, spread / known_less, rtol=1e-5)


def test_a_bound_makes_no_flight_disagree(closing):
    """As where the flight that alone shows an effect is left out, and noise would turn its sign."""
    (index,) = closing.chosen
    block, deviation = closing.regression.block(index), np.full(3, 1e-9)
    law = closing.fits()[0].of(block.parameters)
    free = closing.disagreement(index, deviation)
    # Bounds so near that every fit without a flight would leave them.
    blocks = list(closing.regression.columns.blocks)
    blocks[index] = replace(block, lowest=law - 1e-9, highest=law + 1e-9)
    columns = replace(closing.regression.columns, blocks=tuple(blocks))
    held = replace(closing, regression=replace(closing.regression, columns=columns))
    assert any(fit.columns.size < closing.fits()[0].columns.size for fit, _ in map(held.fits, range(4)))
    np.testing.assert_allclose(held.disagreement(index, deviation), free, rtol=1e-9)


def test_squares_left_are_in_variances_of_the_noise(closing):
    regression, squares = closing.regression, np.zeros(6)
    for place, (fit, band) in enumerate(zip(closing.left_out, regression.columns.bands, strict=True)):
        left = regression.columns.combined(place, fit.left)
        squares += np.sum(left**2 / regression.noise[:, band], axis=1)
    np.testing.assert_allclose(closing.left_out_squares(), squares)


def test_the_gap_with_coefficients_as_stated_is_what_their_columns_leave(closing):
    regression, gap = closing.regression, gap_of(closing, adjusted=False)
    samples = sum(len(flight.thinned) for flight in regression.flights)
    left = []
    for place, fit in enumerate(closing.left_out):
        weights = fit.left.copy()
        weights[regression.columns.tolerances] = 0.0
        left.append(regression.columns.combined(place, weights))
    np.testing.assert_allclose(gap.after, rms(left, samples), rtol=1e-9)
    assert not np.allclose(gap.after, gap_of(closing).after, rtol=1e-6)
    np.testing.assert_array_equal(gap.before, gap_of(closing).before)


def test_what_the_simulation_states_that_it_errs_by_is_no_gap(closing):
    """Of each axis, where that is more than the noise; all of it, where it is more than the residual."""
    regression, noisy = closing.regression, gap_of(closing)
    stated = np.square(noisy.floor) * [4.0, 0.5, 4.0, 0.5, 4.0, 0.5]
    gap = closing.gap(regression.noise, stated)
    np.testing.assert_allclose(gap.floor, noisy.floor * [2.0, 1.0, 2.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(gap.before, noisy.before)
    within = closing.gap(regression.noise, 1.001 * np.square(noisy.before))
    assert not within.removable.any()
    assert within.reduction == 0.0


def test_squares_beyond_the_floor_are_in_those_of_the_floor(closing):
    gap = gap_of(closing)._replace(before=np.full(6, 3.0), after=np.arange(6.0), floor=np.full(6, 2.0))
    np.testing.assert_allclose(gap.removable, 1.25)
    np.testing.assert_allclose(gap.kept, [0.0, 0.0, 0.0, 1.25, 3.0, 5.25])


def test_without_effects_the_gap_stays(found):
    bare = Closing.of(found.discovery.found.regression, ())
    gap = gap_of(bare)
    np.testing.assert_array_equal(gap.after, gap.before)
    assert gap.reduction == 0.0
    law, whole = bare.fits()
    assert law is whole


def test_axes_that_the_simulation_holds_are_not_judged_on_flights_left_out(closing):
    """The gap tells them as all others, but its closed share is that of the rest."""
    regression, held = closing.regression, np.array([axis.startswith("M") for axis in AXES])
    forces = Regression.of(regression.flights, regression.candidates, held)
    squares = Closing.by_laws(forces, closing.chosen).left_out_squares()
    assert np.all(squares[:3] > 0.0)
    assert not squares[3:].any()
    gap = gap_of(Closing.by_laws(forces, closing.chosen))
    assert np.all(gap.floor > 0.0)
    assert np.all(gap.before > 0.0)
    assert gap.reduction == pytest.approx(1.0 - gap.kept[:3].sum() / gap.removable[:3].sum())


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
    exact = closing.by_laws(closing.regression, (0,))
    assert gap_of(closing).reduction > gap_of(exact).reduction


def test_a_law_that_holds_needs_no_shape(closing):
    law, whole = closing.fits()
    (index,) = closing.chosen
    shape = closing.shape(index, law, whole)
    assert gap_of(closing).reduction > 0.98
    assert all(abs(value) < 0.2 for value in shape.values())
