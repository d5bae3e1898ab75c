# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Functions that know no physics: places, courses, and what other flights predict of a flight."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.discrepancy.effect_response import Compared, residual
from quadpi_core.discrepancy.simulations import Margins
from quadpi_core.discrepancy.unexplained import (
    as_many_as_stated,
    functions_of_course,
    functions_of_place,
    inside_intervals,
    left_out_gain,
    predicted,
    slow_state_noise,
    stated_squares,
)
from quadpi_core.discrepancy.whitening import Spectrum


def test_points_lie_where_flights_meet_however_far_others_are(simulation, flights):
    """The ground between is ten million points; none of them is asked for."""
    near = [Compared(flight, simulation) for flight in flights[:2]]
    far = Compared(replace(flights[0], position=flights[0].position + np.array([3e3, 3e3, 0])), simulation)
    names, values = functions_of_place(near)
    assert len(names) > 0
    further, spread = functions_of_place([*near, far])
    assert further == names
    for one, other in zip(values, spread, strict=False):
        np.testing.assert_array_equal(one, other)
    assert not spread[-1].any()


def test_shares_of_a_place_are_a_whole_at_most(simulation, flights):
    level = [replace(flight, attitude=np.tile([1.0, 0, 0, 0], (len(flight), 1))) for flight in flights]
    names, values = functions_of_place([Compared(flight, simulation) for flight in level])
    north = np.array(names) == "place north"
    for own in values:
        assert own[:, 0, north].sum(axis=1).max() <= 1.0 + 1e-12
        assert not own[:, 1, north].any()


def test_gain_is_what_a_fit_of_the_other_flights_takes_from_each():
    """Squares of the residual less those after the prediction, flight by flight, with the best ridge."""
    rng = np.random.default_rng(0)
    truth = np.array([1.0, 0.0, -0.5])
    flights = [rng.standard_normal((40, 3)) for _ in range(5)]
    residuals = [X @ truth + rng.standard_normal(40) for X in flights]
    grams = np.array([X.T @ X for X in flights])
    projections = np.array([X.T @ y for X, y in zip(flights, residuals, strict=True)])
    scale = np.diag(np.diag(grams.sum(axis=0)))
    gains = []
    for ridge in (1e-4, 1e-3, 1e-2, 0.1):
        gain = 0.0
        for place, (X, y) in enumerate(zip(flights, residuals, strict=True)):
            rest = [k for k in range(5) if k != place]
            others, theirs = (np.concatenate([of[k] for k in rest]) for of in (flights, residuals))
            fitted = np.linalg.solve(others.T @ others + ridge * scale, others.T @ theirs)
            gain += np.sum(y**2) - np.sum((y - X @ fitted) ** 2)
        gains.append(gain)
    found, coefficients = left_out_gain(grams, projections)
    assert found == pytest.approx(max(gains))
    best = (1e-4, 1e-3, 1e-2, 0.1)[int(np.argmax(gains))]
    total = grams.sum(axis=0) + best * scale
    np.testing.assert_allclose(coefficients, np.linalg.solve(total, projections.sum(axis=0)))


