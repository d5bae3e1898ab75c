# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of sets of effects from Gram matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from quadpi_core.discrepancy.evidence import Block, evidence_at, fit, with_forms

NONE = np.array([], dtype=np.intp)
RESIDUAL, LAW, FORM = range(3)


def block(form=NONE):
    return Block(
        parameters=np.array([LAW]),
        form=form,
        formed_at=1.0,
        offset=None,
        at=np.zeros(1),
        lowest=np.array([0.0]),
        highest=np.array([5.0]),
    )


def gram(law, form, residual):
    columns = np.stack((residual, law, form), axis=1)
    return columns.T @ columns


@pytest.fixture
def shapes():
    rng = np.random.default_rng(0)
    return rng.standard_normal(400), rng.standard_normal(400)


def test_form_columns_that_are_not_needed_cost_no_evidence(shapes):
    law, other = shapes
    found = fit(gram(law, other, 2.0 * law), NONE, [block()])
    assert found.of(np.array([LAW]))[0] == pytest.approx(2.0, rel=0.01)
    with_form = fit(gram(law, other, 2.0 * law), NONE, [block(np.array([FORM]))])
    assert with_form.log_evidence == found.log_evidence
    assert fit(gram(law, other, -2.0 * law), NONE, [block()]) is None


def test_form_columns_that_would_flip_the_sign_of_a_law_are_left_out(shapes):
    law, other = shapes
    # 0.1 law + 0.3 other = 0.6 form − 0.5 law.
    form = law + 0.5 * other
    table = gram(law, form, 0.1 * law + 0.3 * other)
    exact = fit(table, NONE, [block()])
    assert exact is not None
    found = fit(table, NONE, [block(np.array([FORM]))])
    assert found is not None
    assert found.of(np.array([LAW]))[0] == exact.of(np.array([LAW]))[0] > 0.0


def test_evidence_is_the_probability_of_the_residual_without_the_coefficients():
    """r = X b + noise with b, noise ~ N(0, 1): r ~ N(0, 1 + X Xᵀ)."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((30, 4))
    residual = columns[:, :3] @ [0.5, -1.0, 1.5] + rng.standard_normal(30)
    table = np.column_stack((residual, columns))
    tolerances = np.array([1])

    def log_probability(chosen):
        X = table[:, chosen]
        return multivariate_normal.logpdf(residual, cov=np.eye(30) + X @ X.T)

    none = log_probability([1])
    for parameters in ([2], [3, 4], [2, 3, 4]):
        wide = np.full(len(parameters), 99.0)
        effect = Block(np.array(parameters), NONE, 1.0, None, 0.0 * wide, -wide, wide)
        found = fit(table.T @ table, tolerances, [effect])
        gain = found.log_evidence - fit(table.T @ table, tolerances, []).log_evidence
        assert gain == pytest.approx(log_probability([1, *parameters]) - none)
        X = table[:, [1, *parameters]]
        posterior = np.linalg.inv(X.T @ X + np.eye(X.shape[1]))
        np.testing.assert_allclose(found.coefficients, posterior @ X.T @ residual)
        np.testing.assert_allclose(found.covariance, posterior)
        np.testing.assert_allclose(table @ found.left, residual - X @ found.coefficients)
        assert found.deviation(np.array([1, 0])).tolist() == [pytest.approx(posterior[0, 0] ** 0.5), 0.0]


def test_at_its_point_the_evidence_of_a_curved_effect_is_exact():
    """r = f(b) + X c + noise: at b the probability of r − f(b) and of b, whatever the slope of f there."""
    rng = np.random.default_rng(5)
    slope, linear, tolerance = rng.standard_normal((3, 30, 1))
    residual = np.sin(3.0) * slope[:, 0] + 2.0 * linear[:, 0] + rng.standard_normal(30)
    beside = np.eye(30) + linear @ linear.T + tolerance @ tolerance.T
    wide = np.array([99.0])
    found, expected = [], []
    for at in (0.0, 0.4, 1.0, 2.5):
        here = np.sin(3.0 * at) * slope
        column = 3.0 * np.cos(3.0 * at) * slope
        table = np.column_stack((residual, tolerance, linear, column, column * at - here))
        curved = Block(np.array([3]), NONE, 1.0, 4, np.array([at]), -wide, wide)
        other = Block(np.array([2]), NONE, 1.0, None, np.zeros(1), -wide, wide, cost=7.0)
        found.append(evidence_at(table.T @ table, np.array([1]), [other, curved]))
        of_point = multivariate_normal.logpdf(residual - here[:, 0], cov=beside)
        expected.append(of_point - 0.5 * at**2 - 7.0)
    np.testing.assert_allclose(np.diff(found), np.diff(expected))
    alone = evidence_at(table.T @ table, np.array([1]), [replace(other, cost=0.0), curved])
    assert alone - found[-1] == pytest.approx(7.0)


def test_forms_widen_a_posterior_in_proportion_to_the_effect():
    """Without noise worth the name, a law that may be off by 15 % leaves its one parameter as uncertain."""
    rng = np.random.default_rng(4)
    law = rng.standard_normal(400)
    form = 0.15 * law
    table = np.column_stack((0.5 * law, law, form)) * 1e3
    block = Block(np.array([1]), np.array([2]), 1.0, None, np.zeros(1), np.array([-9.0]), np.array([9.0]))
    found = fit(table.T @ table, NONE, [block])
    assert found.columns.tolist() == [1]
    assert found.deviation(np.array([1]))[0] < 1e-3
    free = with_forms(table.T @ table, found, [block])
    assert free.columns.tolist() == [1, 2]
    # The form was made of an effect of size 1, and beside it stands the prior of the parameter.
    expected = 1.0 / np.sqrt(1.0 + 1.0 / (0.15 * 0.5) ** 2)
    assert free.deviation(np.array([1]))[0] == pytest.approx(expected, rel=1e-3)
    again = with_forms(table.T @ table, free, [block])
    assert sorted(again.columns.tolist()) == [1, 2]


def test_a_parameter_beyond_its_bound_is_nothing_and_the_rest_is_fitted_again():
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((200, 2))
    table = np.column_stack((columns @ [1.0, -1.0], columns))
    both = Block(np.array([1, 2]), NONE, 1.0, None, np.zeros(2), np.array([-9.0, 0.0]), np.array([9.0, 9.0]))
    alone = Block(np.array([1]), NONE, 1.0, None, np.zeros(1), np.array([-9.0]), np.array([9.0]))
    bounded, one = (fit(table.T @ table, NONE, [block]) for block in (both, alone))
    assert bounded.of(np.array([2])).tolist() == [0.0]
    np.testing.assert_allclose(bounded.of(np.array([1])), one.of(np.array([1])))


def test_without_an_effect_the_odds_of_a_candidate_are_one_on_average():
    """What the least evidence rests on; a parameter whose bounds leave nothing of it has less."""
    rng = np.random.default_rng(3)
    columns = 0.1 * rng.standard_normal((40, 2))
    odds = np.zeros((4000, 2))
    for own in odds:
        table = np.column_stack((rng.standard_normal(40), columns))
        gram = table.T @ table
        none = fit(gram, NONE, []).log_evidence
        for place, lowest in enumerate((-9.0, 0.0)):
            one = Block(np.array([1]), NONE, 1.0, None, np.zeros(1), np.array([lowest]), np.array([9.0]))
            found = fit(gram, NONE, [one])
            own[place] = 0.0 if found is None else np.exp(found.log_evidence - none)
    assert odds[:, 0].mean() == pytest.approx(1.0, abs=0.03)
    assert odds[:, 1].mean() < 0.9
