# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration by flight: its order, its shape, and its guarantee by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from examples.conformal_by_flight import ConformalByFlight, main
from quadpi_core.errors import ModelError

SAMPLES = 150


class Line:
    """Least squares through the origin, its interval wider where |x| is large, and far too narrow."""

    def fit(self, X, y, groups=None):
        self.slope_ = float(X[:, 0] @ y / (X[:, 0] @ X[:, 0]))
        self.flights_ = len(np.unique(groups))
        return self

    def predict(self, X):
        return self.slope_ * X[:, 0]

    def predict_interval(self, X, confidence=0.95):
        half = 0.1 * confidence * (1.0 + np.abs(X[:, 0]))
        return self.predict(X) - half, self.predict(X) + half


def flights(rng, count):
    """Exchangeable, but unlike flights: bias and noise of their own, correlated within."""
    X = rng.normal(scale=rng.lognormal(sigma=0.3, size=(count, 1)), size=(count, SAMPLES)).reshape(-1, 1)
    noise = np.cumsum(rng.normal(size=(count, SAMPLES)), axis=1) / np.sqrt(SAMPLES)
    noise = rng.lognormal(sigma=0.5, size=(count, 1)) * noise + 0.5 * rng.normal(size=(count, 1))
    y = 2.0 * X[:, 0] + (1.0 + np.abs(X[:, 0])) * noise.ravel()
    return X, y, np.repeat(np.arange(count), SAMPLES)


@pytest.mark.slow
@pytest.mark.parametrize(("calibrating", "share"), [(3, 0.75), (9, 0.9), (19, 0.9)])
def test_promised_share_of_new_flights_reaches_the_nominal_coverage(calibrating, share):
    rng = np.random.default_rng(calibrating)
    trials, reached = 1200, 0
    for _ in range(trials):
        X, y, groups = flights(rng, calibrating + 3)
        fitted, new = groups < 2, groups == calibrating + 2
        known = ~fitted & ~new
        conformal = ConformalByFlight(Line()).fit(X[fitted], y[fitted], groups[fitted])
        conformal.conformalize(X[known], y[known], groups[known])
        assert conformal.flight_share == pytest.approx(share)
        lower, upper = conformal.predict_interval(X[new], 0.9)
        reached += np.mean((lower <= y[new]) & (y[new] <= upper)) >= 0.9
    # Four standard errors; continuous scores make the promise exact, not only a lower bound.
    assert reached / trials == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / trials))


def calibrated(seed=0):
    rng = np.random.default_rng(seed)
    conformal = ConformalByFlight(Line()).fit(*flights(rng, 3))
    return conformal.conformalize(*flights(rng, 12))


def test_width_keeps_the_shape_of_the_estimator():
    conformal = calibrated()
    X = np.linspace(-5.0, 5.0, 11)[:, None]
    own_lower, own_upper = conformal.estimator.predict_interval(X, 0.95)
    ratios = []
    for confidence in (0.8, 0.95):
        lower, upper = conformal.predict_interval(X, confidence)
        ratio = (upper - lower) / (own_upper - own_lower)
        np.testing.assert_allclose(ratio, ratio[0])
        np.testing.assert_allclose(0.5 * (lower + upper), conformal.predict(X))
        ratios.append(ratio[0])
    assert 1.0 < ratios[0] < ratios[1]


def test_calibration_is_apart_from_the_fit():
    rng = np.random.default_rng(1)
    conformal = ConformalByFlight(Line()).fit(*flights(rng, 3))
    slope = conformal.estimator.slope_
    conformal.conformalize(*flights(rng, 12))
    assert conformal.estimator.slope_ == slope
    assert conformal.estimator.flights_ == 3


def test_out_of_order_is_refused():
    rng = np.random.default_rng(2)
    X, y, groups = flights(rng, 4)
    conformal = ConformalByFlight(Line())
    with pytest.raises(ModelError, match="call fit first"):
        conformal.conformalize(X, y, groups)
    conformal.fit(X, y, groups)
    with pytest.raises(ModelError, match="call conformalize first"):
        conformal.predict_interval(X)
    with pytest.raises(ModelError, match="call conformalize first"):
        _ = conformal.flight_share
    conformal.conformalize(*flights(rng, 4))
    conformal.predict_interval(X)
    conformal.fit(X, y, groups)
    with pytest.raises(ModelError, match="call conformalize first"):
        conformal.predict_interval(X)


def test_fitted_estimator_needs_no_second_fit():
    rng = np.random.default_rng(3)
    estimator = Line().fit(*flights(rng, 3))
    assert ConformalByFlight(estimator).conformalize(*flights(rng, 9)).flight_share == 0.9


def test_flight_of_the_fit_cannot_calibrate_under_any_name():
    rng = np.random.default_rng(4)
    X, y, groups = flights(rng, 4)
    conformal = ConformalByFlight(Line()).fit(X, y, groups)
    mine = groups == 2
    other_X, other_y, _ = flights(rng, 1)
    with pytest.raises(ModelError, match="flight copy: the estimator was fitted to it"):
        conformal.conformalize(
            np.vstack((other_X, X[mine])),
            np.concatenate((other_y, y[mine])),
            np.repeat(["a", "copy"], SAMPLES),
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X, y, groups: (X[:0], y[:0], groups[:0]), "do not fit"),
        (lambda X, y, groups: (X, y, groups[:-1]), "do not fit"),
        (lambda X, y, groups: (X, np.where(np.arange(len(y)) == 5, np.nan, y), groups), "sample 5: target"),
        (
            lambda X, y, groups: (np.vstack((X[:7], [[np.nan]], X[8:])), y, groups),
            "sample 7: the interval has no width",
        ),
    ],
)
def test_what_cannot_calibrate_is_refused(change, message):
    rng = np.random.default_rng(5)
    conformal = ConformalByFlight(Line()).fit(*flights(rng, 3))
    with pytest.raises(ModelError, match=message):
        conformal.conformalize(*change(*flights(rng, 3)))
    with pytest.raises(ModelError, match="call conformalize first"):
        conformal.predict_interval(np.ones((1, 1)))


def test_example_runs(capsys):
    main()
    assert capsys.readouterr().out == "91% of new flights reach their confidence\n"
