# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student_t
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.kinds.polynomial import StepwisePolynomial
from quadpi_core.models.regressors import RegressorProgram

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


def coverage(model: StepwisePolynomial, X: Array, y: Array) -> float:
    lower, upper = model.predict_interval(X)
    return float(np.mean((lower <= y) & (y <= upper)))


def test_finds_the_truth_and_predicts_it() -> None:
    X, y = iid_data(np.random.default_rng(1), 4000)
    model = StepwisePolynomial(POOL).fit(X, y)
    assert {str(r) for r in model.fitted_.regressors} == {"bias", "u", "u*w", "v^3"}
    coefficients = {
        str(r): c for r, c in zip(model.fitted_.regressors, model.fitted_.coefficients, strict=True)
    }
    assert coefficients == pytest.approx({"bias": 1.0, "u": -0.5, "u*w": 0.8, "v^3": 0.3}, abs=0.03)
    residual = y - model.predict(X)
    assert model.score(X, y) == pytest.approx(1.0 - np.var(residual) / np.var(y), abs=1e-9)


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.999])
def test_paper_intervals_are_those_of_the_textbook(confidence: float) -> None:
    rng = np.random.default_rng(3)
    X, y = iid_data(rng, 200)
    new, _ = iid_data(rng, 50)
    model = StepwisePolynomial.paper(POOL).fit(X, y)
    program = RegressorProgram.compile(model.fitted_.regressors)
    Z, z = program.evaluate(X), program.evaluate(new)
    coefficients = np.linalg.lstsq(Z, y, rcond=None)[0]
    variance = np.sum((y - Z @ coefficients) ** 2) / (len(y) - 2)
    leverage = np.einsum("ij,jk,ik->i", z, np.linalg.inv(Z.T @ Z), z)
    half = student_t.ppf(0.5 + confidence / 2, len(y) - 2) * np.sqrt(variance * (1.0 + leverage))
    lower, upper = model.predict_interval(new, confidence)
    np.testing.assert_allclose(lower, z @ coefficients - half, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(upper, z @ coefficients + half, rtol=1e-9, atol=1e-12)


def test_paper_intervals_cover_fresh_independent_samples() -> None:
    rng = np.random.default_rng(4)
    covered = []
    for _ in range(30):
        model = StepwisePolynomial.paper(POOL).fit(*iid_data(rng, 1000))
        covered.append(coverage(model, *iid_data(rng, 1000)))
    # One fit's coverage varies by its σ_e (1.1 %·0.2) and its 1000 samples (0.7 %): 0.17 % over 30 fits.
    assert np.mean(covered) == pytest.approx(0.95, abs=0.006)


def test_default_covers_new_flights_where_the_papers_rule_does_not() -> None:
    default, paper = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        X, y, groups = flights(rng, 8)
        new_X, new_y, _ = flights(rng, 20)
        default.append(coverage(StepwisePolynomial(POOL).fit(X, y, groups), new_X, new_y))
        paper.append(coverage(StepwisePolynomial.paper(POOL).fit(X, y, groups), new_X, new_y))
    assert np.mean(default) > 0.93
    assert np.mean(paper) < 0.85


def test_held_out_error_is_that_of_a_model_fitted_without_the_flight() -> None:
    X, y, groups = flights(np.random.default_rng(5), 6)
    model = StepwisePolynomial(POOL).fit(X, y, groups)
    for left_out in range(6):
        rest = groups != left_out
        other = StepwisePolynomial(POOL, noise="residual").fit(X[rest], y[rest], groups[rest])
        error = y[~rest] - other.predict(X[~rest])
        assert model.held_out_ is not None
        np.testing.assert_allclose(model.held_out_[left_out].error, error, atol=1e-6)


def test_intervals_widen_with_confidence_and_away_from_the_training_data() -> None:
    X, y, groups = flights(np.random.default_rng(6), 6)
    model = StepwisePolynomial(POOL).fit(X, y, groups)
    near, far = np.zeros((1, len(INPUT_NAMES))), np.zeros((1, len(INPUT_NAMES)))
    far[0, INPUT_INDEX["u"]] = 20.0
    widths = [np.subtract(*model.predict_interval(near, c)[::-1])[0] for c in (0.5, 0.8, 0.95, 0.99)]
    assert np.all(np.diff(widths) > 0.0)
    assert np.subtract(*model.predict_interval(far)[::-1])[0] > 2.0 * widths[2]
    assert np.sqrt(np.mean(model.fitted_.spread(X) ** 2)) == pytest.approx(model.fitted_.rms_spread)


def test_order_of_the_flights_does_not_matter() -> None:
    X, y, groups = flights(np.random.default_rng(7), 5)
    order = np.concatenate([np.flatnonzero(groups == flight) for flight in (3, 0, 4, 1, 2)])
    one = StepwisePolynomial(POOL).fit(X, y, groups)
    names = np.array(["e", "a", "d", "b", "c"])[groups]
    other = StepwisePolynomial(POOL).fit(X[order], y[order], names[order])
    assert one.fitted_.regressors == other.fitted_.regressors
    np.testing.assert_allclose(one.predict_interval(X), other.predict_interval(X), rtol=1e-5)


def test_selection_log_tells_every_step() -> None:
    X, y = iid_data(np.random.default_rng(8), 2000)
    model = StepwisePolynomial.paper(POOL).fit(X, y)
    log = model.selection_log()
    assert [row["term"] for row in log[:2]] == ["bias", "u"]
    assert [row["fixed"] for row in log[:3]] == [True, True, False]
    assert log[0]["r2"] is None
    r2 = [row["r2"] for row in log[1:]]
    assert np.all(np.diff(r2) > 0.0)
    final = dict(zip(map(str, model.fitted_.regressors), model.fitted_.coefficients, strict=True))
    assert {row["term"]: row["coefficient"] for row in log if row["coefficient"] is not None} == final
    last_chosen = [row for row in log if row["coefficient"] is not None][-1]
    assert last_chosen["r2"] == pytest.approx(model.score(X, y), abs=1e-9)


def test_exact_target_gives_finite_intervals() -> None:
    X, _ = iid_data(np.random.default_rng(9), 500)
    y = 2.0 + X[:, INPUT_INDEX["u"]] - X[:, INPUT_INDEX["w"]] ** 2
    for model in (StepwisePolynomial(POOL), StepwisePolynomial.paper(POOL)):
        bounds = model.fit(X, y).predict_interval(X)
        assert np.all(np.isfinite(bounds))
        np.testing.assert_allclose(bounds, [y, y], atol=1e-4)


def test_scikit_learn_cross_validates_by_flight() -> None:
    X, y, groups = flights(np.random.default_rng(10), 6)
    model = StepwisePolynomial(POOL, stop="bic", max_terms=4)
    scores = cross_val_score(model, X, y, groups=groups, cv=GroupKFold(3))
    assert scores.shape == (3,)
    assert np.all(np.isfinite(scores))
    assert not hasattr(model, "fitted_")
    search = GridSearchCV(StepwisePolynomial.paper(POOL), {"max_terms": [0, 4]}, cv=GroupKFold(3))
    assert search.fit(X, y, groups=groups).best_params_["max_terms"] in {0, 4}


def test_bad_training_data_is_named() -> None:
    X, y, groups = flights(np.random.default_rng(12), 3)
    model = StepwisePolynomial(POOL)
    hole = X.copy()
    hole[41, INPUT_INDEX["w"]] = np.nan
    with pytest.raises(ModelError, match="sample 41: input w is not finite"):
        model.fit(hole, y, groups)
    target = y.copy()
    target[7] = np.inf
    with pytest.raises(ModelError, match="sample 7: target is not finite"):
        model.fit(X, target, groups)
    with pytest.raises(ModelError, match="target is constant"):
        model.fit(X, np.full_like(y, 2.0), groups)
    with pytest.raises(ModelError, match="19 samples are too few for a pool of 20 regressors"):
        model.fit(X[:19], y[:19])
    with pytest.raises(ModelError, match=r"inputs have shape \(900, 3\)"):
        model.fit(X[:, :3], y, groups)
    with pytest.raises(ModelError, match=r"y has shape \(899,\)"):
        model.fit(X, y[1:], groups)
    with pytest.raises(ModelError, match=r"groups has shape \(899,\)"):
        model.fit(X, y, groups[1:])
    with pytest.raises(ModelError, match="the target is constant"):
        model.fit(X[:0], y[:0])
    standing = X.copy()
    standing[:, INPUT_INDEX["u"]] = 0.0
    with pytest.raises(ModelError, match="`u` is constant or a combination"):
        model.fit(standing, y, groups)
    with pytest.raises(ModelError, match="unknown stop rule"):
        StepwisePolynomial(POOL, stop="aic").fit(X, y, groups)  # type: ignore[arg-type]


def test_one_flight_cannot_be_held_out() -> None:
    X, y, groups = flights(np.random.default_rng(13), 1)
    for noise in ("held-out", "residual"):
        with pytest.raises(ModelError, match="two flights"):
            StepwisePolynomial(POOL, noise=noise).fit(X, y, groups)  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="two flights"):
        StepwisePolynomial(POOL, stop="pse").fit(X, y, groups)
    assert np.all(np.isfinite(StepwisePolynomial.paper(POOL).fit(X, y, groups).predict(X)))


def test_two_flights_are_enough() -> None:
    X, y, groups = flights(np.random.default_rng(14), 2)
    assert np.all(np.isfinite(StepwisePolynomial(POOL).fit(X, y, groups).predict_interval(X)))


@pytest.mark.parametrize("confidence", [-0.1, 0.0, 0.3, 0.9999, 1.0, 1.5, np.nan])
def test_confidence_without_calibration_is_refused(confidence: float) -> None:
    X, y, groups = flights(np.random.default_rng(15), 3)
    model = StepwisePolynomial(POOL, max_terms=2).fit(X, y, groups)
    with pytest.raises(ModelError, match="confidence"):
        model.predict_interval(X, confidence)
