# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of sets of effects beside the normal distribution of the residual; what flights have of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.effect_regression import left_out_squares
from quadpi_core.discrepancy.evidence import Block, Condition, Equations

from .dense_noise import Normal, random_columns, random_noise, stacked
from .regressions import DRAG, VARIANCE, of_sound_flights, regression_of, rows

WIDE = 99.0


def block_of(columns, *, at=None, lowest=-WIDE, highest=WIDE, **changes):
    """Of columns of k parameters about zero, or of a curved effect about a point."""
    at = np.zeros(columns.width) if at is None else np.array(at)
    return Block(columns, at, lowest + 0.0 * at, highest + 0.0 * at, **changes)


class Flights:
    """Two flights whose residual is noise, partly of their own, and columns times weights; two tolerances."""

    def __init__(self, *weights):
        rng = np.random.default_rng(0)
        self.noise = random_noise(rng)
        self.residual, *self.tolerances = (random_columns(rng, width) for width in (1, 2, 0))
        self.columns = [random_columns(rng, len(own)) for own in weights]
        for columns, own in zip(self.columns, weights, strict=True):
            rows = [flight.rows @ np.array(own)[:, None] for flight in columns.spectra]
            self.residual = self.residual.plus(rows.__getitem__)

    def equations(self, *blocks, formed=()):
        return Equations.from_columns((self.residual, *self.tolerances), blocks, self.noise, formed)

    def normal(self, *columns, less=(), places=(0, 1), prior=1.0):
        """Of these columns, and a residual less those that are held at some weights."""
        residual = self.residual
        for own, weights in less:
            rows = [flight.rows @ np.array(weights)[:, None] for flight in own.spectra]
            residual = residual.plus(lambda place, rows=rows: -rows[place])
        return Normal.of(self.noise, residual, columns, places, prior)

    def left(self, fit, places=(0, 1)):
        """Rows (R,) after a fit."""
        return sum(stacked([part.columns], places) @ part.weights for part in fit.residual())


@pytest.mark.parametrize("chosen", [(0,), (1,), (0, 1)])
def test_evidence_is_the_density_of_the_residual_without_the_coefficients(chosen):
    """r = X b + n with b ~ N(0, 1): r ~ N(0, N + X Xᵀ)."""
    flights = Flights([1.0], [0.0, 0.0])
    columns = [flights.columns[k] for k in chosen]
    fitted = (*flights.tolerances, *columns)
    equations = flights.equations(*map(block_of, columns))
    found, none = equations.fit(), flights.equations().fit()
    expected, without = flights.normal(*fitted), flights.normal(*flights.tolerances)
    gain = expected.log_density - without.log_density
    assert found.log_evidence - none.log_evidence == pytest.approx(gain)
    np.testing.assert_allclose(np.concatenate([found.of(own) for own in fitted]), expected.mean)
    deviations = np.concatenate([found.deviation(own) for own in fitted])
    np.testing.assert_allclose(np.square(deviations), np.diag(expected.covariance))
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-12)
    own = np.isin(found.fitted, equations.parameters(0))
    np.testing.assert_array_equal(found.coefficients[own], found.of(columns[0]))
    np.testing.assert_allclose(flights.left(found), expected.left, atol=1e-12)
    kept = [part.columns for part in found.residual(without=flights.tolerances)]
    assert kept == [flights.residual, *columns]
    assert not none.of(columns[0]).any()


def test_at_its_point_the_evidence_of_a_curved_effect_is_exact():
    """r = f(b) + X c + n: at b the density of r − f(b) and of b, whatever the slope of f there."""
    flights = Flights([np.sin(3.0)], [2.0])
    slope, linear = flights.columns
    beside = flights.equations().fit().log_evidence - flights.normal(*flights.tolerances).log_density
    for at in (0.0, 0.4, 1.0, 2.5):
        here, column = np.sin(3.0 * at), 3.0 * np.cos(3.0 * at)
        rows = [own.rows * [column, column * at - here] for own in slope.spectra]
        curved = block_of(slope.like(rows.__getitem__), at=[at])
        found = flights.equations(block_of(linear, cost=7.0), curved).at_points()
        density = flights.normal(*flights.tolerances, linear, less=[(slope, [here])]).log_density
        assert found == pytest.approx(density - 0.5 * at**2 - 7.0 + beside)


@pytest.mark.parametrize("off", [0.0, 1.0])
def test_the_error_of_a_form_has_a_prior_in_proportion_to_the_size_of_the_effect(off):
    """A form that is not needed costs no evidence."""
    flights = Flights([3.0, -1.0], [2.0 * off, off, -3.0 * off])
    law, form = flights.columns
    block = block_of(law, form=form, formed_at=2.0)
    equations = flights.equations(block, formed=(block,))
    found, exact, none = equations.fit(), flights.equations(block).fit(), flights.equations().fit()
    prior = np.repeat([1.0, np.square(np.linalg.norm(exact.of(law)) / 2.0)], [4, 3])
    expected = flights.normal(*flights.tolerances, law, form, prior=prior)
    beside = equations.with_forms(exact)
    np.testing.assert_allclose(beside.coefficients, expected.mean)
    np.testing.assert_allclose(beside.covariance, expected.covariance, atol=1e-12)
    assert len(equations.with_forms(beside).fitted) == len(beside.fitted)
    gain = expected.log_density - flights.normal(*flights.tolerances).log_density
    assert (found.log_evidence > exact.log_evidence) == bool(off)
    least = exact.log_evidence - none.log_evidence
    assert found.log_evidence - none.log_evidence == pytest.approx(max(gain, least))