def noise_and_function(size, rows=300, flights=4):
    """Rows of six axes, of noise and in Fx of a function of some size, and spectra of it and two others."""
    rng = np.random.default_rng(1)
    left, spectra = [], []
    for _ in range(flights):
        functions = rng.standard_normal((6, rows, 3))
        residual = rng.standard_normal((6, rows))
        residual[0] += size * functions[0, :, 1]
        left.append(residual)
        spectra.append(Spectrum(functions, np.repeat(np.arange(3), rows // 3)))
    return left, spectra


def test_what_other_flights_predict_is_named_and_is_no_noise():
    left, spectra = noise_and_function(2.0)
    found = predicted(left, spectra, ["one", "two", "three"])
    assert found.functions[0][0] == "two"
    # Two standard deviations of noise in 1200 rows.
    assert found.gain[0] == pytest.approx(4.0 * 1200.0, rel=0.15)
    np.testing.assert_allclose(found.noise.mean(axis=1), 1.0, rtol=0.15)
    assert np.all(np.abs(found.gain[1:]) < 30.0)


def test_noise_is_predicted_by_nothing():
    left, spectra = noise_and_function(0.0)
    assert np.all(predicted(left, spectra, ["one", "two", "three"]).gain < 15.0)


def test_functions_of_course_are_the_airspeed_of_the_world(simulation, flights):
    """Each component of it, and its size, along each axis of the body."""
    compared = Compared(flights[0], simulation)
    names, values = functions_of_course(compared)
    turn = Rotation.from_quat(np.roll(compared.thinned.attitude, -1, axis=1))
    world = turn.apply(compared.states["velocity_air"]) / simulation.vehicle.hover_induced_velocity
    north_in_body = turn.inv().apply([1.0, 0.0, 0.0])
    east_of_north = values[:, :, names.index("flight east along north")]
    np.testing.assert_allclose(east_of_north, world[:, [1]] * north_in_body, atol=1e-9)
    size = values[:, :, names.index("speed down along north")]
    np.testing.assert_allclose(size, np.abs(world[:, [2]]) * north_in_body, atol=1e-9)


@pytest.mark.parametrize(("confidence", "held"), [(0.85, True), (0.95, False)])
def test_an_axis_is_explained_where_intervals_hold_as_much_as_they_say(simulation, flights, confidence, held):
    """Nine tenths of the residual of Fx lie inside, of Fy all, and of the rest nothing."""
    left = [Compared(flight, simulation) for flight in flights[:2]]
    errors = np.abs(np.concatenate([residual(own.flight, simulation) for own in left]))
    wide = np.append([np.quantile(errors[:, 0], 0.9), errors[:, 1].max()], np.zeros(4))

    def margins(flight):
        return Margins(np.tile(-wide, (len(flight), 1)), np.tile(wide, (len(flight), 1)), confidence)

    model = replace(simulation, intervals_of=SimpleNamespace(margins=margins, goes_with_air=True))
    inside = inside_intervals([Compared(flight, model) for flight in flights[:2]])
    np.testing.assert_array_equal(inside.held, [held, True, False, False, False, False])
    np.testing.assert_allclose(inside.shares[:, :2].mean(axis=0), [0.9, 1.0], atol=0.02)
    assert inside.confidence == confidence
    assert inside_intervals(left) is None


def with_intervals(simulation, margins):
    return replace(simulation, intervals_of=SimpleNamespace(margins=margins, goes_with_air=True))


@pytest.mark.parametrize("confidence", [0.6827, 0.95])
def test_intervals_state_the_squares_of_the_errors_that_they_hold(simulation, flights, confidence):
    """Bounds between which a normal error lies as often as they say, not about zero."""
    deviation = np.array([0.3, 0.2, 0.1, 3e-3, 2e-3, 1e-3])
    errors = np.abs(np.random.default_rng(0).standard_normal((200_000, 6)) * deviation)
    half, middle = np.quantile(errors, confidence, axis=0), 0.1 * deviation

    def margins(flight):
        bounds = np.tile(half, (len(flight), 1))
        return Margins(middle - bounds, middle + bounds, confidence)

    compared = [Compared(flight, with_intervals(simulation, margins)) for flight in flights[:2]]
    np.testing.assert_allclose(stated_squares(compared), np.square(deviation), rtol=0.02)


def test_samples_without_an_interval_state_nothing(simulation, flights):
    """Half of the flight has intervals twice as wide, and some samples have none."""

    def margins(flight):
        upper = np.full((len(flight), 6), 1.96)
        upper[: len(flight) // 2] *= 2.0
        upper[::100] = np.nan
        return Margins(-upper, upper, 0.95)

    stated = stated_squares([Compared(flights[0], with_intervals(simulation, margins))])
    np.testing.assert_allclose(stated, 2.5, rtol=0.01)
    assert not stated_squares([Compared(flights[0], simulation)]).any()


def test_slow_errors_of_a_velocity_are_noise_of_slow_bands(simulation, flights):
    """Of a process of first order, 3 cm/s and half a hertz: half of it is left at half a hertz."""
    recorded = replace(flights[0], biases_estimated=False)
    noise = slow_state_noise([Compared(recorded, simulation)], 9)
    assert noise.shape == (6, 9)
    assert np.all(noise[:, 0] > 0.0)
    lower_edges = np.array([0.0, 0.11, 0.3, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0])
    expected = noise[:, :1] / (1.0 + np.square(lower_edges / 0.5))
    np.testing.assert_allclose(noise, expected)
    # Of a comparison up to fewer hertz, the same bands.
    np.testing.assert_array_equal(slow_state_noise([Compared(recorded, simulation)], 4), noise[:, :4])
    smoothed = slow_state_noise([Compared(flights[0], simulation)], 9)
    np.testing.assert_array_equal(smoothed, np.zeros((6, 9)))


def test_a_flight_far_outside_is_noticed_among_many():
    """Of 20 flights; flights that differ a little around what is stated are none."""
    shares = np.full((20, 2), 0.97)
    shares[7, 0] = 0.6
    shares[::4, 1] = 0.84
    np.testing.assert_array_equal(as_many_as_stated(shares, 0.95), [False, True])
