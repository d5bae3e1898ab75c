# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The regression of a search: its fits beside dense least squares, its noise, its linearisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import (
    NONE_HELD,
    Condition,
    NoiseWeighting,
    Regression,
    refined,
    settled,
)
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.whitening import band_means
from quadpi_core.flight import AXES

WIND = np.array([0.8, -0.5, 0.0])


@pytest.fixture(scope="module")
def regression(found):
    """Of flights with drag of the airframe."""
    return found.discovery.found.regression


@pytest.fixture(scope="module")
def drag(regression):
    """Index of the effect that is there."""
    return [own.name for own in regression.candidates].index("body_drag")


def whitened(regression, columns):
    """Rows (R, k) of some columns of all flights, in standard deviations of the noise."""
    parts = []
    for place, band in enumerate(regression.columns.bands):
        rows = regression.columns.rows(place, columns) / np.sqrt(regression.noise[:, band])[:, :, None]
        parts.append(rows.reshape(-1, rows.shape[2]))
    return np.concatenate(parts)


def test_a_fit_is_least_squares_with_a_unit_prior(regression, drag):
    block = regression.block(drag)
    columns = np.concatenate((regression.columns.tolerances, block.parameters))
    rows, residual = whitened(regression, columns), whitened(regression, np.zeros(1, dtype=int))[:, 0]
    bounded = np.vstack((rows, np.eye(len(columns))))
    best, *_ = np.linalg.lstsq(bounded, np.concatenate((residual, np.zeros(len(columns)))), rcond=None)
    fit = regression.fit((drag,), form=False)
    np.testing.assert_allclose(fit.of(columns), best, rtol=1e-6, atol=1e-9)
    scale = regression.candidates[drag].scale
    np.testing.assert_allclose(regression.parameters(drag, fit), best[-3:] * scale, rtol=1e-6)
    assert regression.size(drag, fit) == pytest.approx(np.abs(best[-3:]).max())
    # What is left is the residual less the fit.
    deviation = np.sqrt(regression.noise[:, regression.columns.bands[0]])
    left = residual - rows @ best
    own = regression.left(fit)[0] / deviation
    np.testing.assert_allclose(own.ravel(), left[: own.size], atol=1e-6)


def test_energy_and_loudness_are_those_of_the_contribution(regression, drag):
    fit = regression.fit((drag,), form=False)
    block = regression.block(drag)
    squares, noise = np.zeros(6), np.zeros(6)
    energy = 0.0
    for place, band in enumerate(regression.columns.bands):
        added = regression.columns.rows(place, block.parameters) @ fit.of(block.parameters)
        energy += 0.5 * np.sum(added**2 / regression.noise[:, band])
        squares += np.sum(added**2, axis=1)
        noise += regression.noise[:, band].sum(axis=1)
    assert regression.energy((drag,), fit) == pytest.approx(energy)
    assert regression.loudness(drag, fit) == pytest.approx(np.sqrt(np.max(squares / noise)))


def test_what_coefficients_undo_speaks_for_no_effect(regression, drag):
    """Drag of a hundred times its size, and coefficients that take away what is too much of it."""
    block, tolerances = regression.block(drag), regression.columns.tolerances
    fit = regression.fit((drag,), form=False)
    honest = regression.reduction((drag,), fit)
    assert honest.credited[:2].min() > 0.0
    np.testing.assert_allclose(honest.credited[:2], honest.fitted[:2], rtol=0.3)
    along = regression.columns.rows(0, block.parameters) @ fit.of(block.parameters)
    undoing = regression.columns.rows(0, tolerances).reshape(-1, len(tolerances))
    weights = fit.left.copy()
    weights[block.parameters] *= 100.0
    weights[tolerances] += 99.0 * np.linalg.lstsq(undoing, along.ravel(), rcond=None)[0]
    cancelled = regression.reduction((drag,), fit._replace(left=weights))
    assert cancelled.fitted[:2].min() > 10.0 * honest.fitted[:2].max()
    assert cancelled.credited[:2].max() < 0.0


def test_squares_are_counted_in_variances_of_the_noise(regression, drag):
    fit = regression.fit((drag,), form=False)
    noise = np.tile(np.arange(1.0, 7.0)[:, None], regression.noise.shape[1])
    np.testing.assert_allclose(
        regression.reduction((drag,), fit, noise).fitted * noise[:, 0],
        regression.reduction((drag,), fit).fitted,
    )


