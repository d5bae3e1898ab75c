# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The regression of a search: its fits, its noise, and how it is linearised."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtri

from quadpi_core.discrepancy.acceptance import Accepted
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import Compared, body_tolerances, share_of_wrench
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.simulations import Margins
from quadpi_core.discrepancy.whitening import rows_of
from quadpi_core.errors import DiscrepancyError

from .regressions import (
    PAYLOAD,
    of_sound_flights,
    regression_of,
    rows,
    rows_in,
)

BLOWN = np.array([0.8, -0.5, 0.0])


def test_residual_and_tolerances_are_in_frequency(sounded):
    for place, flight in enumerate(sounded.flights):
        wrenches = [flight.residual, *(own.wrench for own in flight.uncertain())]
        found = np.dstack([rows(columns, place) for columns in sounded.base])
        np.testing.assert_allclose(found, flight.spectrum(np.dstack(wrenches)).rows, atol=1e-12)
    assert sounded.tolerances.names == tuple(own.name for own in flight.uncertain())


@pytest.mark.parametrize("sought", [["payload", "wind"], ["wind"]])
def test_the_residual_is_less_what_sound_flights_leave(sounded, simulation, flights, sought):
    """Whether it is looked for or not; what it may deviate by is noise of each flight."""
    known = of_sound_flights(simulation, ("payload", "mass_kg"))
    less = regression_of(known, flights[:2], sought)
    (own,) = less.noise.own
    for place in range(2):
        payload = rows(sounded.blocks[PAYLOAD].columns, place) / sounded.candidates[PAYLOAD].scale
        expected = rows(sounded.residual, place) - 0.02 * payload
        np.testing.assert_allclose(rows(less.residual, place), expected, atol=1e-9)
        deviations = rows(own.columns, place) @ own.deviations[place]
        np.testing.assert_allclose(deviations, payload * [0.01 * np.sqrt(2.0), 0.003], atol=1e-9)


def test_an_error_of_an_effect_that_is_not_known_is_refused(simulation, flights):
    with pytest.raises(DiscrepancyError, match=r"^bebop2: knows an error of warp, which is no effect here"):
        regression_of(of_sound_flights(simulation, ("warp", "mass_kg")), flights[:1], [])


def test_the_chosen_are_made_of_the_simulation_with_its_coefficients_as_fitted(simulation, flights):
    """Wind and a rotor's tilt, at their points; of a payload nothing changes, though all are chosen."""
    chosen = {own.label: own for own in candidates(simulation.vehicle, ["rotor_tilt", "wind", "payload"])}
    order = [chosen["rotor_tilt (rotor 2)"], chosen["wind"], chosen["payload"]]
    points = {0: np.array([2.0, -1.0]), 1: np.array([1.0, 0.5, 0.2])}

    def moved(own):
        compared = [Compared(flight.slice(slice(0, 1000)), own) for flight in flights[:2]]
        return Regression.from_flights(compared, order).moved(points)

    off = {"thrust": 5.0, "rotor_force_along": -3.0}
    before, expected = moved(simulation), moved(simulation.with_coefficients(off))
    coefficients = np.array([off.get(name, 0.0) for name in before.tolerances.names])
    remade = before.with_fitted_coefficients((0, 1, 2), replace(before.fit(()), coefficients=coefficients))
    assert (remade.base, remade.blocks[2]) == (before.base, before.blocks[2])
    # A tilt has no columns of its form.
    (tilt, wind), theirs = remade.blocks[:2], expected.blocks
    for mine, same in (
        (tilt.columns, theirs[0].columns),
        (wind.columns, theirs[1].columns),
        (wind.form, theirs[1].form),
    ):
        np.testing.assert_allclose(rows(mine, 1), rows(same, 1), atol=1e-12)
    # Moved again, they are still made of it.
    there = {1: points[1] + 0.5}
    again = rows(remade.moved(there).blocks[1].columns, 1)
    np.testing.assert_allclose(again, rows(expected.moved(there).blocks[1].columns, 1), atol=1e-12)
    assert not np.allclose(again, rows(before.moved(there).blocks[1].columns, 1), rtol=1e-3, atol=0.0)
    # Five tolerances of thrust.
    stated = np.linalg.norm(rows(before.blocks[0].columns, 0))
    assert np.linalg.norm(rows(tilt.columns, 0)) == pytest.approx(1.05 * stated, rel=0.01)


