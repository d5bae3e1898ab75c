# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student_t

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.kinds.polynomial import KIND, Polynomial
from quadpi_core.models.model_kind import Fit
from quadpi_core.models.regressors import CandidatePool, RegressorProgram

from ..small_fits import AXIS, axis_of, interval, prediction, spread
from ..small_fits import fit as fit_table

POOL = CandidatePool.parse(["u"], ["P^3(u, v, w)"])
FLIGHT = 300


def iid_data(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Independent samples of a truth that lies in the pool."""
    X = rng.normal(size=(count, len(INPUT_NAMES)))
    u, v, w = X[:, INPUT_INDEX["u"]], X[:, INPUT_INDEX["v"]], X[:, INPUT_INDEX["w"]]
    return X, 1.0 - 0.5 * u + 0.8 * u * w + 0.3 * v**3 + 0.4 * rng.normal(size=count)


def autocorrelated(rng: np.random.Generator, count: int) -> Array:
    """First-order autoregressive noise of unit variance with a lag-1 correlation of 0.98."""
    steps = rng.normal(size=count) * np.sqrt(1.0 - 0.98**2)
    steps[0] = rng.normal()
    noise: Array = lfilter([1.0], [1.0, -0.98], steps)
    return noise


def flights(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Flights of slow samples, each about its own velocity and with its own bias of the force."""
    X, y = np.zeros((count * FLIGHT, len(INPUT_NAMES))), np.zeros(count * FLIGHT)
    for flight in range(count):
        part = slice(flight * FLIGHT, (flight + 1) * FLIGHT)
        for name in "uvw":
            X[part, INPUT_INDEX[name]] = rng.normal(scale=1.5) + autocorrelated(rng, FLIGHT)
        u, w = X[part, INPUT_INDEX["u"]], X[part, INPUT_INDEX["w"]]
        y[part] = -0.5 * u + 0.1 * u * w + rng.normal(scale=0.3) + 0.3 * autocorrelated(rng, FLIGHT)
    return X, y, np.repeat(np.arange(count), FLIGHT)


def fit(X: Array, y: Array, groups: Any = None, kind: Polynomial = KIND, **options: Any) -> Fit:
    """One axis; without flights, five contiguous parts stand in for them."""
    flights = np.arange(len(y)) * 5 // max(len(y), 1) if groups is None else groups
    return fit_table(kind, X, y, flights, POOL, **options)


def paper(X: Array, y: Array, groups: Any = None) -> Fit:
    return fit(X, y, groups, settings="paper")


def coverage(found: Fit, X: Array, y: Array) -> float:
    lower, upper = interval(found.fitted, X)
    return float(np.mean((lower <= y) & (y <= upper)))


def test_finds_the_truth() -> None:
    X, y = iid_data(np.random.default_rng(1), 4000)
    own = axis_of(fit(X, y))
    coefficients = dict(zip(own.terms, own.coefficients, strict=True))
    assert coefficients == pytest.approx({"bias": 1.0, "u": -0.5, "u*w": 0.8, "v^3": 0.3}, abs=0.03)


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.999])
def test_paper_intervals_are_those_of_the_textbook(confidence: float) -> None:
    rng = np.random.default_rng(3)
    X, y = iid_data(rng, 200)
    new, _ = iid_data(rng, 50)
    found = paper(X, y)
    program = RegressorProgram.compile(axis_of(found).regressors)
    Z, z = program.evaluate(X), program.evaluate(new)
    coefficients = np.linalg.lstsq(Z, y, rcond=None)[0]
    variance = np.sum((y - Z @ coefficients) ** 2) / (len(y) - 2)
    leverage = np.einsum("ij,jk,ik->i", z, np.linalg.inv(Z.T @ Z), z)
    half = student_t.ppf(0.5 + confidence / 2, len(y) - 2) * np.sqrt(variance * (1.0 + leverage))
    lower, upper = interval(found.fitted, new, confidence)
    np.testing.assert_allclose(lower, z @ coefficients - half, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(upper, z @ coefficients + half, rtol=1e-9, atol=1e-12)


def test_paper_intervals_cover_fresh_independent_samples() -> None:
    rng = np.random.default_rng(4)
    covered = [coverage(paper(*iid_data(rng, 1000)), *iid_data(rng, 1000)) for _ in range(30)]
    # One fit's coverage varies by its σ_e (1.1 %·0.2) and its 1000 samples (0.7 %): 0.17 % over 30 fits.
    assert np.mean(covered) == pytest.approx(0.95, abs=0.006)


def test_default_covers_new_flights_where_the_papers_rule_does_not() -> None:
    default, by_paper = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        known, (new_X, new_y, _) = flights(rng, 8), flights(rng, 20)
        default.append(coverage(fit(*known), new_X, new_y))
        by_paper.append(coverage(paper(*known), new_X, new_y))
    assert np.mean(default) > 0.93
    assert np.mean(by_paper) < 0.85


def test_held_out_error_is_that_of_a_model_fitted_without_the_flight() -> None:
    X, y, groups = flights(np.random.default_rng(5), 6)
    found = fit(X, y, groups)
    for left_out in range(6):
        rest = groups != left_out
        numbers = groups[rest] - (groups[rest] > left_out)
        error = y[~rest] - prediction(fit(X[rest], y[rest], numbers).fitted, X[~rest])
        np.testing.assert_allclose(found.held_out[AXIS][left_out].error, error, atol=1e-6)


def test_intervals_widen_with_confidence_and_away_from_the_training_data() -> None:
    X, y, groups = flights(np.random.default_rng(6), 6)
    found = fit(X, y, groups)
    near, far = np.zeros((1, len(INPUT_NAMES))), np.zeros((1, len(INPUT_NAMES)))
    far[0, INPUT_INDEX["u"]] = 20.0
    widths = [np.subtract(*interval(found.fitted, near, c)[::-1])[0] for c in (0.5, 0.8, 0.95, 0.99)]
    assert np.all(np.diff(widths) > 0.0)
    assert np.subtract(*interval(found.fitted, far)[::-1])[0] > 2.0 * widths[2]
    rms = np.sqrt(np.mean(spread(found.fitted, X) ** 2))
    assert rms == pytest.approx(axis_of(found).rms_spread)


def test_order_of_the_flights_does_not_matter() -> None:
    X, y, groups = flights(np.random.default_rng(7), 5)
    order = np.concatenate([np.flatnonzero(groups == flight) for flight in (3, 0, 4, 1, 2)])
    one, other = fit(X, y, groups), fit(X[order], y[order], groups)
    assert axis_of(one).regressors == axis_of(other).regressors
    np.testing.assert_allclose(interval(one.fitted, X), interval(other.fitted, X), rtol=1e-5)


def test_selection_log_tells_every_step() -> None:
    X, y = iid_data(np.random.default_rng(8), 2000)
    found = paper(X, y)
    log = found.log[AXIS]
    assert [row["term"] for row in log[:2]] == ["bias", "u"]
    assert [row["fixed"] for row in log[:3]] == [True, True, False]
    assert log[0]["r2"] is None
    assert np.all(np.diff([row["r2"] for row in log[1:]]) > 0.0)
    own = axis_of(found)
    final = dict(zip(own.terms, own.coefficients, strict=True))
    chosen = [row for row in log if row["coefficient"] is not None]
    assert {row["term"]: row["coefficient"] for row in chosen} == final
    r2 = 1.0 - np.sum((y - prediction(found.fitted, X)) ** 2) / np.sum((y - y.mean()) ** 2)
    assert chosen[-1]["r2"] == pytest.approx(r2, abs=1e-9)


def test_exact_target_gives_finite_intervals() -> None:
    X, _ = iid_data(np.random.default_rng(9), 500)
    y = 2.0 + X[:, INPUT_INDEX["u"]] - X[:, INPUT_INDEX["w"]] ** 2
    for settings in ("default", "paper"):
        bounds = interval(fit(X, y, settings=settings).fitted, X)
        assert np.all(np.isfinite(bounds))
        np.testing.assert_allclose(bounds, [y, y], atol=1e-4)


def test_bad_training_data_is_named() -> None:
    X, y, groups = flights(np.random.default_rng(12), 3)
    with pytest.raises(ModelError, match=f"{AXIS}: the target is constant"):
        fit(X, np.full_like(y, 2.0), groups)
    with pytest.raises(ModelError, match="19 samples are too few for a pool of 20 regressors"):
        fit(X[:19], y[:19])
    standing = X.copy()
    standing[:, INPUT_INDEX["u"]] = 0.0
    with pytest.raises(ModelError, match="`u` is constant or a combination"):
        fit(standing, y, groups)


def test_one_flight_cannot_be_held_out() -> None:
    X, y, groups = flights(np.random.default_rng(13), 1)
    for kind in (Polynomial(), Polynomial(stop="pse")):
        with pytest.raises(ModelError, match="two flights"):
            fit(X, y, groups, kind)
    assert np.all(np.isfinite(prediction(paper(X, y, groups).fitted, X)))


def test_two_flights_are_enough() -> None:
    X, y, groups = flights(np.random.default_rng(14), 2)
    assert np.all(np.isfinite(interval(fit(X, y, groups).fitted, X)))


@pytest.mark.parametrize("confidence", [-0.1, 0.0, 0.3, 0.9999, 1.0, 1.5, np.nan])
def test_confidence_without_calibration_is_refused(confidence: float) -> None:
    found = fit(*flights(np.random.default_rng(15), 3), Polynomial(max_terms=2))
    with pytest.raises(ModelError, match="confidence"):
        interval(found.fitted, np.zeros((1, len(INPUT_NAMES))), confidence)