@pytest.mark.parametrize(("law", "kept"), [(3.0, True), (1.0, False)])
def test_a_law_that_its_errors_outdo_is_refuted_where_the_noise_is_known(law, kept):
    """A curved law brings its column of the residual."""
    flights = Flights([law, 0.0], [2.0, -1.0])
    columns, form = flights.columns
    block = block_of(columns, at=[law], form=form, formed_at=1.0)
    assert block.curved
    equations = flights.equations(block, formed=(block,))
    bent, exact, none = equations.fit(), flights.equations(block).fit(), flights.equations().fit()
    added, of_law = bent.log_evidence - exact.log_evidence, exact.log_evidence - none.log_evidence
    assert (0.0 < added <= of_law) == kept
    known = equations.fit(known=True)
    assert (known is not None) == kept
    assert not kept or known.log_evidence == bent.log_evidence


def test_a_parameter_beyond_its_bound_is_nothing_and_the_rest_is_fitted_again():
    """A set whose effect has nothing else does not fit; a form that would drive it there is left out."""
    flights = Flights([5.0, -5.0], [30.0])
    both, other = flights.columns
    first = both.like(lambda place: both.spectra[place].rows[:, :, :1])
    bounded = flights.equations(block_of(both, lowest=0.0)).fit()
    alone = flights.equations(block_of(first)).fit()
    np.testing.assert_allclose(bounded.of(both), [alone.of(first)[0], 0.0])
    np.testing.assert_allclose(bounded.deviation(both), [alone.deviation(first)[0], 0.0])
    assert bounded.log_evidence == pytest.approx(alone.log_evidence)
    assert flights.equations(block_of(first, highest=0.0)).fit() is None
    # 5 law + 30 other = 60 form − 55 law.
    form = first.like(lambda place: first.spectra[place].rows + 0.5 * other.spectra[place].rows)
    block = block_of(first, lowest=0.0, form=form)
    equations = flights.equations(block, formed=(block,))
    assert equations.with_forms(alone).of(first)[0] < 0.0
    assert equations.fit().of(first)[0] == alone.of(first)[0] > 0.0


def test_a_flight_is_left_out_as_if_it_had_never_been_there():
    """Of the columns of another fit too, whatever bounds say; one that these exclude there hides no other."""
    flights = Flights([5.0, -5.0], [30.0])
    effect, other = flights.columns
    expected = flights.normal(*flights.tolerances, effect, places=(1,)).mean
    equations = flights.equations(block_of(effect))
    np.testing.assert_allclose(equations.fit(without=0).coefficients, expected)
    mean = equations.fit().of(effect)
    narrow = flights.equations(block_of(effect, lowest=mean - 1e-9, highest=mean + 1e-9))
    both = flights.equations(narrow.blocks[0], block_of(other)).fit(without=0)
    alone = flights.equations(block_of(other)).fit(without=0)
    np.testing.assert_array_equal(both.of(effect), [0.0, 0.0])
    np.testing.assert_allclose(both.of(other), alone.of(other))
    np.testing.assert_allclose(narrow.refit(narrow.fit(), 0).coefficients, expected)


@pytest.mark.parametrize(("adjusted", "places"), [(True, (0, 1)), (False, (0, 1)), (True, (0,))])
def test_forms_and_tolerances_are_fitted_beside_fixed_parameters(adjusted, places):
    flights = Flights([4.0], [1.0, 1.0])
    law, form = flights.columns
    block = block_of(law, form=form, formed_at=2.0)
    fixed = flights.equations(block).fit()
    without = None if places == (0, 1) else 1
    found = flights.equations(block, formed=(block,)).fit_forms(fixed, adjusted=adjusted, without=without)
    prior = np.repeat([1.0, np.square(fixed.of(law)[0] / 2.0)], [2 * adjusted, 2])
    fitted = (*flights.tolerances * adjusted, form)
    expected = flights.normal(*fitted, prior=prior, less=[(law, fixed.of(law))], places=places)
    np.testing.assert_allclose(np.concatenate([found.of(own) for own in fitted]), expected.mean)
    np.testing.assert_allclose(flights.left(found, places), expected.left, atol=1e-10)


# --- What single flights have of their own

BIAS = 1


@pytest.fixture(scope="module")
def pulled(simulation, flights):
    """Of 2 s of four flights, on drag and a constant force, beside a simulation whose noise is known."""
    return regression_of(of_sound_flights(simulation), flights, ["body_drag", "force_bias"], samples=250)


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


def test_what_half_of_the_flights_lack_is_not_shared(pulled):
    """Those that have it have it of their own: no effect explains it beside that."""
    changed = with_forces(pulled, np.array([[x, 0.4, 0.0] for x in (0.0, 0.0, 0.8, 0.9)]))
    sizes = changed.sizes_of_condition(BIAS, ())
    assert sizes[2:, 0].min() > 0.5
    assert sizes[:2, 0].max() < 0.2
    conditioned = changed.with_condition(Condition(BIAS, sizes))
    assert conditioned.found(BIAS, conditioned.fit((BIAS,)))[:2] == pytest.approx([0.0, 0.4], abs=0.1)


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
