# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Both ensembles: what they learn, cover, refuse, and repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.ensemble import Ensemble
from quadpi_core.models.interval_rules import HeldOutRule, NormalRule, TrainedRule
from quadpi_core.models.kinds.bootstrap import Bootstrap
from quadpi_core.models.kinds.quality_driven import QualityDriven
from quadpi_core.models.model_kind import Fit

from .small_fits import AXIS, FLIGHTS, QUICK, axis_of, fit, interval, noise, prediction, table

pytest.importorskip("torch")

KINDS = (Bootstrap, QualityDriven)


@pytest.fixture(scope="module", params=KINDS)
def fitted(request: pytest.FixtureRequest) -> Fit:
    return fit(request.param(**QUICK), *table(0))


def test_learns_the_target_and_covers_new_flights(fitted: Fit) -> None:
    X, y, _ = table(1, flights=20)
    lower, upper = interval(fitted.fitted, X)
    inside = (lower <= y) & (y <= upper)
    assert np.var(y - prediction(fitted.fitted, X)) < 0.1 * np.var(y)
    # The largest factor of six flights is on the safe side.
    assert 0.93 < inside.mean() < 0.995
    assert inside.reshape(20, -1).mean(axis=1).min() > 0.9
    narrow, wide = noise(X) < 0.1, noise(X) > 0.2
    assert np.mean((upper - lower)[wide]) > 1.05 * np.mean((upper - lower)[narrow])


def test_more_confidence_is_a_wider_interval_around_the_prediction(fitted: Fit) -> None:
    X = table(2)[0]
    lower, upper = interval(fitted.fitted, X, 0.8)
    wider_lower, wider_upper = interval(fitted.fitted, X, 0.95)
    assert np.all((wider_lower < lower) & (upper < wider_upper))
    np.testing.assert_allclose(0.5 * (lower + upper), prediction(fitted.fitted, X))


def test_every_flight_calibrates_while_it_is_left_out(fitted: Fit) -> None:
    rule = axis_of(fitted).rule
    assert isinstance(rule, HeldOutRule)
    assert (len(rule.flight_factors), rule.flights_inside) == (FLIGHTS, FLIGHTS)
    covered = rule.held_out_coverage(fitted.held_out[AXIS], 0.95)
    assert covered.shape == (FLIGHTS,)
    assert np.all(covered > 0.85)


@pytest.mark.parametrize("kind", KINDS)
def test_repeats_for_a_seed_and_differs_for_another(kind: type[Ensemble]) -> None:
    X, y, flights = table(3)
    few = QUICK | {"epochs": 2, "folds": 0}
    one, again, other = (
        prediction(fit(kind(**few, seed=seed), X, y, flights).fitted, X) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, other)


@pytest.mark.parametrize(("kind", "rule"), [(Bootstrap, NormalRule()), (QualityDriven, TrainedRule(0.9))])
def test_settings_of_the_paper(kind: Any, rule: Any) -> None:
    """Ten members of twenty units, samples split, nothing calibrated, bounds for one confidence."""
    X, y, flights = table(4)
    paper = fit(kind(epochs=3), X, y, flights, settings="paper", confidence=0.9)
    assert axis_of(paper).members.hidden_weights.shape == (10, 20, 3)
    assert axis_of(paper).rule == rule
    assert not paper.held_out
    lower, upper = interval(paper.fitted, X, 0.9)
    assert np.all(lower < upper)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X, y, flights: (X, np.full_like(y, 2.0), flights), f"{AXIS}: .*constant"),
        (lambda X, y, flights: (X, y, np.zeros_like(flights)), "one flight"),
    ],
)
def test_what_cannot_be_learned_from_is_refused(kind: type[Ensemble], change: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        fit(kind(**QUICK), *change(*table(7)))
