# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Both ensembles as estimators of a table: what they learn, cover, refuse, and repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.ensemble_estimator import Ensemble, fit_axes
from quadpi_core.models.interval_rules import HeldOutRule, NormalRule, TrainedRule
from quadpi_core.models.kinds.bootstrap import BootstrapEnsemble
from quadpi_core.models.kinds.quality_driven import QualityDrivenEnsemble

from .small_ensembles import FLIGHTS, QUICK, noise, table

pytest.importorskip("torch")

KINDS = (BootstrapEnsemble, QualityDrivenEnsemble)


@pytest.fixture(scope="module", params=KINDS)
def fitted(request: pytest.FixtureRequest) -> Ensemble:
    estimator: Ensemble = request.param(**QUICK)
    return estimator.fit(*table(0))


def test_learns_the_target_and_covers_new_flights(fitted: Ensemble) -> None:
    X, y, _ = table(1, flights=20)
    lower, upper = fitted.predict_interval(X, 0.95)
    inside = (lower <= y) & (y <= upper)
    assert fitted.score(X, y) > 0.9
    # The largest factor of six flights is on the safe side.
    assert 0.93 < inside.mean() < 0.995
    assert inside.reshape(20, -1).mean(axis=1).min() > 0.9
    narrow, wide = noise(X) < 0.1, noise(X) > 0.2
    assert np.mean((upper - lower)[wide]) > 1.05 * np.mean((upper - lower)[narrow])


def test_more_confidence_is_a_wider_interval_around_the_prediction(fitted: Ensemble) -> None:
    X = table(2)[0]
    lower, upper = fitted.predict_interval(X, 0.8)
    wider_lower, wider_upper = fitted.predict_interval(X, 0.95)
    assert np.all((wider_lower < lower) & (upper < wider_upper))
    np.testing.assert_allclose(0.5 * (lower + upper), fitted.predict(X))


def test_every_flight_calibrates_while_it_is_left_out(fitted: Ensemble) -> None:
    rule = fitted.fitted_.rule
    assert isinstance(rule, HeldOutRule)
    assert (len(rule.flight_factors), rule.flights_inside) == (FLIGHTS, FLIGHTS)
    covered = fitted.held_out_coverage(0.95)
    assert covered is not None
    assert covered.shape == (FLIGHTS,)
    assert np.all(covered > 0.85)


@pytest.mark.parametrize("kind", KINDS)
def test_repeats_for_a_seed_and_differs_for_another(kind: type[Ensemble]) -> None:
    X, y, flights = table(3)
    few = QUICK | {"epochs": 2, "calibration": "none"}
    one, again, other = (kind(**few, seed=seed).fit(X, y, flights).predict(X) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, other)


@pytest.mark.parametrize(
    ("kind", "rule"), [(BootstrapEnsemble, NormalRule), (QualityDrivenEnsemble, TrainedRule)]
)
def test_settings_of_the_paper(kind: Any, rule: type) -> None:
    """Ten members of twenty units, fifty epochs in batches of 400, samples split, nothing calibrated."""
    ensemble = kind.paper()
    assert (ensemble.members, ensemble.hidden, ensemble.epochs, ensemble.batch) == (10, 20, 50, 400)
    assert (ensemble.split, ensemble.subset, ensemble.early_stopping) == ("sample", 0.8, False)
    X, y, flights = table(4)
    ensemble.set_params(epochs=3).fit(X, y, flights)
    assert type(ensemble.fitted_.rule) is rule
    assert ensemble.held_out_coverage() is None
    lower, upper = ensemble.predict_interval(X, 0.95)
    assert np.all(lower < upper)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_that_are_not_finite_are_left_out_and_counted(
    kind: type[Ensemble], caplog: pytest.LogCaptureFixture
) -> None:
    X, y, flights = table(6)
    few = QUICK | {"epochs": 2, "calibration": "none"}
    whole = kind(**few).fit(
        np.delete(X, [3, 500, 501], axis=0), np.delete(y, [3, 500, 501]), np.delete(flights, [3, 500, 501])
    )
    X[3, 1], X[500, 0], y[501] = np.nan, np.inf, np.nan
    holed = kind(**few).fit(X, y, flights)
    assert (whole.rejected_, holed.rejected_) == (0, 3)
    assert "3 of 1800 rows are not finite" in caplog.text
    np.testing.assert_array_equal(holed.predict(X[:3]), whole.predict(X[:3]))
    with pytest.raises(ModelError, match="sample 3: input 1 is not finite"):
        holed.predict(X)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X, y, flights: (X, np.full_like(y, 2.0), flights), "constant"),
        (lambda X, y, flights: (X, y, np.zeros_like(flights)), "one flight"),
        (lambda X, y, flights: (X[:-1], y, flights), "do not fit together"),
        (lambda X, y, flights: (X, y[:, None], flights), "y has shape"),
        (lambda X, y, flights: (X, y, flights[:-1]), "groups has shape"),
        (lambda X, y, flights: (np.full_like(X, np.nan), y, flights), "none of 1800 rows is finite"),
    ],
)
def test_what_cannot_be_learned_from_is_refused(kind: type[Ensemble], change: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        kind(**QUICK).fit(*change(*table(7)))


def test_axes_trained_together_share_their_parameters() -> None:
    X, y, flights = table(9)
    different = {"Fx": BootstrapEnsemble(**QUICK), "Fz": BootstrapEnsemble(**QUICK | {"epochs": 3})}
    with pytest.raises(ModelError, match="same parameters"):
        fit_axes(different, X, np.stack((y, y), axis=1), flights)
