# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of sets of effects beside the probability density of the residual of all flights together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from quadpi_core.discrepancy.evidence import Block, Equations

from .dense_noise import ROWS, covariance, random_columns, random_noise, told

PLACES = range(len(ROWS))


def block_of(columns, *, at=None, lowest=-99.0, highest=99.0, **changes):
    """Of columns of k parameters about zero, or of a curved effect about a point."""
    at = np.zeros(columns.width) if at is None else np.array(at)
    return Block(columns, at, np.full(len(at), lowest), np.full(len(at), highest), **changes)


class Flights:
    """Two flights with a residual, two tolerances and further columns, in noise that is partly their own."""

    def __init__(self, *widths, seed=0):
        rng = np.random.default_rng(seed)
        self.noise = random_noise(rng, held=(4,))
        residual, *self.tolerances = (random_columns(rng, width) for width in (1, 2, 0))
        self.columns = [random_columns(rng, width) for width in widths]
        self.residual = residual

    def added(self, columns, weights):
        """The flights with columns (k,) times weights (k,) more in their residual."""
        more = [own.rows @ np.array(weights)[:, None] for own in columns.spectra]
        self.residual = self.residual.plus(lambda place: more[place])
        return self

    def equations(self, *blocks, formed=()):
        return Equations.of((self.residual, *self.tolerances), blocks, self.noise, formed)

    def matrix(self, *columns, places=PLACES):
        """Matrix (R, k) of columns, those of flights below each other."""
        rows = [np.hstack([told(self.noise, own, place) for own in columns]) for place in places]
        return np.vstack(rows)

    def covariance(self, places=PLACES):
        return block_diag(*(covariance(self.noise, ROWS[place], place) for place in places))

    def log_density(self, *columns, residual=None, prior=None):
        """Of the residual, whose columns beside the tolerances have a prior variance (k,)."""
        x = self.matrix(*self.tolerances, *columns)
        prior = np.ones(x.shape[1]) if prior is None else np.append([1.0, 1.0], prior)
        residual = self.matrix(self.residual)[:, 0] if residual is None else residual
        return multivariate_normal.logpdf(residual, cov=self.covariance() + x * prior @ x.T)

    def posterior(self, *columns, residual=None, prior=1.0, places=PLACES):
        """Mean (k,) and covariance (k, k) of columns with a prior variance (k,)."""
        x = self.matrix(*columns, places=places)
        residual = self.matrix(self.residual, places=places)[:, 0] if residual is None else residual
        weighed = np.linalg.solve(self.covariance(places), x)
        found = np.linalg.inv(x.T @ weighed + np.diag(np.ones(x.shape[1]) / prior))
        return found @ weighed.T @ residual, found


@pytest.mark.parametrize("chosen", [(0,), (1,), (0, 1)])
def test_evidence_is_the_probability_of_the_residual_without_the_coefficients(chosen):
    """r = X b + n with b ~ N(0, 1): r ~ N(0, N + X Xᵀ)."""
    flights = Flights(1, 2)
    columns = [flights.columns[k] for k in chosen]
    equations = flights.equations(*map(block_of, columns))
    found, none = equations.fit(), flights.equations().fit()
    gain = flights.log_density(*columns) - flights.log_density()
    assert found.log_evidence - none.log_evidence == pytest.approx(gain)
    fitted = (*flights.tolerances, *columns)
    mean, open_ = flights.posterior(*fitted)
    np.testing.assert_allclose(np.concatenate([found.of(own) for own in fitted]), mean)
    deviations = np.concatenate([found.deviation(own) for own in fitted])
    np.testing.assert_allclose(deviations, np.sqrt(np.diag(open_)))
    np.testing.assert_allclose(found.covariance, open_, atol=1e-12)
    np.testing.assert_allclose(found.coefficients[equations.parameters(0) - 1], found.of(columns[0]))
    left = sum(flights.matrix(part.columns) @ part.weights for part in found.residual())
    residual = flights.matrix(flights.residual)[:, 0]
    np.testing.assert_allclose(left, residual - flights.matrix(*fitted) @ mean, atol=1e-12)
    parts = [part.columns for part in found.residual(without=flights.tolerances)]
    assert parts == [flights.residual, *columns]
    # What was not fitted.
    assert not none.of(columns[0]).any()


def test_at_its_point_the_evidence_of_a_curved_effect_is_exact():
    """r = f(b) + X c + n: at b the probability of r − f(b) and of b, whatever the slope of f there."""
    flights = Flights(1, 1)
    slope, linear = flights.columns
    flights.added(slope, [np.sin(3.0)]).added(linear, [2.0])
    values = []
    for at in (0.0, 0.4, 1.0, 2.5):
        here, column = np.sin(3.0 * at), 3.0 * np.cos(3.0 * at)
        rows = [own.rows * [column, column * at - here] for own in slope.spectra]
        curved = block_of(slope.like(rows.__getitem__), at=[at])
        found = flights.equations(block_of(linear, cost=7.0), curved).at_points()
        left = flights.matrix(flights.residual)[:, 0] - here * flights.matrix(slope)[:, 0]
        density = flights.log_density(linear, residual=left)
        values.append(found - (density - 0.5 * at**2 - 7.0))
    np.testing.assert_allclose(values, flights.equations().fit().log_evidence - flights.log_density())