def test_other_accelerations_change_the_columns_of_mass_and_inertia_alone(sounded, simulation):
    """They are those of the quiet simulation and of what a fit adds to it."""
    fit = sounded.fit(())
    moved = sounded.accelerated(fit)
    assert (moved.residual, *moved.blocks[::2]) == (sounded.residual, *sounded.blocks[::2])
    assert moved.tolerances.coefficients is sounded.tolerances.coefficients
    vehicle, payload = simulation.vehicle, sounded.candidates[PAYLOAD]
    share = share_of_wrench(payload.effect, vehicle, 1e-3 * payload.scale) / 1e-3
    shares = [
        share_of_wrench(effect, vehicle, values) if effect.kind == "vehicle" else np.zeros((6, 6))
        for effect, deviation in body_tolerances(simulation)
        for values in deviation * np.eye(len(effect.parameters))
    ]
    for place, flight in enumerate(sounded.flights):
        added = rows(sounded.residual, place)[:, :, 0] - rows_of(fit.residual(), place)
        explained = rows_in(sounded, place, flight.quiet_wrench[:: flight.step]) + added
        change = explained - rows_in(sounded, place, flight.expected_measured)
        payloads, bodies = (
            rows(now, place) - rows(before, place)
            for now, before in (
                (moved.blocks[PAYLOAD].columns, sounded.blocks[PAYLOAD].columns),
                (moved.tolerances.body, sounded.tolerances.body),
            )
        )
        np.testing.assert_allclose(payloads[:, :, 0], share @ change, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(bodies, np.dstack([own @ change for own in shares]), atol=1e-9)


@pytest.fixture(scope="module")
def regression(found):
    """Of flights with drag of the airframe."""
    return found.discovery.found.regression


@pytest.fixture(scope="module")
def drag(regression):
    """Index of the effect that is there."""
    return [own.name for own in regression.candidates].index("body_drag")


def test_what_an_effect_adds_is_counted_in_variances_of_the_noise(regression, drag):
    fit, variance = regression.fit((drag,), form=False), regression.noise.variance
    found = regression.found(drag, fit)
    np.testing.assert_allclose(regression.parameters(drag, fit), found * regression.candidates[drag].scale)
    assert regression.size(drag, fit) == np.abs(found).max()
    squares, loud, reduced = np.zeros(6), np.zeros((2, 6)), np.zeros(6)
    for place, left in enumerate(regression.left(fit)):
        noise = variance[place][:, regression.residual.spectra[place].band]
        added = rows(regression.blocks[drag].columns, place) @ found
        squares += np.sum(added**2 / noise, axis=1)
        reduced += np.sum(((left + added) ** 2 - left**2) / noise, axis=1)
        loud += np.sum((added**2, noise), axis=2)
    assert regression.energy((drag,), fit) == pytest.approx(0.5 * squares.sum())
    np.testing.assert_allclose(regression.reduction((drag,), fit, variance).fitted, reduced, atol=1e-6)
    assert regression.loudness(drag, fit) == pytest.approx(np.sqrt(np.max(loud[0] / loud[1])))


def test_what_coefficients_undo_speaks_for_no_effect(regression, drag):
    """Drag of a hundred times its size, and coefficients that take away what is too much of it."""
    fit = regression.fit((drag,), form=False)
    honest = regression.reduction((drag,), fit)
    assert honest.credited[:2].min() > 0.0
    np.testing.assert_allclose(honest.credited[:2], honest.fitted[:2], rtol=0.3)
    along = rows(regression.blocks[drag].columns, 0) @ regression.found(drag, fit)
    undoing = np.dstack([rows(own, 0) for own in regression.base[1:]])
    undone = np.linalg.lstsq(undoing.reshape(along.size, -1), along.ravel(), rcond=None)[0]
    weights = fit.left.copy()
    weights[-3:] *= 100.0
    weights[1:-3] += 99.0 * undone
    cancelled = regression.reduction((drag,), replace(fit, left=weights))
    assert cancelled.fitted[:2].min() > 10.0 * honest.fitted[:2].max()
    assert cancelled.credited[:2].max() < 0.0


def test_noise_beside_an_effect_is_no_less_than_what_it_leaves_and_no_more_than_there_was(regression, drag):
    fit = regression.fit((drag,))
    noise = regression.beside((drag,), fit).noise.variance
    left = regression.band_means(regression.left(fit))
    before = regression.band_means([rows(regression.residual, k)[:, :, 0] for k in range(4)])
    assert np.all(noise >= (1.0 - 1e-9) * np.minimum(left, before))
    assert np.all(noise <= (1.0 + 1e-9) * before)
    assert np.any(noise < 0.5 * before)


def test_what_a_model_states_may_be_in_any_band(regression, drag):
    """Of each axis it is the least noise, beside an effect as well; so an effect gains less by it."""
    stated = np.array([0.2, 0.2, 0.4, 1e-2, 1e-2, 1e-3])

    class Stating(type(regression.flights[0].simulation)):
        def margins(self, flight):
            half = float(ndtri(0.975)) * np.broadcast_to(stated, (len(flight), 6))
            return Margins(-half, half, 0.95)

    simulation = Stating(**vars(regression.flights[0].simulation))
    flights = [own.compared_with(simulation) for own in regression.flights]
    model = Regression.from_flights(flights, regression.candidates)
    rows_of_bands = sum(np.bincount(own.band) for own in model.residual.spectra)
    expected = np.square(stated)[:, None] * rows_of_bands.sum() / rows_of_bands
    fit = model.fit((drag,))
    assert np.all(model.noise.variance >= (1.0 - 1e-9) * expected)
    assert np.all(model.beside((drag,), fit).noise.variance >= (1.0 - 1e-9) * expected)
    assert fit.log_evidence - model.fit(()).log_evidence < 0.2 * (
        regression.fit((drag,)).log_evidence - regression.fit(()).log_evidence
    )


def test_a_curved_effect_is_linearised_where_it_fits_best(simulation, flights):
    """In a wind that nothing measured: the simulation thinks it flies through still air."""
    unaware = [replace(own, wind=own.wind - BLOWN) for own in flights[:2]]
    start = regression_of(simulation, unaware, ["wind"])
    regression = Accepted(start, (0,), start.fit((0,))).refined().regression
    (wind,), fit = regression.candidates, regression.fit((0,))
    np.testing.assert_allclose(regression.points[0], BLOWN, atol=0.1)
    refined = Accepted(regression, (0,), fit).refined()
    better, fit = refined.regression, refined.fit
    values = better.parameters(0, fit)
    np.testing.assert_allclose(values, BLOWN, atol=0.1)
    assert not better.moves(0, fit, values)
    assert better.at_points((0,)) >= regression.at_points((0,))
    # About another point than zero, what it adds is its columns less what the linearisation adds.
    for place, flight in enumerate(better.flights):
        exact = rows_in(better, place, flight.added(wind.effect, wind.values(values)))
        off = rows_of(better.added((0,), fit), place) - exact
        assert np.linalg.norm(off) < 0.02 * np.linalg.norm(exact)


def test_an_effect_is_linearised_anew_where_it_is_moved_by_more_than_is_unsure(simulation, flights):
    """By two standard deviations of its fit; the first time however little, as its form needs a size."""
    regression = regression_of(simulation, flights[:2], ["wind"])
    wind, fit = regression.moved({0: np.array([0.5, -0.2, 0.1])}), regression.fit((0,))
    unsure = wind.deviation(0, wind.fit((0,))) * wind.candidates[0].scale
    for deviations, moves in ((1.9, False), (2.1, True)):
        assert wind.moves(0, wind.fit((0,)), wind.points[0] + [0.0, deviations * unsure[1], 0.0]) == moves
    assert regression.moves(0, fit, np.full(3, 1e-9))


class Overshooting:
    """A regression of one curved effect that is best at 1, whose fits go three times as far as that."""

    candidates = (SimpleNamespace(linear=False, scale=np.ones(1)),)

    def __init__(self, at=0.0):
        self.points = (np.array([at]),)

    def moves(self, *_):
        return True

    def moved(self, points):
        return Overshooting(*points.get(0, self.points[0]))

    def fit(self, chosen, **_):
        return Fit(0.0, (), np.array(chosen), np.ones(1), np.eye(1), np.zeros(1))

    def at_points(self, _):
        return -(float(self.points[0][0] - 1.0) ** 2)

    def parameters(self, *_):
        return self.points[0] + 3.0 * (1.0 - self.points[0])


def test_a_step_that_overshoots_is_halved():
    """To 3, back to 1.5, which is better than 0, and not to 0 again."""
    start = Overshooting()
    best = Accepted(start, (0,), start.fit((0,))).refined()
    assert best.regression.points[0] == 1.5