def test_twice_the_noise_is_half_the_weight(regression):
    louder = regression.weighted(2.0 * regression.noise)
    np.testing.assert_allclose(louder.gram, 0.5 * regression.gram, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(louder.weighting.per_flight.sum(axis=0), louder.gram)


def test_known_errors_are_part_of_the_noise(regression):
    """Columns are weighed by the inverse of 1 + Q Qᵀ, by Woodbury 1 − Q (1 + Qᵀ Q)⁻¹ Qᵀ."""
    rng = np.random.default_rng(0)
    errors = tuple(
        np.sqrt(regression.noise[:, band, None]) * rng.standard_normal((6, len(band), 3))
        for band in regression.columns.bands
    )
    beside = NoiseWeighting.of(replace(regression.columns, errors=errors), regression.noise, NONE_HELD)
    whole = np.arange(regression.columns.width)
    for place, band in enumerate(regression.columns.bands):
        weights = 1.0 / np.sqrt(regression.noise[:, band])[:, :, None]
        rows = (regression.columns.rows(place, whole) * weights).reshape(-1, len(whole))
        q = (errors[place] * weights).reshape(len(rows), -1)
        expected = rows.T @ rows - rows.T @ q @ np.linalg.solve(np.eye(3) + q.T @ q, q.T @ rows)
        np.testing.assert_allclose(
            beside.per_flight[place], expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max()
        )


@pytest.fixture(scope="module")
def forces_alone(regression):
    """The same flights beside a simulation whose own intervals hold the moments."""
    held = np.array([axis.startswith("M") for axis in AXES])
    return Regression.of(regression.flights, regression.candidates, held)


def test_axes_that_the_simulation_holds_have_no_weight(forces_alone):
    whole = forces_alone.weighting.precision[3:]
    assert not whole.any()
    for place, band in enumerate(forces_alone.columns.bands):
        rows = forces_alone.columns.rows(place, np.arange(forces_alone.columns.width))[:3]
        rows = rows / np.sqrt(forces_alone.noise[:3, band])[:, :, None]
        expected = np.einsum("abk,abl->kl", rows, rows)
        np.testing.assert_allclose(
            forces_alone.weighting.per_flight[place], expected, atol=1e-9 * np.abs(expected).max()
        )
    assert forces_alone.moved({}).weighted(forces_alone.noise).weighting.held.sum() == 3


def test_what_no_axis_tells_moves_no_coefficient(forces_alone, drag):
    """The moments would tell the moments of inertia, but are known no better than they agree."""
    columns = forces_alone.columns
    values = dict(zip(columns.tolerance_names, forces_alone.fit((drag,)).of(columns.tolerances), strict=True))
    assert abs(values["inertia.x_change"]) < 1e-9
    assert abs(values["thrust"]) > 1e-3


def test_what_is_left_of_axes_without_weight_is_no_noise(forces_alone, drag, monkeypatch):
    """Nothing was fitted to them."""
    fit = forces_alone.fit((drag,))
    before = forces_alone.beside((drag,), fit).noise
    monkeypatch.setattr(
        Regression, "left", lambda own, _: [np.full((6, len(b)), 9e9) for b in own.columns.bands]
    )
    louder = forces_alone.beside((drag,), fit).noise / before
    assert louder[:3].max() > 1.0
    np.testing.assert_allclose(louder[3:], 1.0)


def test_a_gram_matrix_grows_with_the_columns(regression, drag):
    """As if it had been made of all columns at once."""
    moved = regression.moved({drag: np.array([0.005, 0.009, 0.006])})
    assert moved.columns.width > regression.columns.width
    whole = NoiseWeighting.of(moved.columns, regression.noise, NONE_HELD)
    scale = np.abs(whole.gram).max()
    np.testing.assert_allclose(moved.gram, whole.gram, atol=1e-9 * scale)


def test_noise_beside_an_effect_is_no_less_than_what_it_leaves_and_no_more_than_there_was(regression, drag):
    fit = regression.fit((drag,))
    beside = regression.beside((drag,), fit)
    bands = beside.columns.bands
    left = band_means([np.square(rows) for rows in regression.left(fit)], bands)
    residual = [own.spectrum(own.residual[:, :, None]).rows[:, :, 0] for own in regression.flights]
    before = band_means([np.square(rows) for rows in residual], bands)
    assert np.all(beside.noise >= (1.0 - 1e-9) * np.minimum(left, before))
    assert np.all(beside.noise <= (1.0 + 1e-9) * before)


@pytest.fixture(scope="module")
def windy(simulation, flights):
    """Flights in a wind that nothing measured: the simulation thinks it flies through still air."""
    unaware = [replace(own, wind=own.wind - WIND).slice(slice(0, 1500)) for own in flights[:2]]
    compared = [Compared(flight, simulation) for flight in unaware]
    return Regression.of(compared, candidates(simulation.vehicle, ["wind", "payload"]))


def test_a_curved_effect_is_linearised_where_it_fits_best(windy):
    names = [own.name for own in windy.candidates]
    index = names.index("wind")
    assert not windy.columns.points[index].any()
    at = settled(windy).columns.points[index]
    np.testing.assert_allclose(at, WIND, atol=0.1)
    # A linear candidate stays as it is.
    assert settled(windy).block(names.index("payload")).offset is None


def test_the_chosen_are_refined_together(windy):
    index = [own.name for own in windy.candidates].index("wind")
    regression = settled(windy)
    better, fit = refined(regression, (index,), regression.fit((index,)))
    np.testing.assert_allclose(better.parameters(index, fit), WIND, atol=0.1)
    np.testing.assert_allclose(better.columns.points[index], better.parameters(index, fit), atol=0.02)
    assert fit.log_evidence >= regression.fit((index,)).log_evidence - 5.0


def test_frequencies_that_are_not_compared_have_no_noise(simulation, flights):
    compared = [Compared(own.slice(slice(0, 1000)), simulation, highest_hz=5.0) for own in flights[:2]]
    regression = Regression.of(compared, candidates(simulation.vehicle, ["payload"]))
    assert regression.noise.shape == (6, 6)
    assert np.all(regression.noise > 0.0)


def test_energy_of_a_curved_effect_is_that_of_what_it_adds(windy):
    """About another point than zero: its columns less the offset."""
    index = [own.name for own in windy.candidates].index("wind")
    at_its_best = settled(windy)
    regression, fit = refined(at_its_best, (index,), at_its_best.fit((index,)))
    wind, values = regression.candidates[index], regression.parameters(index, fit)
    energy = 0.0
    for flight, band in zip(regression.flights, regression.columns.bands, strict=True):
        added = flight.spectrum(flight.added(wind.effect, wind.values(values))[:, :, None]).rows[:, :, 0]
        energy += 0.5 * np.sum(added**2 / regression.noise[:, band])
    assert regression.energy((index,), fit) == pytest.approx(energy, rel=0.02)


def with_residual(regression, index, values):
    """The regression with parameters (F, k) of a candidate, in prior deviations, added to each flight."""
    columns, tables = regression.block(index).parameters, []
    for place, (first, *others) in enumerate(regression.columns.tables):
        moved = first.copy()
        moved[:, :, 0] += regression.columns.rows(place, columns) @ values[place]
        tables.append((moved, *others))
    changed = replace(regression.columns, tables=tuple(tables))
    weighting = NoiseWeighting.of(changed, regression.noise, NONE_HELD)
    return replace(regression, columns=changed, weighting=weighting)


@pytest.fixture(scope="module")
def pulled(regression):
    """Regression of the same flights on drag and a constant force."""
    vehicle = regression.flights[0].simulation.vehicle
    return Regression.of(regression.flights, candidates(vehicle, ["force_bias", "body_drag"]))


def test_what_flights_have_of_their_own_is_told_from_what_they_share(pulled):
    """A constant force: the same along x in all flights, and another one along y in each."""
    drag, index = [[own.name for own in pulled.candidates].index(n) for n in ("body_drag", "force_bias")]
    flights = len(pulled.flights)
    values = np.zeros((flights, 3))
    values[:, 0], values[:, 1] = 0.4, np.where(np.arange(flights) % 2, 0.5, -0.5)
    changed = with_residual(pulled, index, values)
    sizes = changed.sizes_of_condition(index, (drag,))
    np.testing.assert_allclose(sizes[:, 1], 0.5, rtol=0.3)
    assert sizes[:, 0].max() < 0.1
    fit = changed.fit((drag,))
    gain = changed.gain_of_condition(index, sizes, (drag,), fit)
    assert gain > 20.0
    conditioned = changed.with_condition(Condition(index, sizes))
    # What the gain promised is what the noise with the condition gives, its normalisation counted.
    (own,) = conditioned.conditions
    after = conditioned.fit((drag,))
    block, cost = changed.block(index).parameters, 0.0
    for gram, size in zip(changed.weighting.per_flight, sizes, strict=True):
        inner = np.eye(3) + gram[np.ix_(block, block)] * np.outer(size, size)
        cost += 0.5 * np.linalg.slogdet(inner)[1]
    assert gain == pytest.approx(after.log_evidence - cost - fit.log_evidence, rel=1e-6)
    both = conditioned.fit(tuple(sorted((drag, index))))
    for place in range(flights):
        value, deviation = conditioned.of_condition(own, place, both.left)
        scale = conditioned.candidates[index].scale
        assert abs(value[1] / scale[1] - values[place, 1]) < 4.0 * deviation[1] / scale[1] + 0.05
    # What all share stays for an effect to explain.
    assert both.of(changed.block(index).parameters)[0] == pytest.approx(0.4, abs=0.1)


def test_a_flight_that_differs_by_much_does_not_hide_what_the_others_share(pulled):
    index = [own.name for own in pulled.candidates].index("force_bias")
    values = np.full((len(pulled.flights), 3), 0.2)
    values[0] = -2.0
    changed = with_residual(pulled, index, values)
    conditioned = changed.with_condition(Condition(index, changed.sizes_of_condition(index, ())))
    both = conditioned.fit((index,))
    np.testing.assert_allclose(both.of(changed.block(index).parameters)[:2], 0.2, atol=0.05)


def test_flights_that_are_alike_gain_nothing_by_parameters_of_their_own(pulled):
    index = [own.name for own in pulled.candidates].index("force_bias")
    alike = with_residual(pulled, index, np.full((len(pulled.flights), 3), 0.4))
    both = tuple(range(len(pulled.candidates)))
    sizes = alike.sizes_of_condition(index, both)
    assert alike.gain_of_condition(index, sizes, both, alike.fit(both)) < 1.0