def test_the_error_of_a_form_has_a_prior_in_proportion_to_the_size_of_the_effect():
    """As far as it explains anything; else it costs nothing."""
    flights = Flights(2, 3)
    law, form = flights.columns
    flights.added(law, [3.0, -1.0])
    block = block_of(law, form=form, formed_at=2.0)
    exact, equations = flights.equations(block_of(law)).fit(), flights.equations(block, formed=(block,))
    assert equations.fit().log_evidence == exact.log_evidence
    prior = np.repeat([1.0, np.square(np.linalg.norm(exact.of(law)) / 2.0)], [2, 3])
    mean, open_ = flights.posterior(*flights.tolerances, law, form, prior=np.append([1.0, 1.0], prior))
    beside = equations.with_forms(exact)
    np.testing.assert_allclose(beside.coefficients, mean)
    np.testing.assert_allclose(beside.covariance, open_, atol=1e-12)
    assert len(equations.with_forms(beside).fitted) == len(beside.fitted)
    flights.added(form, [2.0, 1.0, -3.0])
    none, exact = flights.equations().fit(), flights.equations(block_of(law)).fit()
    found = flights.equations(block, formed=(block,)).fit()
    prior[2:] = np.square(np.linalg.norm(exact.of(law)) / 2.0)
    gain = flights.log_density(law, form, prior=prior) - flights.log_density()
    assert found.log_evidence - none.log_evidence == pytest.approx(gain)
    assert found.log_evidence > exact.log_evidence


def test_a_parameter_beyond_its_bound_is_nothing_and_the_rest_is_fitted_again():
    flights = Flights(2)
    (both,) = flights.columns
    flights.added(both, [5.0, -5.0])
    first, bounded = both.first(1), flights.equations(block_of(both, lowest=0.0)).fit()
    alone = flights.equations(block_of(first)).fit()
    np.testing.assert_allclose(bounded.of(both), [alone.of(first)[0], 0.0])
    np.testing.assert_allclose(bounded.deviation(both), [alone.deviation(first)[0], 0.0])
    assert bounded.log_evidence == pytest.approx(alone.log_evidence)
    assert flights.equations(block_of(first, highest=0.0)).fit() is None


def test_forms_that_would_flip_the_sign_of_a_law_are_left_out():
    flights = Flights(1, 1)
    law, other = flights.columns
    # 1 law + 3 other = 6 form − 5 law.
    form = law.like(lambda place: law.spectra[place].rows + 0.5 * other.spectra[place].rows)
    flights.added(law, [10.0]).added(other, [30.0])
    block = block_of(law, lowest=0.0, form=form)
    exact, found = (flights.equations(block, formed=formed).fit() for formed in ((), (block,)))
    assert found.of(law)[0] == exact.of(law)[0] > 0.0
    assert flights.equations(block, formed=(block,)).with_forms(exact).of(law)[0] < 0.0


def test_a_flight_is_left_out_as_if_it_had_never_been_there():
    """Of the same columns too, whatever bounds say."""
    flights = Flights(2)
    (effect,) = flights.columns
    flights.added(effect, [5.0, -5.0])
    fitted = (*flights.tolerances, effect)
    expected, _ = flights.posterior(*fitted, places=(1,))
    equations = flights.equations(block_of(effect))
    np.testing.assert_allclose(equations.fit(without=0).coefficients, expected)
    mean = equations.fit().of(effect)
    near = replace(block_of(effect), lowest=mean - 1e-9, highest=mean + 1e-9)
    narrow = flights.equations(near)
    assert narrow.fit(without=0) is None
    np.testing.assert_allclose(narrow.refit(narrow.fit(), 0).coefficients, expected)


@pytest.mark.parametrize(("adjusted", "without"), [(True, None), (False, None), (True, 1)])
def test_forms_and_tolerances_are_fitted_beside_fixed_parameters(adjusted, without):
    flights = Flights(1, 2)
    law, form = flights.columns
    flights.added(law, [4.0]).added(form, [1.0, 1.0])
    block = block_of(law, form=form, formed_at=2.0)
    fixed = flights.equations(block_of(law)).fit()
    found = flights.equations(block, formed=(block,)).fit_forms(fixed, adjusted=adjusted, without=without)
    places = [place for place in PLACES if place != without]
    residual = flights.matrix(flights.residual, places=places)[:, 0]
    residual = residual - flights.matrix(law, places=places) @ fixed.of(law)
    prior = np.repeat([1.0, np.square(fixed.of(law)[0] / 2.0)], [2 * adjusted, 2])
    fitted = (*flights.tolerances[: 2 * adjusted], form)
    mean, _ = flights.posterior(*fitted, residual=residual, prior=prior, places=places)
    np.testing.assert_allclose(found.coefficients, mean)
    assert len(found.of(flights.tolerances[0])) == 2
    assert adjusted == found.of(flights.tolerances[0]).any()
    # What is left is the residual less all of them.
    left = sum(flights.matrix(part.columns, places=places) @ part.weights for part in found.residual())
    np.testing.assert_allclose(left, residual - flights.matrix(*fitted, places=places) @ mean, atol=1e-10)
