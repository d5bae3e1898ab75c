# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Both ensembles as estimators of a table: what they learn, cover, refuse, and repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.ensemble_estimator import Ensemble, fit_axes
from quadpi_core.models.interval_rules import HeldOutRule, NormalRule, TrainedRule
from quadpi_core.models.kinds.bootstrap import BootstrapEnsemble
from quadpi_core.models.kinds.quality_driven import QualityDrivenEnsemble
from quadpi_core.models.training_table import Plan

pytest.importorskip("torch")

KINDS = (BootstrapEnsemble, QualityDrivenEnsemble)
# Enough to learn the tables of these tests.
QUICK: dict[str, Any] = {"hidden": 10, "epochs": 25, "batch": 100, "fewest_steps": 40, "learning_rate": 5e-3}
FLIGHTS, SAMPLES = 6, 300


def noise(X: Array) -> Array:
    """Standard deviation (N,) of the target."""
    spread: Array = 0.05 + 0.2 * np.abs(X[:, 1])
    return spread


def table(seed: int, flights: int = FLIGHTS) -> tuple[Array, Array, Array]:
    """Inputs (N, 3), of which the last says nothing, targets and labels of flights; noise grows with |x₁|."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, size=(flights * SAMPLES, 3))
    y = 3.0 + np.sin(3.0 * X[:, 0]) + X[:, 1] ** 2 + noise(X) * rng.normal(size=len(X))
    return X, y, np.repeat(np.arange(flights), SAMPLES)


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


def test_bounds_of_the_paper_are_for_the_confidence_of_training() -> None:
    X, y, flights = table(4)
    ensemble = QualityDrivenEnsemble.paper(epochs=2, confidence=0.9).fit(X, y, flights)
    ensemble.predict_interval(X, 0.9)
    with pytest.raises(ModelError, match=r"trained for a confidence of 0\.9, not 0\.95"):
        ensemble.predict_interval(X, 0.95)


def test_few_members_count_for_more_than_their_variance() -> None:
    """t with nine degrees of freedom and √(1 + 1/B) in place of the normal quantile."""
    few = BootstrapEnsemble(**QUICK | {"epochs": 1}).fit(*table(4)).fitted_
    assert few.model_share == pytest.approx((2.262157 / 1.959964) ** 2 * 1.1, rel=1e-5)
    assert BootstrapEnsemble.paper(epochs=1, hidden=5).fit(*table(4)).fitted_.model_share == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_protocol_of_scikit_learn(kind: type[Ensemble]) -> None:
    sklearn = pytest.importorskip("sklearn")
    from sklearn.base import clone, is_regressor

    ensemble = kind(**QUICK, seed=5)
    twin = clone(ensemble)
    assert sklearn.__version__
    assert is_regressor(twin)
    assert twin is not ensemble
    assert twin.get_params() == ensemble.get_params()
    with pytest.raises(ValueError, match="unknown parameter 'depth'"):
        twin.set_params(depth=3)


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


@pytest.mark.parametrize("kind", KINDS)
def test_asking_before_the_fit_is_refused(kind: type[Ensemble]) -> None:
    X = table(8)[0]
    for ask in (kind().predict, kind().predict_interval, lambda _: kind().held_out_coverage()):
        with pytest.raises(ModelError, match="call fit first"):
            ask(X)


def test_axes_trained_together_share_their_parameters() -> None:
    X, y, flights = table(9)
    different = {"Fx": BootstrapEnsemble(**QUICK), "Fz": BootstrapEnsemble(**QUICK | {"epochs": 3})}
    with pytest.raises(ModelError, match="same parameters"):
        fit_axes(different, X, np.stack((y, y), axis=1), flights)


@pytest.mark.parametrize("split", ["flight", "sample"])
def test_no_network_of_a_turn_sees_a_flight_left_out_in_it(split: Any) -> None:
    flights = np.repeat(np.arange(7), 50)
    plan = Plan.make(flights, members=10, subset=0.8, split=split, folds=4, seed=0)
    assert sorted(np.concatenate(plan.left_out).tolist()) == list(range(7))
    for turn, left_out in enumerate(plan.left_out):
        networks = plan.networks(turn)
        trained, omitted = plan.trained[networks][:, plan.unit], plan.omitted[networks][:, plan.unit]
        outside = np.isin(flights, left_out)
        assert not trained[:, outside].any()
        assert not omitted[:, outside].any()
        assert not (trained & omitted).any()
        assert (trained | omitted)[:, ~outside].all()
        # All are left out about equally often, so that each sample has networks that do not know it.
        assert omitted[:, ~outside].any(axis=0).all()
        if split == "flight":
            whole = [np.unique(row[flights == flight]) for row in omitted for flight in range(7)]
            assert all(len(values) == 1 for values in whole)
